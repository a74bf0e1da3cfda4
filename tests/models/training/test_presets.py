"""Presets and the networks that they train."""

from dataclasses import replace

import pytest

from models.config import VoxelNetConfig
from models.training.loop import train
from models.training.packing import pack, recording
from models.training.presets import ANYWHERE, PRESETS, WINDOW, area_for, check_fit, config_for, window

AREA = (-12.8, -12.8, 12.8, 12.8)


def test_the_area_is_that_of_the_data_or_a_window(packed_file):
    assert area_for("fast", packed_file) == AREA
    assert area_for("general", packed_file) == ANYWHERE


def test_a_preset_needs_the_head_of_its_loss(packed_file, tmp_path):
    with pytest.raises(ValueError, match="published loss"):
        train(packed_file, VoxelNetConfig.light(AREA), PRESETS["paper"], tmp_path)


def test_data_of_two_areas_needs_a_site(frames, tmp_path):
    data = tmp_path / "two.packed"
    pack([recording(frames, AREA, count=1), recording(frames, (-5, -5, 5, 5), count=1)], data)
    with pytest.raises(ValueError, match="2 different areas: give a site, or general"):
        area_for("fast", data)


@pytest.mark.parametrize("size", ["light", "published"])
@pytest.mark.parametrize("preset", PRESETS)
def test_every_preset_has_a_network_that_its_loss_trains(preset, size):
    check_fit(config_for(AREA, preset, size), PRESETS[preset])


def test_a_published_network_of_a_wide_area_has_wide_voxels():
    assert config_for((0.0, 0.0, 40.0, 80.0), "paper", "published").voxel_size == (0.2, 0.2, 0.4)
    assert config_for((-48.0, -48.0, 48.0, 48.0), "paper", "published").voxel_size == (0.4, 0.4, 0.4)
    assert window((-48.0, 0.0, 48.0, 10.0)) == (-WINDOW / 2, 0.0, WINDOW / 2, 10.0)


@pytest.mark.parametrize("changes", [{"batch": 0}, {"epochs": 0.0}, {"epochs": float("nan")}])
def test_what_trains_nothing_is_refused(changes):
    with pytest.raises(ValueError, match="batch of at least 1 and epochs above 0"):
        check_fit(config_for(AREA, "fast"), replace(PRESETS["fast"], **changes))


def test_a_network_of_classes_has_their_anchors_and_vehicles_alone_are_what_they_were():
    config = config_for(AREA, "varied", classes=("vehicle", "pedestrian"))
    assert config.labels == ("vehicle", "pedestrian")
    assert config.anchor_labels == (0, 0, 1)
    assert config_for(AREA, "varied", classes=("vehicle",)) == config_for(AREA, "fast")


def test_several_labels_on_the_same_anchors_cannot_be_trained():
    shared = VoxelNetConfig.light(AREA, labels=("vehicle", "cyclist"))
    with pytest.raises(ValueError, match="anchors of their own to be trained"):
        check_fit(shared, PRESETS["fast"])
