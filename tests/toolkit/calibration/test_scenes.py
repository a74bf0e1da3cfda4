"""Empty scenes of a recording, learnt when asked for."""

import warnings
from dataclasses import replace

import jaxtyping._decorator as jaxtyping_decorator
import numpy as np
import pytest

from toolkit.calibration import recording_scenes
from toolkit.calibration.cloud_image import OUTSIDE_GRID, SHARED_CELL
from toolkit.calibration.empty_scene import EmptyScene, learn_empty_scenes
from toolkit.calibration.lidar_grid import LidarGrid
from toolkit.calibration.recording_scenes import Scenes, learn_sample_scenes
from toolkit.calibration.scene_files import load_empty_scenes, save_empty_scenes
from toolkit.frame import Frame, SensorCloud
from toolkit.geometry import pose
from toolkit.objects import Objects
from toolkit.sensors.models import DepthCamera, RowLidar
from toolkit.sensors.sensor import Sensor

SENSORS = tuple(Sensor(name, DepthCamera(width=8, height=6), np.eye(4)) for name in "ab")


class Recording(list):
    reads = 0

    def __getitem__(self, index):
        self.reads += 1
        return super().__getitem__(index)


def recording():
    images = [np.full((3, 4), 10.0 * (1 + k), np.float32) for k in range(2)]
    return Recording(Frame(SENSORS, tuple(images), Objects.empty(), 0.1 * k, k) for k in range(5))


def test_scenes_are_learnt_once_on_grids_of_the_first_samples():
    frames = recording()
    scenes = Scenes(frames)
    assert (frames.reads, scenes.digests) == (0, [])
    assert scenes(1).first[0, 0] == pytest.approx(20, abs=0.05)
    assert scenes(0).name == "a"
    assert frames.reads <= 7
    assert scenes.digests == [scene.digest for scene in learn_empty_scenes(frames)]
    given = learn_empty_scenes(recording())
    scenes = Scenes(recording(), given[::-1])
    assert [scenes(k).digest for k in (0, 1)] == [scene.digest for scene in given]
    with pytest.raises(ValueError, match="empty scenes of b, none of a"):
        Scenes(recording(), given[1:])(0)
    # Later ones are counted in them: a lidar that was turned round by then lies outside.
    every = [sample(k, image) for k, image in enumerate(images())]
    low = [
        SensorCloud(
            "north",
            (9 * MODEL.rays()[3] * [1, 1, 3]).astype(np.float32),
            c.clouds[0].world_SE3_sensor,
        )
        for c in every
    ]
    late = [s.with_clouds((cloud,)) for s, cloud in zip(every, low, strict=True)]
    learnt = learn_sample_scenes([*every[:8], *late[:2]])["north"]
    assert learnt.left_out == {OUTSIDE_GRID: 2 * 60}
    assert learnt.scene.frames == 10
    nobody = Frame.of_clouds(
        "0", (SensorCloud("north", np.zeros((0, 3), np.float32), np.eye(4)),), Objects.empty()
    )
    with pytest.raises(ValueError, match="no cloud has a point"):
        learn_sample_scenes([nobody])
    learnt = learn_sample_scenes([nobody, *(sample(k, WALL) for k in range(5))])["north"]
    assert learnt.scene.frames == 5


MODEL = RowLidar((0.0, -0.1, -0.2, -0.3), columns=60)
WALL = np.full(MODEL.shape, 20.0, np.float32)
SOMEBODY = (slice(1, 3), slice(10, 14))


def sample(number, image, *, moved=0.0, name="north", twice=0):
    """The cloud of an image, `twice` of whose points have another behind them."""
    points = (MODEL.rays() * image[..., None])[image > 0]
    points = np.concatenate([points, 1.1 * points[:twice]]).astype(np.float32)
    cloud = SensorCloud(name, points, pose(3.0 + moved, 4.0, 5.0, yaw=1.0))
    return Frame.of_clouds(str(number), (cloud,), Objects.empty())


def images(count=10):
    """A wall, before which somebody passes in three of ten."""
    rng = np.random.default_rng(0)
    for k in range(count):
        image = WALL + rng.normal(0, 0.01, WALL.shape).astype(np.float32)
        if k % 10 in (2, 3, 4):
            image[SOMEBODY] = 12.0
        yield image


