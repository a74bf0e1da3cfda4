"""Augmentations of scenes: errors are a recording's, what is thinned is a subset, what is tilted stays together."""

import numpy as np
import pytest

from models.training.augmentation import FEWEST_KEPT, LIFT, SLOPE, random_errors, thinned, tilted, with_errors
from models.training.packed import PackedFrames
from models.training.packing import pack, recording
from toolkit.datasets.readings import with_errors as read_with_errors
from toolkit.frame import Frame
from toolkit.geometry import look
from toolkit.objects import Objects
from toolkit.sensors.depth_camera import DepthCamera
from toolkit.sensors.errors.drop_out import DropOut
from toolkit.sensors.errors.mixed_pixels import MixedPixels
from toolkit.sensors.errors.pose_errors import Calibration
from toolkit.sensors.errors.profile import ErrorProfile
from toolkit.sensors.errors.profiles import POOR
from toolkit.sensors.sensor import Sensor

CENTRE = np.array([2.0, -1.0])
AREA = (-20.0, -20.0, 20.0, 20.0)


@pytest.fixture(scope="module")
def scene(tmp_path_factory):
    """A car before a far wall on ground at 0.5 m, seen by two cameras in two frames, and the packed file of it; what is
    neither ground nor car lies outside the crop."""
    model = DepthCamera(width=120, height=90, fov=1.2)
    sensors = tuple(
        Sensor(f"s{k}", model, look((-12.0, 4.0 * k, 4.0), 0.0, 0.35)) for k in range(2)
    )  # both look along x
    box = np.array([[0.0, 2.0, 0.75, 4.0, 1.8, 1.5, 0.0]])
    frames = []
    for index in range(3):
        images = []
        for sensor in sensors:
            rays = sensor.world_rays.T
            ground = np.where(rays[:, 2] < 0, (0.5 - sensor.position[2]) / np.minimum(rays[:, 2], -1e-6), 0)
            depth = np.where((ground > 0) & (ground < 60), ground, 60).astype(np.float32)
            if index:
                near = (box[0, 0] - 2 - sensor.position[0]) / rays[:, 0]
                at = sensor.position + rays * near[:, None]
                on = (abs(at[:, 1] - 2.0) < 0.9) & (at[:, 2] > 0.55) & (at[:, 2] < 1.5)
                depth = np.where(on, near, depth).astype(np.float32)
            images.append(depth.reshape(model.shape))
        objects = Objects(box, np.zeros(1, np.int64)) if index else Objects.empty()
        frames.append(Frame(sensors, tuple(images), objects, 5.0 * index, index))
    path = tmp_path_factory.mktemp("packed") / "scene.packed"
    pack([recording(frames, AREA)], path)
    return frames, PackedFrames(path)


def test_a_packed_frame_with_errors_is_the_recorded_one_with_errors(scene):
    frames, packed = scene
    for terms in ((DropOut(0.3),), (Calibration(0.02, 0.3),), (DropOut(0.1), Calibration(0.01, 0.1))):
        errors = ErrorProfile("few", terms)
        ours = with_errors(packed, 1, errors, 7)
        theirs = read_with_errors(frames[1], errors, 7, numbers=[0, 1])
        for points, sensor, image in zip(ours, theirs.sensors, theirs.measurements, strict=True):
            rays = sensor.world_rays.T * image.ravel()[:, None] + sensor.position
            inside = (abs(rays[:, :2]) < 20).all(1) & (rays[:, 2] > 0) & (rays[:, 2] < 4) & (image.ravel() > 0)
            kept = rays[inside & (image.ravel() < 60)]
            assert len(points) > 1000
            assert abs(len(points) - len(kept)) < 0.01 * len(kept)
            np.testing.assert_allclose(points.mean(axis=0), kept.mean(axis=0), atol=0.02)


