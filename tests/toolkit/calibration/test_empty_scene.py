"""The empty scene of a sensor, learnt from images with traffic, leaves, drop-outs and parked
cars."""

from dataclasses import replace

import numpy as np
import pytest

from toolkit.calibration import empty_scene, pixel_clusters, scene_files
from toolkit.frame import Frame
from toolkit.geometry import look
from toolkit.objects import Objects
from toolkit.runtime.array_files import write_arrays
from toolkit.sensors.models import DepthCamera, SolidStateLidar, SpinningLidar
from toolkit.sensors.sensor import Sensor, SensorModel

MODELS: list[SensorModel] = [
    *(
        DepthCamera(width=24, height=20, stride=2),
        SpinningLidar(channels=10, azimuth_step=float(np.deg2rad(30))),
    ),
    SolidStateLidar(rows=10, columns=12),
]
CAMERA = Sensor("cam", MODELS[0], look((0.0, 0.0, 5.0), 0.0))
SHAPE = (10, 12)
TIMES = 100


def still(far=20.0):
    """A wall, and nothing above it."""
    image = np.full(SHAPE, far, np.float32)
    image[:2] = 0
    return image


def learnt(change, sensor=CAMERA, times=TIMES, seed=0):
    """From images that `change(k, image, rng)` changes before noise is drawn."""
    rng, learner = np.random.default_rng(seed), empty_scene.SceneLearner(sensor)
    for k in range(times):
        image = still()
        change(k, image, rng)
        learner.add(sensor.model.noisy(image, rng))
    return learner.scene()


def nothing(k, image, rng):
    pass


@pytest.mark.parametrize("model", MODELS, ids=lambda model: model.kind)
def test_a_wall_and_the_sky(model):
    scene = learnt(nothing, Sensor("s", model, look((0.0, 0.0, 5.0), 0.0)))
    deviation = float(np.max(model.deviation(np.array([20.0], np.float32))))
    # 4 deviations of a median of 100
    np.testing.assert_allclose(scene.first[2:], 20, atol=0.6 * deviation)
    assert (scene.first[:2] == 0).all()
    assert (scene.spread[:2] == 0).all()
    assert (scene.spread[2:] >= 0.999 * deviation).all()
    assert scene.spread[2:].max() < 1.6 * deviation
    assert np.isnan(scene.second).all()
    assert (scene.share == 1).all()
    assert scene.frames == TIMES


def test_traffic_queues_and_who_parks_are_not_the_scene_and_who_never_leaves_is():
    def cars(k, image, rng):
        if rng.random() < 0.6:
            image[4:8, 2:9] = rng.uniform(8, 15)

    scene = learnt(cars)
    np.testing.assert_allclose(scene.first[2:], 20, atol=0.02)
    assert np.isnan(scene.second).all()
    assert 0.3 < scene.share[5, 5] < 0.5

    def parked(k, image, rng):
        image[4:8, 0:4] = 9.0
        if k < 85:
            image[4:8, 6:10] = 11.0

    scene = learnt(parked)
    np.testing.assert_allclose(scene.first[4:8, 6:10], 20, atol=0.03)
    np.testing.assert_allclose(scene.first[4:8, 0:4], 9, atol=0.01)
    assert np.isnan(scene.second).all()

    def gone(k, image, rng):
        image[5, 5] = 11.0 if k < 91 else 20.0

    assert learnt(gone).first[5, 5] == pytest.approx(11, abs=0.01)

    def queue(k, image, rng):
        if k % 4 < 2:
            image[4:7, 3:8] = 10.0

    scene = learnt(queue)
    np.testing.assert_allclose(scene.first[2:], 20, atol=0.03)
    assert np.isnan(scene.second).all()


