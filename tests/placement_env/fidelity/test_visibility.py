import sqlite3
from dataclasses import fields, replace

import numpy as np
import pytest

from placement_env.fidelity import visibility
from placement_env.fidelity.renders import Renders
from placement_env.fidelity.traffic import scored
from placement_env.fidelity.visibility import Visibility, see
from toolkit.boxes import count_points
from toolkit.datasets.dataset import CoopDataset, noisy
from toolkit.frame import Frame
from toolkit.geometry import pose
from toolkit.points import beyond, frame_points, inside, unproject
from toolkit.rendering.renderer import Renderer
from toolkit.runtime.array_files import write_arrays
from toolkit.runtime.cache import Cache
from toolkit.sensors.sensor import Sensor


@pytest.fixture(scope="module")
def seen(small_traffic, small_candidates):
    return see(small_traffic, small_candidates)


@pytest.fixture(scope="module")
def rendered(small_traffic):
    """Per frame and sensor the points in the crop, and the row of the object that each lies on."""
    site, found = small_traffic.site, []
    renderer = Renderer(site, small_traffic.bodies, site.sensors)
    for snapshot in small_traffic.snapshots:
        frame = []
        for sensor, depth, hits in zip(site.sensors, *renderer.render(snapshot), strict=True):
            points, valid = unproject(sensor, depth)
            keep = valid & inside(points.T, site.area, site.height)
            frame.append((points.T[keep], hits.ravel()[keep]))
        found.append(frame)
    return found


def equal(one: Visibility, other: Visibility) -> bool:
    return all(np.array_equal(getattr(one, field.name), getattr(other, field.name)) for field in fields(Visibility))


def test_points_are_those_the_renderer_hits(small_traffic, seen, rendered):
    for k, snapshot in enumerate(small_traffic.snapshots):
        rows = np.flatnonzero(scored(snapshot.objects, small_traffic.site))
        expected = [[(hits == row).sum() for row in rows] for _, hits in rendered[k]]
        found = seen.points[:, seen.frame == k]
        assert np.abs(found - np.array(expected).reshape(found.shape)).max(initial=0) <= 1  # rounding at an edge
        assert np.array_equal(seen.boxes[seen.frame == k], snapshot.objects.boxes[rows])
    assert (seen.points > 0).any(axis=1).all()
    assert seen.points.max() > 50


def test_points_are_those_on_objects_counted_in_the_boxes(seen, rendered):
    for k in range(seen.frames):
        found, boxes = seen.points[:, seen.frame == k], seen.boxes[seen.frame == k]
        on_objects = np.array([count_points(points[hits >= 0], boxes) for points, hits in rendered[k]])
        assert (np.abs(on_objects - found) <= 0.02 * found + 8).all()  # rounding on the faces of a box


def test_sent_is_the_mean_over_noise(small_traffic, small_candidates, seen):
    renders = [Renders(small_traffic, small_candidates, noise_seed=seed) for seed in range(4)]
    radius = small_traffic.site.hybrid_radius

    def far(r, k, c):
        points = r.clouds(k, c)
        return points[beyond(points, r.sensors[c], radius)]

    for measured, expected in ((Renders.clouds, seen.sent), (far, seen.far)):
        sent = [[[len(measured(r, k, c)) for k in range(5)] for c in range(4)] for r in renders]
        assert np.abs(np.mean(sent, axis=0) - expected).max() < 12 + 0.02 * expected.max()


def test_without_noise_sent_is_counted(small_traffic, small_candidates):
    exact = tuple(Sensor(s.name, replace(s.model, sigma=0.0), s.pose) for s in small_candidates.sensors)
    found = see(small_traffic, replace(small_candidates, sensors=exact))
    renderer = Renderer(small_traffic.site, small_traffic.bodies, exact)
    for k, snapshot in enumerate(small_traffic.snapshots):
        for c, (sensor, depth) in enumerate(zip(exact, renderer.render(snapshot).measurements, strict=True)):
            points, valid = unproject(sensor, depth)
            points = points.T[valid & inside(points.T, small_traffic.site.area, small_traffic.site.height)]
            assert abs(found.sent[c, k] - len(points)) < 2
            far = beyond(points, sensor, small_traffic.site.hybrid_radius).sum()
            assert abs(found.far[c, k] - far) < 2


class Recorded(CoopDataset):
    """A recording without a file."""

    def __init__(self, site, frames):
        self.site, self.frames, self.sensors = site, frames, site.sensors

    def __len__(self):
        return len(self.frames)

    def __getitem__(self, index):
        return self.frames[index]