def test_who_passes_is_not_in_the_scene():
    learnt = learn_sample_scenes(sample(k, image, twice=5) for k, image in enumerate(images()))[
        "north"
    ]
    assert learnt.scene.name == "north"
    assert learnt.scene.model == learnt.grid.model
    assert learnt.scene.frames == 10
    np.testing.assert_allclose(learnt.scene.first, WALL, atol=0.03)
    np.testing.assert_allclose(learnt.grid.model.elevations, MODEL.elevations, atol=1e-4)
    assert learnt.points == 10 * (WALL.size + 5)
    assert learnt.left_out == {SHARED_CELL: 50}
    present = WALL.copy()
    present[SOMEBODY] = 12.0
    stands_out = ~learnt.scene.shows(present)
    assert stands_out[SOMEBODY].all()
    assert stands_out.sum() == 8


def test_scenes_are_learnt_when_asked_for():
    frames = Recording(sample(k, image) for k, image in enumerate(images()))
    scenes = Scenes(frames)
    assert (frames.reads, scenes.used) == (0, False)
    assert scenes.image(frames[0].clouds[0]).shown.all()
    reads = frames.reads
    assert scenes["north"] is scenes.every["north"]
    assert (frames.reads, scenes.used) == (reads, True)
    with pytest.raises(ValueError, match="there are empty scenes of north, none of south"):
        scenes["south"]


def test_scenes_are_learnt_given_or_none_for_sensors_that_move(tmp_path):
    learnt = learn_sample_scenes(sample(k, image) for k, image in enumerate(images()))["north"]
    save_empty_scenes(tmp_path / "scenes.npz", [learnt.scene])
    (loaded,) = load_empty_scenes(tmp_path / "scenes.npz")
    assert loaded.digest == learnt.scene.digest
    given = Scenes([], [loaded])
    assert given["north"].scene is loaded
    assert given.image(sample(0, WALL).clouds[0]).measurement.shape == MODEL.shape
    camera = EmptyScene.from_render(
        Sensor("c", DepthCamera(), np.eye(4)), np.ones(DepthCamera().shape, np.float32)
    )
    with pytest.raises(ValueError, match=r"learnt from images of DepthCamera.*, not from clouds"):
        Scenes([], [camera]).grid("c")
    with pytest.raises(
        ValueError, match=r"north moves, by 0\.6 m: only a sensor that stands still"
    ):
        learn_sample_scenes([sample(0, WALL), sample(1, WALL, moved=0.6)])
    here = sample(1, WALL)
    carried = replace(here, map_SE3_world=pose(0.0, 2.0))
    with pytest.raises(ValueError, match=r"north moves, by 2\.0 m"):
        learn_sample_scenes([here, carried])
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        learn_sample_scenes([sample(0, WALL), sample(1, WALL, moved=0.5)])
    with pytest.warns(
        UserWarning, match="learnt from 4 samples, so who stands still in them is part of the scene"
    ) as w:
        learn_sample_scenes(sample(k, WALL) for k in range(4))
    assert w[0].filename in (__file__, jaxtyping_decorator.__file__)  # that of make test-all
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        learn_sample_scenes(sample(k, WALL) for k in range(5))


@pytest.mark.parametrize(
    ("columns", "asked", "kept"), [(1800, 128, 128), (16384, 128, 64), (62500, 128, 16), (9, 1, 2)]
)
def test_large_images_are_kept_in_smaller_numbers(columns, asked, kept):
    grid = LidarGrid(RowLidar(tuple(np.linspace(0.3, -0.5, 64).tolist()), columns=columns))
    assert recording_scenes.CloudSceneLearner("north", grid, asked).learner.sample == kept


def test_only_sensors_of_the_first_samples_and_so_many_of_their_images_are_kept():
    """A wall at 20 m, and at 30 in the last sample: of two images kept, the last is one."""
    every = [sample(k, WALL * (1.5 if k == 4 else 1.0)) for k in range(5)]
    assert Scenes(every)["north"].scene.first[0, 0] == pytest.approx(20.0, abs=0.01)
    assert Scenes(every, sample=2)["north"].scene.first[0, 0] == pytest.approx(30.0, abs=0.01)
    late = [*(sample(k, WALL) for k in range(8)), sample(8, WALL, name="south")]
    assert list(learn_sample_scenes(late)) == ["north"]
