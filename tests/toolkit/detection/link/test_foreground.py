"""Foreground messages, restored images, and the scheme that detects in them."""

import struct
import zlib
from dataclasses import replace

import numpy as np
import pytest

from toolkit.calibration.empty_scene import EmptyScene, SceneLearner
from toolkit.detection.link import foreground, foreground_pixels, image_coding
from toolkit.detection.link.message import read_message
from toolkit.detection.messages import RangeImage
from toolkit.detection.paper_schemes import Early
from toolkit.detection.scheme import Scheme
from toolkit.detection.view import Captured, frame_view
from toolkit.frame import Frame
from toolkit.geometry import look, pose
from toolkit.objects import Detections, Objects
from toolkit.points import frame_points
from toolkit.sensors.models import DepthCamera, SolidStateLidar, SpinningLidar
from toolkit.sensors.sensor import Sensor
from toolkit.sites.site import Relief, Site

MODELS = [
    DepthCamera(width=40, height=30),
    SpinningLidar(channels=15, azimuth_step=float(np.deg2rad(9)), fov_up=0.1, fov_down=-0.6),
    SolidStateLidar(rows=15, columns=20, vertical_fov=0.6),
]
AREA = (-20.0, -20.0, 20.0, 20.0)


def ground(sensor, height=0.1):
    """What a sensor measures of flat ground a little above z = 0 and of the sky."""
    down = sensor.world_rays[2].reshape(sensor.model.shape)
    with np.errstate(divide="ignore"):
        measured = (height - sensor.position[2]) / down
    return np.where((down < 0) & (measured < 60), measured, 0).astype(np.float32)


def wide_ground(sensor):
    """Flat ground, of which a little lies beyond the area."""
    return ground(sensor, 0.5)


def stand(model, name="s", x=0.0):
    return Sensor(
        name, model, look((x, 0.0, 5.0), 0.0, 0.4) if model.kind == "camera" else pose(x, 0.0, 5.0)
    )


def learnt(sensor, seed=0, frames=60):
    rng, learner = np.random.default_rng(seed), SceneLearner(sensor)
    for _ in range(frames):
        learner.add(sensor.model.noisy(ground(sensor), rng))
    return learner.scene()


def with_a_car(sensor, seed=5):
    image = sensor.model.noisy(ground(sensor), np.random.default_rng(seed))
    image[8:12, 6:11] = 7.0
    return image


@pytest.mark.parametrize("model", MODELS, ids=lambda model: model.kind)
@pytest.mark.parametrize("step", [0.02, 0.08])
def test_what_was_sent_arrives_and_the_scene_is_drawn_beside_it(model, step):
    sensor = stand(model)
    scene, image = learnt(sensor), with_a_car(sensor)
    kept = np.where(scene.shows(image), 0, image).astype(np.float32)
    message = foreground.encode_foreground(RangeImage(sensor, kept, 1.0, 3), scene, step=step)
    restored = foreground.decode_foreground(message, scene)
    np.testing.assert_array_equal(restored.sent, kept > 0)
    assert restored.sent[8:12, 6:11].all()
    assert np.abs(restored.image - image)[restored.sent].max() <= step / 2 + 1e-5
    np.testing.assert_array_equal(restored.image[~restored.sent], scene.first[~restored.sent])
    assert (restored.header.number, restored.header.time, restored.header.step) == (3, 1.0, step)
    assert restored.header.scene == foreground.scene_number(scene) == int(scene.digest[:8], 16)
    assert len(message) < 100


def test_scenes_of_others_and_missing_pixels_that_cannot_be_are_refused():
    sensor = stand(MODELS[0])
    scene, other = learnt(sensor), learnt(sensor, seed=1)
    image = RangeImage(sensor, with_a_car(sensor))
    message = foreground.encode_foreground(image, scene)
    with pytest.raises(ValueError, match="whose scene is"):
        foreground.decode_foreground(message, other)
    with pytest.raises(ValueError, match="whose sensor is"):
        foreground.decode_foreground(message, replace(scene, name="t"))
    with pytest.raises(ValueError, match="the empty scene is of 't'"):
        foreground.encode_foreground(image, replace(scene, name="t"))
    sensor = stand(MODELS[0])
    scene, image = learnt(sensor), with_a_car(sensor)
    with pytest.raises(ValueError, match="that return nothing"):
        foreground.encode_foreground(RangeImage(sensor, image), scene, image > 0)
    with pytest.raises(ValueError, match="that return nothing"):
        foreground.encode_foreground(RangeImage(sensor, image), scene, np.zeros((2, 2), bool))
    sent, (header, _) = image > 0, read_message(message)
    for masks in ([~sent, ~sent], [sent], [np.zeros_like(sent)]):
        content = b"".join(image_coding.encode_mask(mask) for mask in masks)
        with pytest.raises(ValueError, match="missing pixels must not be sent"):
            foreground.restore(header, content, scene, sent.astype(np.int64), sent, 0)
    assert not foreground.restore(header, b"", scene, sent.astype(np.int64), sent, 0).missing.any()


