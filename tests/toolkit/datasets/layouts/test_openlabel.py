import json

import numpy as np
import pytest

from toolkit.datasets.layouts.openlabel import openlabel, openlabel_content
from toolkit.datasets.problem_kinds import STRAY
from toolkit.frame import Frame
from toolkit.objects import Detections, Objects
from toolkit.point_files.pcd import pcd_bytes

# A quarter turn about z is (0, 0, sin 45°, cos 45°) as x y z w; read as w x y z it would be half a
# turn about y and z.


def content(**data):
    cuboid = {
        "name": "shape3D",
        "val": [10.0, -4.0, -6.0, 0.0, 0.0, 0.70710678, 0.70710678, 4.2, 1.8, 1.5],
        "attributes": {"num": [{"name": "num_points", "val": 37}]},
    }
    data = {"name": "CAR_1", "type": "CAR", "cuboid": cuboid, **data}
    frame = {
        "frame_properties": {
            "timestamp": 1646667310.044,
            "point_cloud_file_names": ["1646667310_044.pcd"],
        },
        "objects": {"b1d0-44": {"object_data": data}},
    }
    return {"openlabel": {"metadata": {"schema_version": "1.0.0"}, "frames": {"0": frame}}}


def folder(tmp_path, document):
    for name in (
        "labels_point_clouds/s110_lidar_ouster_south",
        "point_clouds/s110_lidar_ouster_south",
    ):
        (tmp_path / name).mkdir(parents=True, exist_ok=True)
    text = document if isinstance(document, str) else json.dumps(document)
    (tmp_path / "labels_point_clouds/s110_lidar_ouster_south/1646667310_044.json").write_text(text)
    columns = dict(zip("xyz", np.ones((3, 4), np.float32), strict=True))
    cloud = tmp_path / "point_clouds/s110_lidar_ouster_south/1646667310_044.pcd"
    cloud.write_bytes(pcd_bytes(columns | {"intensity": np.arange(4, dtype=np.float32)}))
    return tmp_path


def test_labels_by_hand_in_the_standards_own_forms(tmp_path):
    (sample,) = openlabel(folder(tmp_path, content()))
    np.testing.assert_allclose(
        sample.objects.boxes, [[10, -4, -6, 4.2, 1.8, 1.5, np.pi / 2]], atol=1e-7
    )
    assert sample.time == 1646667310.044
    assert sample.counts.tolist() == [37]
    assert [cloud.name for cloud in sample.clouds] == ["s110_lidar_ouster_south"]
    assert sample.clouds[0].intensity.tolist() == [0, 1, 2, 3]
    # A list of cuboids, Euler angles, and types that stand beside the frames.
    document = content(cuboid=[{"name": "s", "val": [1, 2, 3, 0, 0, 0.5, 4, 2, 1]}])
    del document["openlabel"]["frames"]["0"]["objects"]["b1d0-44"]["object_data"]["type"]
    document["openlabel"]["objects"] = {"b1d0-44": {"name": "x", "type": "pedestrian"}}
    (sample,) = openlabel(folder(tmp_path, document))
    np.testing.assert_allclose(sample.objects.boxes, [[1, 2, 3, 4, 2, 1, 0.5]])
    assert sample.objects.labels.tolist() == [2]
    assert sample.counts is None


def test_sensors_stand_somewhere_and_detections_have_scores(tmp_path):
    document = content()
    moved = [1, 0, 0, 5, 0, 1, 0, 6, 0, 0, 1, 7, 0, 0, 0, 1]
    document["openlabel"]["coordinate_systems"] = {
        "s110_lidar_ouster_south": {"type": "sensor", "pose_wrt_parent": {"matrix4x4": moved}}
    }
    (sample,) = openlabel(folder(tmp_path, document))
    assert sample.points()[0].tolist() == [6, 7, 8]
    found = Detections(np.array([[1, 2, 3, 4, 2, 1, 0.0]]), np.array([0.75]), np.array([1]))
    document = openlabel_content(Frame.of_clouds("a", (), Objects.empty()), found)
    assert document["openlabel"]["objects"]["0"]["type"] == "BICYCLE"
    (each,) = document["openlabel"]["frames"]["0"]["objects"].values()
    (cuboid,) = each["object_data"]["cuboid"]
    assert cuboid["val"] == [1, 2, 3, 0, 0, 0, 1, 4, 2, 1]
    assert cuboid["attributes"]["num"] == [{"name": "score", "val": 0.75}]


@pytest.mark.parametrize(
    ("change", "names"),
    [
        (lambda d: d["openlabel"].pop("frames"), "no entry openlabel.frames"),
        (
            lambda d: d["openlabel"]["frames"]["0"]["objects"]["b1d0-44"]["object_data"][
                "cuboid"
            ].pop("val"),
            "no entry val",
        ),
        (
            lambda d: d["openlabel"]["frames"]["0"]["objects"]["b1d0-44"]["object_data"].pop(
                "type"
            ),
            "no entry objects",
        ),
        (
            lambda d: d["openlabel"]["frames"]["0"]["objects"]["b1d0-44"]["object_data"]["cuboid"][
                "val"
            ].append(1),
            "must be 10 numbers",
        ),
    ],
)
def test_damage_names_the_file(tmp_path, change, names):
    document = content()
    change(document)
    with pytest.raises(ValueError, match=f"1646667310_044.json .*({names})"):
        list(openlabel(folder(tmp_path, document)))


def test_sensors_are_the_streams_in_their_places_else_folders_and_labels_without_a_cloud_are_counted(
    tmp_path,
):
    document = content()
    properties = document["openlabel"]["frames"]["0"]["frame_properties"]
    properties["streams"] = {"north": {}, "unused": {}}
    (sample,) = openlabel(folder(tmp_path, document))
    assert [cloud.name for cloud in sample.clouds] == ["north"]
    own = tmp_path / "point_clouds/s110_lidar_ouster_south"
    (own.parent / "east").mkdir()
    for name in ("south/b.pcd", "east/c.pcd"):
        (own.parent / name.replace("south", own.name)).write_bytes(
            (own / "1646667310_044.pcd").read_bytes()
        )
    properties["point_cloud_file_names"] = ["1646667310_044.pcd", "b.pcd", "c.pcd"]
    (sample,) = openlabel(folder(tmp_path, document))
    assert [cloud.name for cloud in sample.clouds] == ["north", "unused", "east"]
    del properties["point_cloud_file_names"]
    properties["streams"] = {}
    (sample,) = openlabel(folder(tmp_path, document))
    assert [cloud.name for cloud in sample.clouds] == ["s110_lidar_ouster_south"]
    assert sample.problems == {}
    properties["point_cloud_file_names"] = ["another.pcd"]
    (sample,) = openlabel(folder(tmp_path, document))
    assert sample.problems == {STRAY: 1}
