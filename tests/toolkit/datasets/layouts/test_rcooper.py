import json

import numpy as np
import pytest

from toolkit.datasets.layouts.rcooper import merge_copies, rcooper
from toolkit.objects import Objects
from toolkit.point_files.pcd import pcd_bytes

LEVEL = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]


def car(x, y=0.0, kind="car"):
    return {
        "type": kind,
        "track_id": 7,
        "3d_dimensions": {"h": 1.5, "w": 1.8, "l": 4.5},
        "3d_location": {"x": x, "y": y, "z": -5.0},
        "rotation": 0.0,
    }


@pytest.fixture
def scene(tmp_path):
    """Two poles 20 m apart along x; the second looks back at the first."""
    for agent, stamp, labels in (
        ("106", "1692685344.4", [car(10), car(50)]),
        ("105", "1692685344.5", [car(9.8), car(-30)]),
    ):
        where = tmp_path / "data/106-105" / agent / "seq-1/lidar"
        where.mkdir(parents=True)
        columns = dict(zip("xyz", np.ones((3, 2), np.float32), strict=True))
        (where / f"{stamp}.pcd").write_bytes(pcd_bytes(columns))
        labelled = tmp_path / "label/106-105" / agent / "seq-1"
        labelled.mkdir(parents=True)
        (labelled / f"{stamp}.json").write_text(json.dumps(labels))
    calib = tmp_path / "calib/lidar2world"
    calib.mkdir(parents=True)
    half = [[-1.0, 0, 0], [0, -1.0, 0], [0, 0, 1.0]]
    (calib / "106.json").write_text(json.dumps({"rotation": LEVEL, "translation": [0, 0, 6]}))
    (calib / "105.json").write_text(json.dumps({"rotation": half, "translation": [20, 0, 6]}))
    return tmp_path


def test_agents_stand_in_one_world_by_their_calibration(scene):
    (sample,) = rcooper(scene)
    assert sample.name == "106-105/seq-1/00000"
    assert sample.time == 1692685344.4
    assert [cloud.name for cloud in sample.clouds] == ["106", "105"]
    np.testing.assert_allclose(sample.points()[[0, 2]], [[1, 1, 7], [19, -1, 7]])
    # the second agent's 9.8 m is 10.2 m in the world, and its -30 m is 50 m: both are cars of the
    # first one too
    np.testing.assert_allclose(sample.objects.boxes[:, 0], [10, 50])
    assert sample.objects.boxes[:, 2].tolist() == [1, 1]
    (scene / "calib/lidar2world/105.json").unlink()
    with pytest.raises(FileNotFoundError, match=r"105\.json"):
        list(rcooper(scene))


def test_boxes_of_two_classes_or_of_one_agent_stay():
    box = np.array([[0, 0, 0, 4, 2, 1, 0.0]])
    cars, bikes = Objects(box, np.array([0])), Objects(box, np.array([1]))
    assert merge_copies([cars, bikes])[1].tolist() == [0, 1]
    assert merge_copies([cars, cars])[1].tolist() == [0]
    assert merge_copies([Objects(np.repeat(box, 2, axis=0))])[1].tolist() == [0, 1]