def test_two_thousand_damaged_messages():
    """Bits, bytes and ends; no reader takes one for sound, and none that has a sound checksum again
    makes one crash."""
    sensor = stand(MODELS[0])
    scene = learnt(sensor, frames=5)
    missing = np.zeros(scene.first.shape, bool)
    missing[:5] = with_a_car(sensor)[:5] == 0
    message = foreground.encode_foreground(
        RangeImage(sensor, with_a_car(sensor), 1.0, 3), scene, missing
    )
    sound, rng, read = foreground.decode_foreground(message, scene), np.random.default_rng(0), 0
    for _ in range(2000):
        mutant = bytearray(message)
        for at in rng.integers(0, len(message), rng.integers(1, 5)):
            mutant[at] = rng.integers(256)
        mutant = mutant[: rng.integers(len(mutant))] if rng.random() < 0.2 else mutant
        mutant = mutant + rng.bytes(3) if rng.random() < 0.1 else mutant
        if mutant == message:
            continue
        with pytest.raises(ValueError, match=r"checksum|cut off"):
            foreground.decode_foreground(bytes(mutant), scene)
        resealed = bytes(mutant[:-4]) + struct.pack("<I", zlib.crc32(mutant[:-4]))
        try:
            restored = foreground.decode_foreground(resealed, scene)
        except ValueError:
            continue
        read += 1
        assert restored.image.shape == sound.image.shape
        assert np.isfinite(restored.image).all()
    assert read < 1000
    assert read_message(message)[0] == sound.header


def frame(seed=5):
    sensors = (stand(MODELS[0], "a"), stand(MODELS[0], "b", 3.0))
    return Frame(
        sensors,
        tuple(with_a_car(s, seed + k) for k, s in enumerate(sensors)),
        Objects.empty(),
        1.5,
        7,
    )


def watched():
    """A detector that remembers its points."""
    calls = []

    def detector(points):
        calls.append(points)
        return Detections(np.array([[len(points), 0, 1, 4, 2, 1.5, 0.0]]), np.array([0.5]))

    return detector, calls


def test_the_scheme_detects_in_clouds_like_those_of_early_fusion():
    seen = frame()
    scenes = [learnt(sensor, seed=k) for k, sensor in enumerate(seen.sensors)]
    detector, calls = watched()
    view = frame_view(seen, detector, AREA, scene=lambda k: scenes[k])
    raw, got = Early().fuse(view, [0, 1]), foreground.Foreground().fuse(view, [0, 1])
    assert len(calls[1]) == pytest.approx(len(calls[0]), abs=3)
    a, b = calls[0][np.lexsort(calls[0].T)], calls[1]
    nearest = np.sqrt(((a[:, None] - b[None]) ** 2).sum(axis=2).min(axis=1))
    assert (
        nearest.max() < 0.15
    )  # four standard deviations of the depth, along rays up to 1.5 times as long
    assert raw.bits.sum() == 96 * len(calls[0])
    assert (got.bits < 100 * 8).all()
    assert (got.bits % 8 == 0).all()
    assert got.ms > 0
    assert foreground.Foreground().fuse(view, [0, 1]).bits.tolist() == got.bits.tolist()
    assert len(calls) == 3


def test_schemes_need_scenes_cropped_as_points_are():
    site = Site("hill", np.array(AREA), relief=Relief(slope=(0.05, 0.0)))
    seen, (detector, calls) = frame(), watched()
    scenes = [learnt(sensor, seed=k) for k, sensor in enumerate(seen.sensors)]
    view = frame_view(seen, detector, site, scene=lambda k: scenes[k])
    Early().fuse(view, [0, 1])
    foreground.Foreground().fuse(view, [0, 1])
    assert len(calls[1]) == pytest.approx(len(calls[0]), abs=3)
    assert (
        0
        < len(calls[0])
        < len(frame_points(seen, area=AREA)[0]) + len(frame_points(seen, area=AREA)[1]) - 20
    )
    sensor = stand(MODELS[0])
    seen = Frame((sensor,), (ground(sensor),), Objects.empty())
    scene, (detector, calls) = learnt(sensor), watched()
    got = foreground.Foreground(sigmas=6.0).fuse(
        frame_view(seen, detector, AREA, scene=lambda k: scene), [0]
    )
    assert got.bits.tolist() == [8 * 43]
    assert len(calls[0]) > 100
    seen, (detector, _) = frame(), watched()
    with pytest.raises(ValueError, match="knows no empty scenes"):
        foreground.Foreground().fuse(frame_view(seen, detector, AREA), [0])
    assert isinstance(foreground.Foreground(), Scheme)
    assert (
        foreground.Foreground().digest
        == "Foreground(step=0.02, sigmas=4.0, name='foreground', max_step=0.32)"
    )
    with pytest.raises(ValueError, match="step must be"):
        foreground.Foreground(step=-1.0)
    for sigmas in (0.0, np.inf):
        with pytest.raises(ValueError, match="sigmas must be above 0"):
            foreground.Foreground(sigmas=sigmas)
    assert foreground.Foreground(sigmas=0.5).sigmas == 0.5


