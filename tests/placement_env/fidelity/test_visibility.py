import sqlite3
from dataclasses import fields, replace

import numpy as np
import pytest

from placement_env.fidelity import seeing
from placement_env.fidelity.seeing import see
from placement_env.fidelity.visibility import Visibility
from toolkit.datasets.dataset import CoopDataset
from toolkit.datasets.recording_views import with_errors
from toolkit.frame import Frame
from toolkit.geometry import look, pose
from toolkit.points import frame_points, is_beyond
from toolkit.rendering.renderer import Renderer
from toolkit.runtime.array_files import write_arrays
from toolkit.runtime.run import Run
from toolkit.sensors.sensor import Sensor


def equal(one: Visibility, other: Visibility) -> bool:
    return all(
        np.array_equal(getattr(one, field.name), getattr(other, field.name))
        for field in fields(Visibility)
    )


class Recorded(CoopDataset):
    def __init__(self, site, frames):
        self.site, self.frames, self.sensors = site, frames, site.sensors

    def __len__(self):
        return len(self.frames)

    def __getitem__(self, index):
        return self.frames[index]


@pytest.fixture(scope="module")
def recording(small_traffic):
    renderer = Renderer(small_traffic.site, small_traffic.bodies, small_traffic.site.sensors)
    rendered = [
        (renderer.render(snapshot).measurements, snapshot) for snapshot in small_traffic.snapshots
    ]
    frames = [
        Frame(small_traffic.site.sensors, tuple(m), s.objects, s.time, k)
        for k, (m, s) in enumerate(rendered)
    ]
    return Recorded(small_traffic.site, frames)


@pytest.mark.parametrize("seed", [None, 0, 7])
def test_of_a_recording_noisy_points_are_sent_and_noise_free_ones_count(recording, seen, seed):
    found, site = Visibility.from_recording(recording, noise_seed=seed), recording.site
    frames = (
        recording.frames
        if seed is None
        else [with_errors(frame, "paper", seed) for frame in recording.frames]
    )
    clouds = [frame_points(frame, area=site) for frame in frames]
    assert (
        found.sent.tolist()
        == np.array([[len(cloud) for cloud in each] for each in clouds]).T.tolist()
    )
    far = [
        [is_beyond(c, s, site.hybrid_radius).sum() for c, s in zip(each, site.sensors, strict=True)]
        for each in clouds
    ]
    assert found.far.tolist() == np.array(far).T.tolist()
    per_frame = [found.points[:, found.frame == k].sum(axis=1) for k in range(found.frames)]
    assert found.on_objects.tolist() == np.array(per_frame).T.tolist()
    clean = Visibility.from_recording(recording, noise_seed=None)
    assert np.array_equal(found.points, clean.points)
    assert (found.sent != clean.sent).any() == (seed is not None)
    assert np.array_equal(found.boxes, seen.boxes)
    assert np.array_equal(found.frame, seen.frame)


def test_of_a_recording_only_the_first_frames(recording):
    first = Visibility.from_recording(recording, 2)
    assert first.frames == 2
    assert np.array_equal(first.sent, Visibility.from_recording(recording).sent[:, :2])


def test_blocks_make_no_difference(small_traffic, small_candidates, seen, limits):
    limits(seeing, MAX_BLOCK_PIXELS=6000)
    told: list[int] = []
    assert equal(
        see(
            small_traffic, small_candidates, run=Run(progress=lambda *stage: told.append(stage[1]))
        ),
        seen,
    )
    assert told == [1, 2, 3, 4]
    assert equal(see(small_traffic, small_candidates.select([3, 1])), seen.select([3, 1]))


def test_what_is_kept_is_not_made_again(
    small_traffic, small_candidates, seen, tmp_path, fail, change_code
):
    run = Run(cache=tmp_path)
    assert equal(see(small_traffic, small_candidates, run=run), seen)
    assert len(run.memo) == 1
    with sqlite3.connect(run.memo.path) as database:
        database.execute("UPDATE entries SET value = substr(value, 1, 500)")
    assert equal(see(small_traffic, small_candidates, run=run), seen)
    fail(seeing, "look_at", AssertionError("made again"))
    assert equal(see(small_traffic, small_candidates, run=run), seen)
    with pytest.raises(AssertionError, match="made again"):
        see(
            replace(small_traffic, snapshots=small_traffic.snapshots[:1]), small_candidates, run=run
        )
    with pytest.raises(AssertionError, match="made again"):
        see(small_traffic, small_candidates.select([0]), run=run)
    change_code(seeing.__name__)
    with pytest.raises(AssertionError, match="made again"):
        see(small_traffic, small_candidates, run=run)