@pytest.fixture(scope="module")
def recording(small_traffic):
    renderer = Renderer(small_traffic.site, small_traffic.bodies, small_traffic.site.sensors)
    rendered = [(renderer.render(snapshot).measurements, snapshot) for snapshot in small_traffic.snapshots]
    frames = [Frame(small_traffic.site.sensors, tuple(m), s.objects, s.time, k) for k, (m, s) in enumerate(rendered)]
    return Recorded(small_traffic.site, frames)


@pytest.mark.parametrize("seed", [None, 0, 7])
def test_of_a_recording_noisy_points_are_sent_and_noise_free_ones_count(recording, seen, seed):
    found, site = Visibility.of(recording, noise_seed=seed), recording.site
    frames = recording.frames if seed is None else [noisy(frame, seed) for frame in recording.frames]
    clouds = [frame_points(frame, area=site) for frame in frames]
    assert found.sent.tolist() == np.array([[len(cloud) for cloud in each] for each in clouds]).T.tolist()
    far = [[beyond(c, s, site.hybrid_radius).sum() for c, s in zip(each, site.sensors, strict=True)] for each in clouds]
    assert found.far.tolist() == np.array(far).T.tolist()
    clean = Visibility.of(recording, noise_seed=None)
    assert np.array_equal(found.points, clean.points)
    assert (found.sent != clean.sent).any() == (seed is not None)
    assert np.array_equal(found.boxes, seen.boxes)
    assert np.array_equal(found.frame, seen.frame)


def test_of_a_recording_only_the_first_frames(recording):
    first = Visibility.of(recording, 2)
    assert first.frames == 2
    assert np.array_equal(first.sent, Visibility.of(recording).sent[:, :2])


def test_blocks_make_no_difference(small_traffic, small_candidates, seen, monkeypatch):
    monkeypatch.setattr(visibility, "BLOCK_PIXELS", 6000)
    told: list[int] = []
    assert equal(see(small_traffic, small_candidates, progress=told.append), seen)
    assert told == [1, 2, 3, 4]
    turned = see(small_traffic, small_candidates.select([3, 1]))
    assert equal(turned, seen.select([3, 1]))


def test_what_is_kept_is_not_made_again(small_traffic, small_candidates, seen, tmp_path, monkeypatch):
    cache = Cache(tmp_path / "cache.sqlite")
    assert equal(see(small_traffic, small_candidates, cache=cache), seen)
    assert len(cache) == 1
    with sqlite3.connect(cache.path) as database:
        database.execute("UPDATE entries SET value = substr(value, 1, 500)")
    assert equal(see(small_traffic, small_candidates, cache=cache), seen)

    def fail(*_: object) -> None:
        raise AssertionError("made again")

    monkeypatch.setattr(visibility, "look_at", fail)
    assert equal(see(small_traffic, small_candidates, cache=cache), seen)
    with pytest.raises(AssertionError, match="made again"):
        see(replace(small_traffic, snapshots=small_traffic.snapshots[:1]), small_candidates, cache=cache)
    with pytest.raises(AssertionError, match="made again"):
        see(small_traffic, small_candidates.select([0]), cache=cache)
    monkeypatch.setattr(visibility, "code_digest", lambda *modules: "other")
    with pytest.raises(AssertionError, match="made again"):
        see(small_traffic, small_candidates, cache=cache)


@pytest.mark.parametrize("movement", [pose(yaw=0.3), pose(0.2)])
def test_a_sensor_that_was_only_turned_or_moved_is_looked_through_again(small_traffic, small_candidates, movement):
    cache, sensor = Cache(), small_candidates.sensors[1]
    for each in (sensor, replace(sensor, pose=sensor.pose @ movement)):
        there = replace(small_candidates.select([1]), sensors=(each,))
        assert equal(see(small_traffic, there, cache=cache), see(small_traffic, there))
    assert len(cache) == 2


def test_saved_and_loaded(seen, tmp_path):
    seen.save(tmp_path / "seen.npz")
    assert equal(Visibility.load(tmp_path / "seen.npz"), seen)
    write_arrays(tmp_path / "other.npz", {"points": seen.points})
    with pytest.raises(ValueError, match="must hold boxes, distance, far"):
        Visibility.load(tmp_path / "other.npz")


def test_distance_is_the_horizontal_one_to_the_centre(seen, small_candidates):
    offset = seen.boxes[3, :2] - small_candidates.sensors[1].position[:2]
    assert seen.distance[1, 3] == pytest.approx(np.linalg.norm(offset), rel=1e-6)


def test_nobody_sees_nothing(small_traffic, small_candidates):
    with pytest.raises(ValueError, match="there must be a candidate"):
        see(small_traffic, small_candidates.select([]))


@pytest.mark.slow
def test_processes_give_what_one_gives(small_traffic, small_candidates, seen, monkeypatch):
    monkeypatch.setattr(visibility, "BLOCK_PIXELS", 6000)
    assert equal(see(small_traffic, small_candidates, workers=2), seen)