@pytest.mark.parametrize("model", MODELS, ids=lambda model: model.kind)
def test_missing_pixels_arrive_as_nothing(model):
    sensor = stand(model)
    scene, image = learnt(sensor), with_a_car(sensor)
    missing = np.zeros(image.shape, bool)
    missing[-6:, 3:17] = True
    kept = np.where(scene.shows(image) | missing, 0, image).astype(np.float32)
    message = foreground.encode_foreground(RangeImage(sensor, kept), scene, missing)
    restored = foreground.decode_foreground(message, scene)
    np.testing.assert_array_equal(restored.missing, missing)
    np.testing.assert_array_equal(restored.sent, kept > 0)
    assert (restored.image[missing] == 0).all()
    np.testing.assert_array_equal(
        restored.image[~restored.sent & ~missing], scene.first[~restored.sent & ~missing]
    )
    without = foreground.encode_foreground(RangeImage(sensor, kept), scene)
    assert (
        foreground.encode_foreground(RangeImage(sensor, kept), scene, np.zeros_like(missing))
        == without
    )
    assert 0 < len(message) - len(without) < 15
    assert not foreground.decode_foreground(without, scene).missing.any()


def test_sensors_blinded_in_part_or_dropping_out():
    seen = frame()
    scenes = [learnt(sensor, seed=k) for k, sensor in enumerate(seen.sensors)]
    half = seen.measurements[0].copy()
    half[:, :8] = 0
    for blinded in (np.zeros_like(half), half):
        detector, calls = watched()
        view = frame_view(
            replace(seen, measurements=(blinded, seen.measurements[1])),
            detector,
            AREA,
            scene=lambda k: scenes[k],
        )
        got = [
            scheme.fuse(view, sensors)
            for sensors in ([0, 1], [0])
            for scheme in (Early(), foreground.Foreground())
        ][1]
        assert len(calls[1]) == pytest.approx(len(calls[0]), abs=3)
        assert got.bits[0] < 100 * 8
        assert len(calls[3]) == pytest.approx(len(calls[2]), abs=2)
        assert len(calls[2]) == 0 if blinded is not half else len(calls[2]) > 100
    image = wide_ground(CAMERA)
    image[:, :20] = 0
    image[15:20, 30:35] = 4.0
    out, drawn = out_of(image)
    expected = drawn[drawn % 40 < 20]
    np.testing.assert_array_equal(np.flatnonzero(out.missing), expected)
    np.testing.assert_array_equal(out.pixels, np.flatnonzero(image.ravel() == 4.0))
    image = wide_ground(CAMERA)
    for share, low, high in ((0.05, 0.0, 0.01), (0.9, 0.85, 1.0)):
        dropped = (np.random.default_rng(0).random(image.shape) < share) & (image > 0)
        out, drawn = out_of(np.where(dropped, 0, image).astype(np.float32))
        among = np.isin(np.flatnonzero(dropped), drawn).sum()
        assert (out.missing & ~dropped).sum() == 0
        assert low * among <= out.missing.sum() <= high * among
    # Of 25 about the middle of 4 x 4 they are 16, about its corners 9; of 3 x 4 they are 12 of 25
    # at most.
    for rows, columns, missing in ((1, 1, 0), (1, 2, 0), (2, 2, 0), (3, 4, 0), (4, 4, 4)):
        image = wide_ground(CAMERA)
        image[20 : 20 + rows, 15 : 15 + columns] = 0
        out, _ = out_of(image)
        assert out.missing.sum() == missing
        assert not missing or out.missing[21:23, 16:18].all()


CAMERA = Sensor("c", DepthCamera(width=80, height=60), look((0.0, 0.0, 5.0), 0.0, 0.5))
LIDAR = Sensor(
    "l",
    SpinningLidar(channels=30, azimuth_step=0.1, fov_up=-0.2, fov_down=-0.8),
    pose(0.0, 0.0, 5.0),
)


def out_of(image, sensor=CAMERA, scene=None):
    captured = Captured(Frame((sensor,), (image,), Objects.empty()), 0, (-30.0, -30.0, 30.0, 30.0))
    scene = EmptyScene.from_render(sensor, wide_ground(sensor)) if scene is None else scene
    return foreground_pixels.standing_out(captured, scene), foreground_pixels.draw_scene(
        captured, scene
    ).pixels