@pytest.mark.parametrize("movement", [pose(yaw=0.3), pose(0.2)])
def test_a_sensor_that_turned_or_moved_is_looked_through_again(
    small_traffic, small_candidates, movement, tmp_path
):
    run, sensor = Run(cache=tmp_path), small_candidates.sensors[1]
    for each in (sensor, replace(sensor, pose=sensor.pose @ movement)):
        there = replace(small_candidates.select([1]), sensors=(each,))
        assert equal(see(small_traffic, there, run=run), see(small_traffic, there))
    assert len(run.memo) == 2


def test_saved_and_loaded(seen, tmp_path):
    seen.save(tmp_path / "seen.npz")
    assert equal(Visibility.load(tmp_path / "seen.npz"), seen)
    write_arrays(tmp_path / "other.npz", {"points": seen.points})
    with pytest.raises(ValueError, match="must hold boxes, distance, far"):
        Visibility.load(tmp_path / "other.npz")


def test_distances_are_horizontal_and_nobody_sees_nothing(seen, small_candidates, small_traffic):
    offset = seen.boxes[3, :2] - small_candidates.sensors[1].position[:2]
    assert seen.distance[1, 3] == pytest.approx(np.linalg.norm(offset), rel=1e-6)
    with pytest.raises(ValueError, match="there must be a candidate"):
        see(small_traffic, small_candidates.select([]))


def test_processes_share_the_places(small_traffic, small_candidates):
    """Blocks of frames, from places that each process has for itself."""
    traffic = small_traffic.part(0, 10)
    alone = see(traffic, small_candidates, rendering="panorama")
    shared = see(traffic, small_candidates, rendering="panorama", run=Run(workers=2))
    assert equal(shared, alone)
    assert alone.points.any()


@pytest.mark.slow
def test_processes_give_what_one_gives(small_traffic, small_candidates, seen, limits):
    limits(seeing, MAX_BLOCK_PIXELS=6000)
    assert equal(see(small_traffic, small_candidates, run=Run(workers=2)), seen)


def test_panoramas_are_taken_where_poses_share_places_in_range(small_traffic, small_candidates):
    few = small_candidates.select([0])
    at = (-22.0, -16.0, 6.0)
    sensors = tuple(
        Sensor(str(k), few.sensors[0].model, look(at, 0.4 + 0.2 * k, 0.3)) for k in range(4)
    )
    zeros = np.zeros((4, 5), np.int64)
    shared = replace(few, sensors=sensors, factors=zeros)
    exact, quick = (see(small_traffic, shared, rendering=each) for each in ("full", "panorama"))
    assert equal(see(small_traffic, shared), quick)
    assert not equal(exact, quick)
    assert np.abs(exact.points - quick.points).max() <= 8
    alone = shared.select([2])
    assert equal(see(small_traffic, alone), see(small_traffic, alone, rendering="full"))
    assert equal(see(small_traffic, alone, rendering="panorama"), quick.select([2]))
    lidar = small_candidates.sensors[3]
    short = replace(
        small_candidates.select([3]),
        sensors=(replace(lidar, model=replace(lidar.model, max_range=15.0)),),
    )
    full, other = (see(small_traffic, short, rendering=each) for each in ("full", "panorama"))
    assert equal(full, other)
    mixed = replace(small_candidates, sensors=(*small_candidates.sensors[:3], *short.sensors))
    seen = see(small_traffic, mixed, rendering="panorama")
    assert np.array_equal(seen.points[3], full.points[0])
    assert np.array_equal(seen.sent[3], full.sent[0])
    whole = see(small_traffic, mixed, rendering="full")
    assert not np.array_equal(seen.points[:3], whole.points[:3])
    with pytest.raises(
        ValueError, match="rendering must be one of auto, full, panorama, got 'fast'"
    ):
        see(small_traffic, mixed, rendering="fast")
