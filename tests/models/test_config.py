"""`VoxelNetConfig`: the grid follows the area, and the numbers are checked."""

import json

import numpy as np
import pytest

from models.anchor_kind import AnchorKind
from models.config import ROAD_USERS, VoxelNetConfig, road_users, select_anchors
from models.network.voxelnet import VoxelNet


@pytest.mark.parametrize(
    ("area", "grid", "maps"),
    [
        *(
            ((-40, -20, 40, 20), (400, 200, 10), (200, 100)),
            ((-48, -48, 48, 48), (480, 480, 10), (240, 240)),
        ),
        *(
            ((0, 0, 50, 30), (256, 152, 10), (128, 76)),
            ((-0.3, 0.1, 1.4, 0.3), (16, 8, 10), (8, 4)),
        ),
    ],
)
def test_the_grid_follows_the_area_in_multiples_of_eight(area, grid, maps):
    config = VoxelNetConfig.light(area)
    assert (config.grid_shape, config.map_shape) == (grid, maps)


def test_published_networks_have_their_sizes():
    assert VoxelNetConfig.from_paper("tjunction").map_shape == (200, 100)
    assert VoxelNetConfig.from_paper("roundabout").grid_shape == (240, 240, 10)
    parameters = sum(
        each.numel() for each in VoxelNet(VoxelNetConfig.from_paper("tjunction")).parameters()
    )
    assert parameters == 9_460_194
    with pytest.raises(ValueError, match="'crossing'"):
        VoxelNetConfig.from_paper("crossing")


def test_classes_survive_json():
    with pytest.raises(ValueError, match="depth"):
        VoxelNetConfig.from_dict({"area": [0, 0, 1, 1], "depth": 3})
    assert VoxelNetConfig.from_dict(json.loads(json.dumps(CLASSES.to_dict()))) == CLASSES
    assert CLASSES.labels == ("vehicle", "heavy", "cyclist", "pedestrian")
    assert CLASSES.anchor_labels == (0, 0, 1, 1, 2, 2, 3)
    assert CLASSES.classes == 1


def test_defaults_of_new_entries_are_left_out():
    light = VoxelNetConfig.light((-8, -8, 8, 8))
    assert (
        not {"kinds", "faces", "calibration", "rivalry", "score_threshold", "thresholds"}
        & light.to_dict().keys()
    )
    assert "faces" in CLASSES.to_dict()
    (kind,) = light.anchor_kinds
    assert (kind.label, kind.size, kind.z, kind.yaws) == (
        "vehicle",
        light.anchor_size,
        0.8,
        light.anchor_yaws,
    )


def test_anchors_are_selected_in_order():
    assert select_anchors(("pedestrian", "vehicle")) == (ROAD_USERS[3], ROAD_USERS[0])
    every = select_anchors(("pedestrian", "cyclist", "heavy", "vehicle"))
    assert every == ROAD_USERS[::-1]
    for wrong in (("tram",), (), ("vehicle", "vehicle")):
        with pytest.raises(
            ValueError,
            match="classes must be different ones of vehicle, heavy, cyclist, pedestrian",
        ):
            select_anchors(wrong)


@pytest.mark.parametrize(
    "config", [VoxelNetConfig.from_paper("roundabout"), VoxelNetConfig.light(np.arange(4))]
)
def test_a_configuration_survives_json(config):
    assert VoxelNetConfig.from_dict(json.loads(json.dumps(config.to_dict()))) == config


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        *(({"area": (0.0, 0.0, 0.0, 9.0)}, "must ascend"), ({"height": (4.0, 0.0)}, "must ascend")),
        *(({"voxel_size": (0.2, 0.0, 0.4)}, "need a size"), ({"max_points": 0}, "need a size")),
        *(({"column_width": 32}, "either"), ({"middle_widths": (64, 64)}, "three entries")),
    ],
)
def test_what_makes_no_network_is_refused(changes, said):
    with pytest.raises(ValueError, match=said):
        VoxelNetConfig.from_paper("tjunction", **changes)


CLASSES = VoxelNetConfig.light(
    (-8, -8, 8, 8),
    **road_users(),
    faces=("vehicle", "heavy"),
    calibration=((1.5, -0.5), (1.0, 0.0), (0.7, 0.1), (1.0, 2.0)),
    rivalry=((1.0, 0.0, 0.0, 0.5, 0.0, 0.0),) * 4,
    score_threshold=0.35,
    thresholds=(0.1, 0.2, 0.3, 0.4),
)


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"labels": ("vehicle", "tram")}, "different ones of"),
        ({"labels": ("vehicle", "vehicle")}, "different ones of"),
        *(({"labels": ()}, "different ones of"), ({"faces": ("heavy",)}, "faces must be among")),
        *(
            ({"faces": ("tram",)}, "different ones of"),
            ({"kinds": ROAD_USERS}, "a kind for each label"),
        ),
        ({**road_users(), "head": "published"}, "need a quality head"),
        (
            {"calibration": ((1.0, 0.0), (1.0, 0.0))},
            "calibration must have a slope above 0, an intercept, for each",
        ),
        *(
            ({"calibration": ((0.0, 0.0),)}, "calibration must"),
            ({"calibration": ((1.0, 0.0, 0.0),)}, "calibration must"),
        ),
        *(
            ({"known": ((1.0, 0.0),)}, "known must have a slope"),
            ({"known": ((1.0, 0.0, -0.1),)}, "known must have"),
        ),
        *(
            ({"rivalry": ((1.0, 0.0),)}, "rivalry must have"),
            ({"rivalry": ((0.0, 0.0, 0.0),)}, "rivalry must have"),
        ),
        ({"rivalry": ((1.0, 0.0, -0.1),)}, "rivalry must have"),
        ({"rivalry": ((1.0, 0.0, 0.1),) * 2}, "rivalry must have"),
        *(({"score_threshold": 1.0}, "0..1"), ({"thresholds": (-0.1,)}, "0..1")),
        *(
            ({"thresholds": (0.1, 0.1)}, "one per label"),
            ({"known_thresholds": (0.1, 0.1)}, "one per label"),
        ),
        ({"known_thresholds": (1.0,)}, "0..1"),
    ],
)
def test_classes_that_do_not_fit_are_refused(changes, said):
    with pytest.raises(ValueError, match=said):
        VoxelNetConfig.light((-8, -8, 8, 8), **changes)


@pytest.mark.parametrize(
    "changes", [{"size": (1.0, 0.0, 1.0)}, {"yaws": ()}, {"margin": -0.1}, {"negative": 0.9}]
)
def test_anchors_that_are_none_are_refused(changes):
    with pytest.raises(ValueError, match="anchors need"):
        AnchorKind(**{"label": "vehicle", "size": (4.0, 2.0, 1.5), "z": 0.8, **changes})


@pytest.mark.parametrize(
    ("kinds", "said"),
    [
        *(
            ("vehicle", "kinds must be a list"),
            (["vehicle"], "must be an object of label, size, z"),
        ),
        ([{"label": "vehicle", "size": [1, 1, 1]}], "must be an object of"),
        ([{"label": "vehicle", "size": [1, 1, 1], "z": 1.0, "colour": 3}], "must be an object of"),
        ([{"label": "vehicle", "size": [1, 1], "z": 1.0}], "size must have 3 entries"),
        ([{"label": "vehicle", "size": [1, 1, 1], "z": "high"}], "z must be a number"),
    ],
)
def test_damaged_kinds_are_one_clear_line(kinds, said):
    with pytest.raises(ValueError, match=said):
        VoxelNetConfig.from_dict({"area": [0, 0, 1, 1], "kinds": kinds})