def test_what_is_outside_the_crop_mixes_with_what_is_inside_and_is_not_seen(scene):
    _, packed = scene
    clean, mixed = (
        np.concatenate(with_errors(packed, 1, ErrorProfile("m", (MixedPixels(share),)), 3)) for share in (0.0, 1.0)
    )
    assert (clean[:, 0] > 1.0).sum() == (np.abs(clean[clean[:, 0] > 1.0][:, 2] - 0.5) < 0.1).sum()  # ground alone
    behind = mixed[(mixed[:, 0] > -1.5) & (mixed[:, 2] > 0.6)]
    assert len(behind) >= 5  # between the car's edge and what lies far behind
    assert abs(mixed[:, :2]).max() <= 20


def test_some_of_the_sensors_are_read_as_when_all_are(scene):
    _, packed = scene
    both, one = with_errors(packed, 2, POOR, 5), with_errors(packed, 2, POOR, 5, [1])
    assert len(one) == 1
    np.testing.assert_array_equal(one[0], both[1])
    assert not np.array_equal(with_errors(packed, 2, POOR, 6, [1])[0], one[0])


def test_random_errors_go_from_none_to_beyond_poor():
    drawn = [random_errors(np.random.default_rng(seed)) for seed in range(300)]
    assert drawn[3].digest == random_errors(np.random.default_rng(3)).digest
    rotations = np.rad2deg([next(t for t in each.terms if isinstance(t, Calibration)).rotation for each in drawn])
    assert (rotations == 0).mean() == pytest.approx(0.2, abs=0.07)
    assert 0.55 < rotations.max() <= 0.6
    mixed = [next(t for t in each.terms if isinstance(t, MixedPixels)).share for each in drawn]
    assert max(mixed) > 0.25
    assert min(mixed) == 0
    assert [type(t) for t in drawn[0].terms] == [type(t) for t in drawn[1].terms]


def test_thinning_keeps_from_a_tenth_to_all():
    points = np.random.default_rng(0).uniform(-9, 9, (2000, 3)).astype(np.float32)
    shares = []
    for seed in range(60):
        kept = thinned(points, np.random.default_rng(seed))
        assert kept.dtype == np.float32
        assert len(np.unique(np.concatenate([points, kept]), axis=0)) == len(points)
        shares.append(len(kept) / len(points))
    assert min(shares) > FEWEST_KEPT - 0.03
    assert min(shares) < 0.2
    assert max(shares) > 0.9
    assert np.mean(shares) == pytest.approx(0.55, abs=0.1)


def test_points_and_boxes_are_lifted_alike():
    rng = np.random.default_rng(1)
    boxes = np.column_stack([rng.uniform(-20, 20, (50, 2)), rng.uniform(0, 1, 50), np.ones((50, 4))])
    points = boxes[:, :3].astype(np.float32)
    moved_points, moved = tilted(points, boxes, CENTRE, np.random.default_rng(2))
    np.testing.assert_allclose(moved_points, moved[:, :3], atol=1e-5)
    np.testing.assert_array_equal(moved[:, [0, 1, 3, 4, 5, 6]], boxes[:, [0, 1, 3, 4, 5, 6]])
    assert points[0, 2] == np.float32(boxes[0, 2])  # what was given is as it was


def test_the_ground_is_a_plane_through_its_lift_at_the_centre():
    at = np.float32([[2, -1, 0], [12, -1, 0], [2, 9, 0], [12, 9, 0]])
    heights = np.array([tilted(at, np.zeros((0, 7)), CENTRE, np.random.default_rng(k))[0][:, 2] for k in range(800)])
    np.testing.assert_allclose(
        heights[:, 3] - heights[:, 0], heights[:, 1] + heights[:, 2] - 2 * heights[:, 0], atol=1e-6
    )
    assert heights[:, 0].std() == pytest.approx(LIFT, rel=0.1)
    for k in (1, 2):
        assert (heights[:, k] - heights[:, 0]).std() == pytest.approx(10 * SLOPE, rel=0.1)
