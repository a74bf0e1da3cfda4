import numpy as np
import pytest
import yaml

from toolkit.datasets.layouts.opv2v import opv2v, unreal_pose, v2xreal
from toolkit.point_files.pcd import pcd_bytes

# CARLA: x east, y south. The agent stands at (100, 50), heads 90 degrees, which is south: along +y
# there, -y here.
AGENT: dict = {
    "lidar_pose": [100.0, 50.0, 2.0, 0.0, 90.0, 0.0],
    "vehicles": {
        7: {
            "angle": [0.0, 90.0, 0.0],
            "center": [0, 0, 0.75],
            "extent": [2.0, 0.9, 0.75],
            "location": [100.0, 60, 0],
        },
        "9": {
            "angle": [0, 0, 0],
            "center": [0, 0, "7.5e-01"],
            "extent": [2.0, 0.9, 0.75],
            "location": [97.0, 60, 0],
        },
    },
}


def agent(tmp_path, name, content, points):
    folder = tmp_path / "2021_08_22" / name
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "00068.yaml").write_text(
        content if isinstance(content, str) else yaml.safe_dump(content)
    )
    columns = dict(zip("xyz", np.array(points, np.float32).T, strict=True))
    (folder / "00068.pcd").write_bytes(pcd_bytes(columns))
    return tmp_path


def test_a_left_handed_frame_by_hand(tmp_path):
    """Ahead is ahead; what CARLA has to the right, y positive, is to the right here too, y
    negative."""
    (sample,) = opv2v(agent(tmp_path, "1732", AGENT, [[10.0, 3.0, -1.0]]))
    ahead, aside = sample.objects.boxes
    np.testing.assert_allclose(ahead, [10, 0, -1.25, 4, 1.8, 1.5, 0], atol=1e-9)
    # 3 m west of it, when one heads south, is to the right; it faces east, to the left of south
    np.testing.assert_allclose(aside, [10, -3, -1.25, 4, 1.8, 1.5, np.pi / 2], atol=1e-9)
    np.testing.assert_allclose(sample.points(), [[10.0, -3.0, -1.0]])
    np.testing.assert_allclose(sample.map_SE3_world[:3, 3], [100, -50, 2])
    assert sample.objects.ids.tolist() == [7, 9]


def test_frames_are_left_or_right_handed_with_unreal_angles(tmp_path):
    (sample,) = v2xreal(agent(tmp_path, "1", AGENT, [[10.0, 3.0, -1.0]]))
    np.testing.assert_allclose(sample.points(), [[10.0, 3.0, -1.0]])
    np.testing.assert_allclose(sample.objects.boxes[1, :2], [10, 3], atol=1e-9)
    # Pitch lifts x, roll lifts y to the right of it, in axes where y is right.
    np.testing.assert_allclose(
        unreal_pose(0.0, 0.0, 30.0)[:3, 0], [np.cos(np.pi / 6), 0, 0.5], atol=1e-12
    )
    np.testing.assert_allclose(
        unreal_pose(30.0, 0.0, 0.0)[:3, 1], [0, np.cos(np.pi / 6), -0.5], atol=1e-12
    )
    leaning = AGENT | {"lidar_pose": [100.0, 50.0, 2.0, 0.0, 90.0, 10.0]}
    (sample,) = opv2v(agent(tmp_path, "1", leaning, [[10.0, 0.0, 0.0]]))
    np.testing.assert_allclose(
        sample.points()[0], [10 * np.cos(np.deg2rad(10)), 0, 10 * np.sin(np.deg2rad(10))], atol=1e-5
    )
    np.testing.assert_allclose(sample.objects.boxes[0, :3], [10, 0, -1.25], atol=1e-9)


def test_agents_lists_are_put_together_by_id(tmp_path):
    other = {
        "lidar_pose": [100.0, 70.0, 2.0, 0.0, 90.0, 0.0],
        "vehicles": {7: AGENT["vehicles"][7]},
    }
    agent(tmp_path, "-1", other, [[0.0, 0.0, 1.0]])
    (sample,) = opv2v(agent(tmp_path, "1732", AGENT, [[1.0, 0.0, 0.0]]))
    assert [cloud.name for cloud in sample.clouds] == [
        "1732",
        "-1",
    ]  # vehicles first: their frame is the world's
    assert len(sample.objects) == 2
    np.testing.assert_allclose(sample.points()[1], [20, 0, 1], atol=1e-6)


@pytest.mark.parametrize(
    ("content", "names"),
    [
        *(
            ("a: [1", "00068.yaml"),
            ("- 1", "must hold names and values"),
            ({"vehicles": {}}, "no entry lidar_pose"),
        ),
        ({"lidar_pose": [1, 2, 3]}, "lidar_pose must be 6 numbers"),
        ({"lidar_pose": [1, 2, 3, 4, 5, float("nan")]}, "lidar_pose"),
        (AGENT | {"vehicles": {1: {"angle": [0, 0, 0]}}}, "location"),
    ],
)
def test_damage_names_the_file(tmp_path, content, names):
    with pytest.raises(ValueError, match=names):
        list(opv2v(agent(tmp_path, "1", content, [[1.0, 0, 0]])))