def test_empty_scenes_and_open_rays_send_and_miss_nothing():
    out, drawn = out_of(wide_ground(CAMERA))
    assert (len(out.pixels), out.missing.sum()) == (0, 0)
    assert len(drawn) > 500
    close = np.full(CAMERA.model.shape, 0.3, np.float32)  # outside the crop, and hides the scene
    blind = [(sensor, np.zeros(sensor.model.shape, np.float32)) for sensor in (CAMERA, LIDAR)]
    for sensor, image in (*blind, (CAMERA, close)):
        out, drawn = out_of(image, sensor)
        np.testing.assert_array_equal(np.flatnonzero(out.missing), drawn)
        assert not len(out.pixels)
    assert (wide_ground(CAMERA)[:3] == 0).all()
    assert not out_of(blind[0][1])[0].missing[:3].any()  # the sky is not missed
    # The scene of a pixel whose second mode is nothing: alone it shows the scene, in a blinded part
    # it is
    # missing.
    scene = EmptyScene.from_render(CAMERA, wide_ground(CAMERA))
    second = np.full(scene.first.shape, np.nan, np.float32)
    second[15:25, 10:20] = 0
    scene = EmptyScene(
        **{**{name: getattr(scene, name) for name in scene.__dataclass_fields__}, "second": second}
    )
    image = wide_ground(CAMERA)
    image[15:25, 10:20] = 0
    assert not out_of(image, scene=scene)[0].missing.any()
    image[10:30, 8:22] = 0
    missing = out_of(image, scene=scene)[0].missing
    assert missing[11:15, 9:21].all()
    assert missing[15, 10]
    assert not missing[20, 15]
    nothing, drawn = out_of(np.zeros_like(image), scene=scene)
    np.testing.assert_array_equal(np.flatnonzero(nothing.missing), drawn)


@pytest.mark.parametrize(
    ("expected", "gone", "kept"),
    [
        ("2", "2", True),  # all of two
        ("22", "2.", False),  # two of four
        ("33", "3.", True),  # three of six: half
        ("34", "3.", False),  # three of seven
        ("1", "1", True),  # all of one
        ("5", "2", False),
        ("5", "4", True),
    ],
)
def test_missing_pixels_need_company(expected, gone, kept):
    """Digits count pixels in a column; beyond the two rows and columns that are searched, some are
    always there."""
    masks = [np.zeros((20, 20), bool) for _ in range(2)]
    for mask, columns in zip(masks, (expected, gone), strict=True):
        for column, count in enumerate(columns):
            mask[5 : 5 + (0 if count == "." else int(count)), 5 + column] = True
    there, missing = masks
    there[15:, :] = True  # not all of them are missing
    middle = 5 + min(2, (int(gone[0]) - 1) // 2), 5
    assert foreground_pixels.keep_neighbours(missing, there)[middle] == kept
    beside = missing.copy()
    beside[middle[0], 4] = beside[0, 0] = (
        True  # drop-outs that the scene does not expect: in company, and alone
    )
    assert foreground_pixels.keep_neighbours(beside, there)[[middle[0], 0], [4, 0]].tolist() == [
        kept,
        False,
    ]
    # all are missing
    np.testing.assert_array_equal(foreground_pixels.keep_neighbours(beside, missing), beside)


def test_missing_pixels_are_those_that_a_slow_count_finds():
    """Of those about each pixel, two to either side, that should show the scene, at least half must
    be missing, three or all of them."""
    rng = np.random.default_rng(0)
    for share in (0.2, 0.5, 0.8):
        expected = rng.random((12, 15)) < 0.7
        gone = rng.random((12, 15)) < share
        kept = foreground_pixels.keep_neighbours(gone, expected)
        for row, column in np.ndindex(gone.shape):
            about = slice(max(row - 2, 0), row + 3), slice(max(column - 2, 0), column + 3)
            missing, there = int((gone & expected)[about].sum()), int(expected[about].sum())
            enough = missing > 0 and 2 * missing >= there and (missing >= 3 or missing == there)
            assert kept[row, column] == (gone[row, column] and enough)
        assert 0 < kept.sum() < gone.size
    lone = np.zeros((12, 15), bool)
    lone[3, 4] = lone[3, 5] = True
    assert not foreground_pixels.keep_neighbours(
        lone, np.ones((12, 15), bool)
    ).any()  # two of twenty-five
    assert foreground_pixels.keep_neighbours(lone, lone).sum() == 2  # all that there are
    assert not foreground_pixels.keep_neighbours(lone, np.zeros((12, 15), bool)).any()
