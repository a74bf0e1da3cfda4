"""Augmentations of scenes: errors are a recording's, what is thinned is a subset, what is tilted
stays together."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from models.config import VoxelNetConfig, road_users
from models.network.grid import anchors
from models.network.voxelnet import VoxelNet
from models.training import samples as module
from models.training.losses import IGNORED, NEGATIVE, POSITIVE
from models.training.packed import PackedFrames
from models.training.packing import pack, recording
from models.training.presets import PRESETS
from models.training.samples import (
    LIFT_DEVIATION_M,
    MIN_KEPT_SHARE,
    SLOPE_DEVIATION,
    SampleRecipe,
    Samples,
    apply_errors,
    jitter_objects,
    random_errors,
    stack,
    thin_cloud,
    tilt,
    turn_scene,
)
from toolkit.boxes import count_points, iou_bev, points_in_boxes
from toolkit.datasets.recording_views import with_errors as read_with_errors
from toolkit.frame import Frame
from toolkit.geometry import look
from toolkit.objects import HEAVY, VEHICLE, Objects
from toolkit.sensors.error_profile import ErrorProfile
from toolkit.sensors.error_profiles import POOR
from toolkit.sensors.error_terms import Calibration, DropOut, MixedPixels
from toolkit.sensors.models import DepthCamera
from toolkit.sensors.sensor import Sensor

CENTRE = np.array([2.0, -1.0])


@pytest.fixture(scope="module")
def scene(tmp_path_factory):
    """A car before a far wall on ground at 0.5 m, seen by two cameras in two frames, and the packed
    file of it; what is neither ground nor car lies outside the crop."""
    model = DepthCamera(width=120, height=90, fov=1.2)
    # along x
    sensors = tuple(
        Sensor(f"s{k}", model, look((-12.0, 4.0 * k, 4.0), 0.0, 0.35)) for k in range(2)
    )
    box = np.array([[0.0, 2.0, 0.75, 4.0, 1.8, 1.5, 0.0]])
    frames = []
    for index in range(3):
        images = []
        for sensor in sensors:
            rays = sensor.world_rays.T
            ground = np.where(
                rays[:, 2] < 0, (0.5 - sensor.position[2]) / np.minimum(rays[:, 2], -1e-6), 0
            )
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
    pack([recording(frames, (-20.0, -20.0, 20.0, 20.0))], path)
    return frames, PackedFrames(path)


def test_errors_of_packed_frames_mix_with_what_is_outside_the_crop(scene):
    frames, packed = scene
    for terms in (
        (DropOut(0.3),),
        (Calibration(0.02, 0.3),),
        (DropOut(0.1), Calibration(0.01, 0.1)),
    ):
        errors = ErrorProfile("few", terms)
        ours = apply_errors(packed, 1, errors, 7)
        theirs = read_with_errors(frames[1], errors, 7, numbers=[0, 1])
        for points, sensor, image in zip(ours, theirs.sensors, theirs.measurements, strict=True):
            rays = sensor.world_rays.T * image.ravel()[:, None] + sensor.position
            inside = (
                (abs(rays[:, :2]) < 20).all(1)
                & (rays[:, 2] > 0)
                & (rays[:, 2] < 4)
                & (image.ravel() > 0)
            )
            kept = rays[inside & (image.ravel() < 60)]
            assert len(points) > 1000
            assert abs(len(points) - len(kept)) < 0.01 * len(kept)
            np.testing.assert_allclose(points.mean(axis=0), kept.mean(axis=0), atol=0.02)
    _, packed = scene
    clean, mixed = (
        np.concatenate(apply_errors(packed, 1, ErrorProfile("m", (MixedPixels(p),)), 3))
        for p in (0.0, 1.0)
    )
    assert (clean[:, 0] > 1.0).sum() == (
        np.abs(clean[clean[:, 0] > 1.0][:, 2] - 0.5) < 0.1
    ).sum()  # ground alone
    behind = mixed[(mixed[:, 0] > -1.5) & (mixed[:, 2] > 0.6)]
    assert len(behind) >= 5  # between the car's edge and what lies far behind
    assert abs(mixed[:, :2]).max() <= 20
    _, packed = scene
    both, one = apply_errors(packed, 2, POOR, 5), apply_errors(packed, 2, POOR, 5, [1])
    assert len(one) == 1
    np.testing.assert_array_equal(one[0], both[1])
    assert not np.array_equal(apply_errors(packed, 2, POOR, 6, [1])[0], one[0])


def test_random_errors_have_their_ranges():
    drawn = [random_errors(np.random.default_rng(seed)) for seed in range(300)]
    assert drawn[3].digest == random_errors(np.random.default_rng(3)).digest
    rotations = np.rad2deg(
        [next(t for t in each.terms if isinstance(t, Calibration)).rotation for each in drawn]
    )
    assert (rotations == 0).mean() == pytest.approx(0.2, abs=0.07)
    assert 0.55 < rotations.max() <= 0.6
    mixed = [next(t for t in each.terms if isinstance(t, MixedPixels)).share for each in drawn]
    assert max(mixed) > 0.25
    assert min(mixed) == 0
    assert [type(t) for t in drawn[0].terms] == [type(t) for t in drawn[1].terms]


def test_thinned_clouds_keep_a_tenth_to_all_points():
    points = np.random.default_rng(0).uniform(-9, 9, (2000, 3)).astype(np.float32)
    shares = []
    for seed in range(60):
        kept = thin_cloud(points, np.random.default_rng(seed))
        assert kept.dtype == np.float32
        assert len(np.unique(np.concatenate([points, kept]), axis=0)) == len(points)
        shares.append(len(kept) / len(points))
    assert min(shares) > MIN_KEPT_SHARE - 0.03
    assert min(shares) < 0.2
    assert max(shares) > 0.9
    assert np.mean(shares) == pytest.approx(0.55, abs=0.1)


def test_tilts_move_points_and_boxes_alike():
    rng = np.random.default_rng(1)
    boxes = np.column_stack(
        [rng.uniform(-20, 20, (50, 2)), rng.uniform(0, 1, 50), np.ones((50, 4))]
    )
    points = boxes[:, :3].astype(np.float32)
    moved_points, moved = tilt(points, boxes, CENTRE, np.random.default_rng(2))
    np.testing.assert_allclose(moved_points, moved[:, :3], atol=1e-5)
    np.testing.assert_array_equal(moved[:, [0, 1, 3, 4, 5, 6]], boxes[:, [0, 1, 3, 4, 5, 6]])
    assert points[0, 2] == np.float32(boxes[0, 2])  # what was given is as it was


def test_tilts_have_their_spread():
    at = np.float32([[2, -1, 0], [12, -1, 0], [2, 9, 0], [12, 9, 0]])
    heights = np.array(
        [tilt(at, np.zeros((0, 7)), CENTRE, np.random.default_rng(k))[0][:, 2] for k in range(800)]
    )
    np.testing.assert_allclose(
        heights[:, 3] + heights[:, 0], heights[:, 1] + heights[:, 2], atol=1e-6
    )
    assert heights[:, 0].std() == pytest.approx(LIFT_DEVIATION_M, rel=0.1)
    for k in (1, 2):
        assert (heights[:, k] - heights[:, 0]).std() == pytest.approx(10 * SLOPE_DEVIATION, rel=0.1)


CONFIG = VoxelNetConfig.light((-12.8, -12.8, 12.8, 12.8))
RECIPES = [PRESETS[name].examples for name in ("fast", "paper", "general")]


def shrunk(boxes):
    """A little smaller, so that no point lies on a face; rounding must not decide."""
    return boxes - np.array([0, 0, 0, 1e-3, 1e-3, 1e-3, 0])


def cloud(rng, boxes):
    """Points all over, and some within each box."""
    inside = rng.uniform(-0.49, 0.49, (len(boxes), 50, 3)) * boxes[:, None, 3:6]
    cos, sin = np.cos(boxes[:, 6:7]), np.sin(boxes[:, 6:7])
    x, y, z = np.moveaxis(inside, -1, 0)
    placed = np.stack([x * cos - y * sin, x * sin + y * cos, z], axis=-1) + boxes[:, None, :3]
    return np.concatenate([rng.uniform(-12, 12, (500, 3)), placed.reshape(-1, 3)]).astype(
        np.float32
    )


def boxes_of(rng, count=5):
    angle = np.arange(count) * 2 * np.pi / count
    yaw = rng.uniform(-np.pi, np.pi, count)
    sizes = np.tile([4.0, 1.8, 1.5], (count, 1))
    return np.column_stack([8 * np.cos(angle), 8 * np.sin(angle), np.full(count, 0.75), sizes, yaw])


def test_a_turned_scene_keeps_the_points_of_each_box_and_half_are_mirrored():
    for rng in map(np.random.default_rng, range(5)):
        boxes = boxes_of(rng)
        points = cloud(rng, boxes)
        turned_points, turned = turn_scene(points, boxes, np.array([1.0, -2.0]), rng)
        held = points_in_boxes(points, shrunk(boxes))
        np.testing.assert_array_equal(held, points_in_boxes(turned_points, shrunk(turned)))
        np.testing.assert_allclose(turned[:, 2:6], boxes[:, 2:6])
        distances = [
            np.linalg.norm(b[:, None, :2] - b[None, :, :2], axis=2) for b in (boxes, turned)
        ]
        np.testing.assert_allclose(*distances)
    boxes, mirrored = boxes_of(np.random.default_rng(0)), []
    for seed in range(40):
        _, turned = turn_scene(
            np.zeros((0, 3), np.float32), boxes, np.zeros(2), np.random.default_rng(seed)
        )
        before, after = (
            np.linalg.det([b[1, :2] - b[0, :2], b[2, :2] - b[1, :2]]) for b in (boxes, turned)
        )
        mirrored.append(before * after < 0)
    assert 10 < sum(mirrored) < 30


def test_a_jittered_object_takes_its_points_along_unless_it_would_meet_another():
    for rng in map(np.random.default_rng, range(5)):
        boxes = boxes_of(rng)
        points = cloud(rng, boxes)
        owned = points_in_boxes(points, boxes)
        moved_points, moved = jitter_objects(points, boxes, rng)
        assert np.abs(moved[:, :2] - boxes[:, :2]).max() > 0.1
        assert np.abs(moved[:, 6] - boxes[:, 6]).max() <= np.deg2rad(18) + 1e-9
        for index in range(len(boxes)):
            widened = moved[index : index + 1] + np.array([0, 0, 0, 0.01, 0.01, 0.01, 0])
            assert points_in_boxes(moved_points[owned[:, index]], widened).all()
        np.testing.assert_array_equal(moved_points[~owned.any(axis=1)], points[~owned.any(axis=1)])
        np.testing.assert_allclose(np.triu(iou_bev(moved, moved), 1), 0)
        np.testing.assert_array_equal(moved[:, 2:6], boxes[:, 2:6])
    close = boxes_of(np.random.default_rng(0), 2)
    close[:, :2], close[:, 6] = [[0, 0], [0, 2.1]], 0
    _, moved = jitter_objects(np.zeros((0, 3), np.float32), close, np.random.default_rng(1))
    np.testing.assert_array_equal(moved, close)


def same(a, b):
    tensors = zip(
        (*a.voxels[:3], a.labels, a.boxes), (*b.voxels[:3], b.labels, b.boxes), strict=True
    )
    return all(x.shape == y.shape and torch.equal(x, y) for x, y in tensors)


@pytest.mark.parametrize("recipe", RECIPES)
def test_an_example_depends_on_epoch_and_frame_alone(packed, recipe):
    samples = Samples(packed, CONFIG, recipe, seed=3)
    first = samples[1, 4]
    samples[0, 2], samples[7, 1]
    assert same(first, samples[1, 4])
    assert same(first, Samples(packed, CONFIG, recipe, seed=3)[1, 4])
    assert not same(first, samples[2, 4])
    assert not same(first, Samples(packed, CONFIG, recipe, seed=4)[1, 4])


@pytest.mark.slow  # a worker of whole runs has ended in it without a word
def test_batches_of_any_worker_equal_their_items(packed):
    samples = Samples(packed, CONFIG, RECIPES[0], seed=0)
    steps = [[(0, 0), (0, 3)], [(1, 2), (1, 5)]]
    alone, helped = (
        list(
            torch.utils.data.DataLoader(
                samples,
                batch_sampler=steps,
                collate_fn=stack,
                num_workers=workers,
                # a fork would copy the locks of all threads that earlier tests have started
                multiprocessing_context="spawn" if workers else None,
            )
        )
        for workers in (0, 2)
    )
    assert all(same(a, b) for a, b in zip(alone, helped, strict=True))
    samples = Samples(packed, CONFIG, RECIPES[0], seed=0)
    items = [samples[0, k] for k in range(3)]
    batch = stack(items)
    torch.manual_seed(0)
    network = VoxelNet(CONFIG).eval()
    with torch.no_grad():
        together, alone = network(batch.voxels), [network(item.voxels) for item in items]
    for k, item in enumerate(items):
        assert torch.equal(batch.labels[k], item.labels[0])
        assert torch.equal(batch.boxes[k], item.boxes[0])
        for whole, single in zip(together, alone[k], strict=True):
            torch.testing.assert_close(whole[k], single[0], atol=1e-4, rtol=1e-4)


def test_several_windows_are_cut_from_one_reading(packed, spy):
    calls = spy(module, "read_sample_points")
    one, four = (
        Samples(packed, CONFIG, replace(RECIPES[1], windows=n), seed=3)[1, 4] for n in (1, 4)
    )
    assert [call.args[1] for call in calls] == [4, 4]
    assert (len(one.labels), len(four.labels)) == (1, 4)
    assert torch.equal(
        one.labels[0], four.labels[0]
    )  # the first is the one that a single window would be
    assert not torch.equal(four.labels[0], four.labels[1])
    assert len(four.voxels.cells[:, 0].unique()) == 4


def test_asked_for_is_what_can_be_seen_in_the_area(packed):
    """The vehicle outside the area and the heavy one are neither asked for nor counted as
    background."""
    recipe = replace(RECIPES[0], subsets=0.0, augmentation="none")
    grid = anchors(CONFIG).double().numpy()
    for k in range(len(packed)):
        example, objects = Samples(packed, CONFIG, recipe, seed=0)[0, k], packed.objects(k)
        points = np.concatenate(packed.points(k, None))
        inside = np.abs(objects.boxes[:, :2]).max(axis=1) <= 12.8
        asked = (objects.labels == VEHICLE) & inside & (count_points(points, objects.boxes) >= 10)
        labels, wanted = example.labels[0], example.boxes[0]
        found = np.unique(wanted[labels == POSITIVE].double().numpy().round(4), axis=0)
        for box in objects.boxes[asked]:
            assert np.abs(found - box).max(axis=1).min() < 1e-3
        assert len(found) <= (objects.labels == VEHICLE).sum() - 1
        lorry = objects.boxes[-1]
        on_lorry = np.hypot(*(grid[..., :2] - lorry[:2]).transpose(3, 0, 1, 2)) < 0.5
        assert (labels[torch.from_numpy(on_lorry)] == IGNORED).all()
        assert (labels == NEGATIVE).sum() > 0.9 * labels.numel()


def test_samples_are_cut_to_size_thinned_and_tilted(packed):
    labels = Samples(packed, CONFIG, RECIPES[1], seed=0)[0, 0].labels
    assert (labels != IGNORED).sum() == 256
    assert 1 <= (labels == POSITIVE).sum() <= 128
    small = VoxelNetConfig.light((-6.4, -6.4, 6.4, 6.4))
    for epoch in range(5):
        example = Samples(packed, small, SampleRecipe(augmentation="scene", subsets=0.0), seed=0)[
            epoch, 1
        ]
        assert len(example.voxels.points)
        assert example.voxels.points[:, :2].abs().max() < 6.4
        positive = example.boxes[example.labels == POSITIVE]
        assert not len(positive) or positive[:, :2].abs().max() < 6.4
    recipe = SampleRecipe(subsets=0.0)
    plain = Samples(packed, CONFIG, recipe, seed=0)
    thin_cloud = Samples(packed, CONFIG, replace(recipe, thinned=1.0), seed=0)
    shares = [
        len(thin_cloud[epoch, 1].voxels.points) / len(plain[0, 1].voxels.points)
        for epoch in range(12)
    ]
    assert min(shares) < 0.5 < max(shares) < 1.0
    tilt = Samples(packed, CONFIG, replace(recipe, tilted=1.0), seed=0)
    spread = [
        np.ptp([np.median(each[epoch, 1].voxels.points[:, 2]) for epoch in range(9)])
        for each in (plain, tilt)
    ]
    assert spread[0] < 0.01
    assert spread[1] > 0.05


CLASSES = VoxelNetConfig.light((-12.8, -12.8, 12.8, 12.8), **road_users())


def test_a_network_of_classes_is_asked_for_each_by_its_own_anchors(packed):
    recipe = SampleRecipe(subsets=0.0)
    for k in range(len(packed)):
        example, objects = Samples(packed, CLASSES, recipe, seed=0)[0, k], packed.objects(k)
        points = np.concatenate(packed.points(k, None))
        inside = np.abs(objects.boxes[:, :2]).max(axis=1) <= 12.8
        seen = count_points(points, objects.boxes) >= 10
        labels, wanted = example.labels[0], example.boxes[0]
        for label, own in ((VEHICLE, slice(0, 2)), (HEAVY, slice(2, 4))):
            asked = objects.boxes[(objects.labels == label) & inside & seen]
            found = np.unique(
                wanted[..., own, :][labels[..., own] == POSITIVE].double().numpy().round(4), axis=0
            )
            assert len(found) >= len(asked) > 0
            for box in asked:
                assert np.abs(found - box).max(axis=1).min() < 1e-3
        assert (labels[..., 4:] != POSITIVE).all()  # there are no cyclists and no pedestrians
        near = (
            np.hypot(
                *(anchors(CLASSES).numpy()[:, :, 0, :2] - objects.boxes[-1, :2]).transpose(2, 0, 1)
            )
            < 0.5
        )
        assert (
            labels[torch.from_numpy(near)][:, :2] == NEGATIVE
        ).all()  # a heavy one is no vehicle


def test_windows_lie_near_every_class_or_anywhere(packed):
    """Three vehicles and one heavy one are in the area of most frames; by class each has half of
    the windows."""
    grid = (-3.2, -3.2, 3.2, 3.2)
    samples = Samples(
        packed,
        VoxelNetConfig.light(grid, **road_users()),
        SampleRecipe(subsets=0.0, seen=0),
        seed=1,
    )
    heavy = np.mean(
        [(samples[epoch, 1].labels[0, ..., 2:4] == POSITIVE).any().item() for epoch in range(60)]
    )
    assert 0.3 < heavy < 0.7
    samples = Samples(packed, VoxelNetConfig.light(grid), SampleRecipe(subsets=0.0, seen=0), seed=1)
    assert (
        np.mean([(samples[epoch, 1].labels == POSITIVE).any().item() for epoch in range(60)]) > 0.7
    )
    small = VoxelNetConfig.light((-3.2, -3.2, 3.2, 3.2))
    recipe = SampleRecipe(subsets=0.0)

    def with_somebody(recipe):
        samples = Samples(packed, small, recipe, seed=0)
        return np.mean([(samples[epoch, 0].labels == POSITIVE).any().item() for epoch in range(60)])

    near, some, anywhere = (
        with_somebody(replace(recipe, elsewhere=share)) for share in (0.0, 0.5, 1.0)
    )
    assert near > some > anywhere
    assert anywhere < near - 0.3
