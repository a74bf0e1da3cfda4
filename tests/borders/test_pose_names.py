"""Which pose is whose: by the name of the file as its author wrote it (as in PosixPath.name,
.stem), never by guess."""

import numpy as np
import pytest

from toolkit.datasets.pose_files import match_poses
from toolkit.geometry import pose

NORTH, SOUTH = pose(1.0, 0.0, 5.0), pose(2.0, 0.0, 5.0)


@pytest.mark.parametrize(
    "names", [("north", "south"), ("north.ply", "south.pcd"), ("a/north.ply", "b/south.pcd")]
)
def test_poses_are_named_as_files(names):
    poses = dict(zip(reversed(names), (SOUTH, NORTH), strict=True))
    matched = match_poses(["a/north.ply", "b/south.pcd"], poses)
    assert np.array_equal(matched, [NORTH, SOUTH])


def test_files_of_one_name_are_told_apart_by_folders():
    poses = {"south/7.pcd": SOUTH, "north/7.pcd": NORTH}
    assert np.array_equal(match_poses(["north/7.pcd", "south/7.pcd"], poses), [NORTH, SOUTH])


def test_numbers_of_other_files_are_no_order():
    with pytest.raises(
        ValueError,
        match=r"cannot tell which pose is whose.*name each pose as its file, such as '12'",
    ):
        match_poses(["12.pcd", "13.pcd"], {"13": NORTH, "14": SOUTH})
    assert np.array_equal(
        match_poses(["12.pcd", "13.pcd"], {"0": NORTH, "1": SOUTH}), [NORTH, SOUTH]
    )
