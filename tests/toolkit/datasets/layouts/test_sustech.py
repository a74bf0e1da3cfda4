import json

import numpy as np
import pytest

from toolkit.datasets.layouts.sustech import sustech, write_sustech
from toolkit.frame import Frame, SensorCloud
from toolkit.objects import Objects
from toolkit.point_files.pcd import pcd_bytes

LABEL = [
    {
        "obj_id": "3",
        "obj_type": "Bus",
        "psr": {
            "position": {"x": 5.5, "y": -2, "z": 0.4},
            "rotation": {"x": 0, "y": 0, "z": 1.25},
            "scale": {"x": 11.0, "y": 2.5, "z": 3.0},
        },
    }
]


def scene(tmp_path, content=None):
    (tmp_path / "lidar").mkdir(parents=True)
    columns = dict(zip("xyz", np.ones((3, 4), np.float32), strict=True))
    (tmp_path / "lidar/000950.pcd").write_bytes(pcd_bytes(columns))
    if content is not None:
        (tmp_path / "label").mkdir()
        (tmp_path / "label/000950.json").write_text(content)
    return tmp_path


def test_labels_by_hand_or_of_nobody(tmp_path):
    (sample,) = sustech(scene(tmp_path, json.dumps(LABEL)))
    assert sample.objects.boxes.tolist() == [[5.5, -2, 0.4, 11.0, 2.5, 3.0, 1.25]]
    assert sample.objects.labels.tolist() == [3]
    assert sample.objects.ids.tolist() == [3]
    assert sample.categories == ("Bus",)
    assert len(sample.points()) == 4
    (sample,) = sustech(scene(tmp_path / "bare"))
    assert len(sample.objects) == 0


@pytest.mark.parametrize(
    ("content", "names"),
    [
        *(("{}", "must be a list"), ("[1]", "no entry psr")),
        (json.dumps(LABEL).replace('"scale"', '"size"'), "no entry scale"),
        *(
            (json.dumps(LABEL).replace("1.25", '"left"'), "rotation.z must be a number"),
            ("[", "not JSON from line 1"),
        ),
    ],
)
def test_damage_names_the_file(tmp_path, content, names):
    samples = sustech(scene(tmp_path, content))
    with pytest.raises(ValueError, match=f"000950.json .*{names}"):
        samples[0]


def test_several_sensors_become_one_cloud_in_the_world(tmp_path):
    pose = np.eye(4)
    pose[0, 3] = 10.0
    clouds = tuple(SensorCloud(name, np.ones((1, 3), np.float32), pose) for name in "ab")
    write_sustech([Frame.of_clouds("0", clouds, Objects.empty())], tmp_path)
    (back,) = sustech(tmp_path)
    assert back.points().tolist() == [[11, 1, 1], [11, 1, 1]]
