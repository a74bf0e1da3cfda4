"""Average precision of a network in training: it counts what lies in the area, and disturbs
nothing."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from models.network.voxelnet import VoxelNet
from models.training import second_stage as module
from models.training.loop import train
from models.training.packed import PackedFrames
from models.training.presets import ANYWHERE, PRESETS, make_config
from models.training.second_stage import MAX_KEPT_AREAS, compute_recording_ap, detector_by_area
from models.training.training_log import LOG, read_curves
from toolkit.objects import VEHICLE, Detections, Objects

AREA = (-12.8, -12.8, 12.8, 12.8)
FAST = replace(PRESETS["fast"], epochs=3.0)


def test_validation_leaves_training_undisturbed(packed_file, tmp_path, same_weights):
    config, settings = make_config(AREA, "fast"), replace(FAST, epochs=2.0)
    plain = train(packed_file, config, settings, tmp_path / "plain")
    measured = train(
        packed_file,
        config,
        settings,
        tmp_path / "ap",
        validate=partial(compute_recording_ap, frames=PackedFrames(packed_file), count=2),
    )
    assert same_weights(plain, measured)
    assert plain.training
    epochs, values = read_curves(tmp_path / "ap" / LOG)["AP@0.7"]
    assert epochs == [1.0, 2.0]
    assert all(0 <= value <= 1 for value in values)


@pytest.fixture
def detecting(monkeypatch, packed):
    """Stands for the network: makes it detect these objects, frame after frame."""

    def as_detected(objects, network=None):
        frames = iter(range(len(packed)))

        class Detector:
            def __init__(self, network, **settings):
                pass

            def __call__(self, points):
                assert len(points)
                found = objects(next(frames))
                return Detections(found.boxes, np.full(len(found), 0.9), found.labels)

        monkeypatch.setattr("models.training.second_stage.VoxelNetDetector", Detector)
        network = network or VoxelNet(make_config(AREA, "fast"))
        return compute_recording_ap(network, packed)

    return as_detected


def test_who_detects_what_is_there_has_all_of_it_and_who_detects_half_has_less(detecting, packed):
    vehicles = [packed.objects(k)[packed.objects(k).labels == VEHICLE] for k in range(len(packed))]
    assert detecting(lambda k: vehicles[k]) == {"AP@0.7": 1.0, "AP@0.8": 1.0, "AP@0.9": 1.0}
    assert 0.3 < detecting(lambda k: vehicles[k][::2])["AP@0.7"] < 0.7


def test_every_class_of_the_network_has_figures(detecting, packed):
    def heavy_rightly_vehicles_as_cyclists(k):
        objects = packed.objects(k)
        return Objects(objects.boxes, np.where(objects.labels == 3, 3, 1))

    network = VoxelNet(make_config(AREA, "fast", classes=("vehicle", "heavy", "cyclist")))
    heavy = {f"heavy AP@{threshold:g}": 1.0 for threshold in (0.25, 0.5, 0.7)}
    assert detecting(heavy_rightly_vehicles_as_cyclists, network) == {
        "AP@0.7": 0.0,
        "AP@0.8": 0.0,
        "AP@0.9": 0.0,
        **heavy,
    }


def test_detectors_are_kept_for_a_few_areas_alone(spy):
    calls = spy(module, "VoxelNetDetector")
    detector_in = detector_by_area(VoxelNet(make_config(ANYWHERE, "general")))
    areas = [(0.0, 0.0, 8.0 * k, 8.0) for k in range(1, MAX_KEPT_AREAS + 2)]
    first = [detector_in(area) for area in areas]
    assert [call.args[0].config.area for call in calls] == areas
    assert [detector_in(area) for area in areas[1:]] == first[1:]  # the very same
    assert len(calls) == len(areas)
    detector_in(areas[0])
    assert [call.args[0].config.area for call in calls] == [*areas, areas[0]]