def test_leaves_drop_outs_and_feet_of_cars_are_modes_or_none():
    def leaves(k, image, rng):
        image[4:7, 3:6] = 10.0
        image[4:7, 6:8] = np.where(rng.random((3, 2)) < 0.7, 10.0, 20.0)

    scene = learnt(leaves)
    np.testing.assert_allclose(scene.first[4:7, 3:8], 10, atol=0.02)
    np.testing.assert_allclose(scene.second[4:7, 6:8], 20, atol=0.03)
    assert np.isfinite(scene.second).sum() == 6
    np.testing.assert_allclose(scene.share + scene.second_share, 1)

    def parked_beside(
        k, image, rng
    ):  # as far as the wall beside it, but it comes once and goes once
        image[4:7, 3:6] = 10.0
        image[4:7, 6:8] = 10.0 if k < 70 else 20.0

    alone = learnt(parked_beside)
    np.testing.assert_allclose(alone.first[4:7, 6:8], 20, atol=0.03)
    assert np.isnan(alone.second).all()
    # Half of the time in one run: of n images random draws come n / 4 times, and a quarter of that
    # is once in 16.
    for images, flickers in ((14, True), (16, True), (18, False)):
        for begins in (True, False):

            def once(k, image, rng):
                image[4:7, 3:6] = 10.0
                image[4:7, 6:8] = 10.0 if (k < images / 2) == begins else 20.0  # noqa: B023

            assert (np.isfinite(learnt(once, times=images).second[4:7, 6:8]) == flickers).all()
    both = still()
    both[4:7, 3:6], both[4:7, 6:8] = 10, [10, 20]
    assert scene.shows(both).all()
    # The ground of the pixel below lies where the car stands.
    ground = (5 / (0.1 + 0.1 * np.arange(10, dtype=np.float32)))[:, None] + np.zeros(
        SHAPE, np.float32
    )
    rng, learner = np.random.default_rng(0), empty_scene.SceneLearner(CAMERA)
    for _ in range(TIMES):
        image = ground.copy()
        if rng.random() < 0.4:
            image[3:6, 4:8] = ground[6, 0]
        learner.add(CAMERA.model.noisy(image, rng))
    scene = learner.scene()
    np.testing.assert_allclose(scene.first, ground, atol=0.02)
    assert np.isnan(scene.second).all()

    def dark(k, image, rng):
        image[3:6][rng.random((3, 12)) < 0.02] = 0
        image[7:9][rng.random((2, 12)) < 0.3] = 0

    scene = learnt(dark)
    np.testing.assert_allclose(scene.first[2:], 20, atol=0.03)
    assert np.isnan(scene.second[3:6]).all()
    assert (scene.second[7:9] == 0).all()
    assert scene.shows(np.zeros(SHAPE, np.float32))[[0, 4, 8], 0].tolist() == [True, False, True]


def test_spreads_are_those_of_noise_and_not_of_who_stands_close():
    """Cars at every distance from the wall to two metres before it chain with it."""

    def close(k, image, rng):
        if rng.random() < 0.5:
            image[4:8, 2:9] = rng.uniform(18, 20)

    scene = learnt(close)
    np.testing.assert_allclose(scene.first[2:], 20, atol=0.05)
    assert scene.spread[2:].max() <= 2 * 0.017
    assert np.isnan(scene.second).all()
    assert 0.4 < scene.share[4:8, 2:9].mean() < 0.65
    far = np.linspace(10, 60, 10, dtype=np.float32)[:, None] + np.zeros(SHAPE, np.float32)
    rng, learner = np.random.default_rng(1), empty_scene.SceneLearner(CAMERA)
    for _ in range(TIMES):
        learner.add((far + rng.normal(0, 1, SHAPE) * far**2 * 1e-4).astype(np.float32))
    scene = learner.scene()
    np.testing.assert_allclose(
        np.median(scene.spread, axis=1), np.maximum(far[:, 0] ** 2 * 1e-4, 0.016), rtol=0.35
    )
    assert scene.shows((far + 3 * far**2 * 1e-4).astype(np.float32)).mean() > 0.9
    scene = learnt(nothing)
    off = np.array([0, 3.9, -3.9, 4.1, -4.1, np.nan], np.float32)
    image = still()
    image[5, :6] = scene.first[5, :6] + off * scene.spread[5, :6]
    image[0, 0] = 7
    assert scene.shows(image)[5, :6].tolist() == [True, True, True, False, False, False]
    assert not scene.shows(image)[0, 0]
    assert scene.shows(image, sigmas=5.0)[5, 3:5].all()
    with pytest.raises(ValueError, match="has \\(10, 12\\) pixels, got an image of \\(2, 2\\)"):
        scene.shows(np.ones((2, 2), np.float32))


def test_learners_sample_all_frames_and_known_scenes_have_the_models_spread():
    learner = empty_scene.SceneLearner(CAMERA, sample=8)
    for k in range(100):
        learner.add(np.full(SHAPE, 1.0 + k, np.float32))
        assert len(learner.images) <= 8
    assert [int(image[0, 0]) - 1 for image in learner.images] == [0, 16, 32, 48, 64, 80, 96]
    assert learner.scene().frames == 100
    with pytest.raises(ValueError, match="add one before"):
        empty_scene.SceneLearner(CAMERA).scene()
    with pytest.raises(ValueError, match="measures \\(10, 12\\) pixels, got \\(3, 3\\)"):
        empty_scene.SceneLearner(CAMERA).add(np.ones((3, 3), np.float32))
    with pytest.raises(ValueError, match="at least 2"):
        empty_scene.SceneLearner(CAMERA, sample=1)
    scene = learnt(nothing, times=1)
    np.testing.assert_allclose(scene.first[2:], 20, atol=0.1)
    np.testing.assert_allclose(scene.spread[2:], 0.015)
    scene = empty_scene.EmptyScene.from_render(
        Sensor("s", MODELS[2], look((0.0, 0.0, 5.0), 0.0)), still()
    )
    np.testing.assert_array_equal(scene.first, still())
    np.testing.assert_allclose(scene.spread[2:], 0.02 + 0.0003 * 20)
    assert (scene.spread[:2] == 0).all()
    assert np.isnan(scene.second).all()
    assert scene.frames == 1


def recording(frames=30):
    rng = np.random.default_rng(3)
    sensors = tuple(Sensor(model.kind, model, look((0.0, 0.0, 5.0), 0.0)) for model in MODELS)
    images = [tuple(model.noisy(still(), rng) for model in MODELS) for _ in range(frames)]
    return [Frame(sensors, each, Objects.empty(), 0.1 * k, k) for k, each in enumerate(images)]


def test_of_a_recording_come_back_as_they_were_saved(tmp_path):
    frames = recording()
    scenes = empty_scene.learn_empty_scenes(frames, sample=10)
    assert [scene.name for scene in scenes] == ["camera", "lidar", "solidstate"]
    assert [scene.frames for scene in scenes] == [10] * 3
    scene_files.save_empty_scenes(tmp_path / "scenes.npz", scenes)
    loaded = scene_files.load_empty_scenes(tmp_path / "scenes.npz")
    assert [scene.digest for scene in loaded] == [scene.digest for scene in scenes]
    assert [scene.model for scene in loaded] == MODELS
    assert len({scene.digest for scene in scenes} | {replace(scenes[0], name="other").digest}) == 4
    with pytest.raises(ValueError, match="got 0 of 30"):
        empty_scene.learn_empty_scenes(frames, frames=0)


def test_files_and_scenes_that_are_damaged_or_none_are_refused(tmp_path):
    path = tmp_path / "scenes.npz"
    scene_files.save_empty_scenes(path, [learnt(nothing, times=3)])
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 1
    path.write_bytes(content)
    with pytest.raises(ValueError, match="checksum"):
        scene_files.load_empty_scenes(path)

    write_arrays(
        path,
        {"scenes": np.array('[{"name": "a", "model": {"class": "DepthCamera"}, "frames": 3}]')},
    )
    with pytest.raises(ValueError, match="has no empty scenes"):
        scene_files.load_empty_scenes(path)
    scene = learnt(nothing, times=3)
    images = {
        name: getattr(scene, name)
        for name in ("first", "spread", "share", "second", "second_spread")
    }
    images |= {"name": "a", "model": scene.model, "second_share": scene.second_share, "frames": 3}
    assert empty_scene.EmptyScene(**images).digest == replace(scene, name="a").digest
    cut = {name: image[:3] for name, image in images.items() if isinstance(image, np.ndarray)}
    for wrong in ({"first": -scene.first}, cut, {"share": scene.share * np.float32(np.inf)}):
        with pytest.raises(ValueError, match="must be"):
            empty_scene.EmptyScene(**images | wrong)
    with pytest.raises(ValueError, match="at least one frame"):
        empty_scene.EmptyScene(**images | {"frames": 0})


def test_a_broad_cluster_is_narrowed_to_the_median_and_spread_of_its_densest_stretch():
    def one(value):
        return np.full((1, 1), value, np.float32)

    # from 10.03 the four that lie close are off by 1, 1, 3 and 5 cm
    values = (10.0, 10.02, 10.04, 10.08, 12.0, 15.0)
    mode = pixel_clusters.PixelMode(one(10.06), one(1.0), one(1.0), one(10.0), one(15.0))
    found = pixel_clusters.narrow_broad(mode, one(0.01), [one(value) for value in values])
    assert found.median.item() == pytest.approx(10.03)
    assert found.spread.item() == pytest.approx(1.4826 * 0.01, abs=1e-5)
    assert found.share.item() == pytest.approx(4 / 6)
    kept = pixel_clusters.narrow_broad(mode, one(0.5), [one(value) for value in values])
    assert kept.spread.item() == 1.0
