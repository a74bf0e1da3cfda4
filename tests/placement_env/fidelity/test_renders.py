import pickle
import sqlite3
from dataclasses import replace

import numpy as np
import pytest

from placement_env.fidelity.renders import Recorded, Renders
from placement_env.fidelity.visibility import Visibility
from toolkit.boxes import count_points
from toolkit.datasets.dataset import CoopDataset
from toolkit.datasets.recording_views import with_errors
from toolkit.datasets.simulation import simulate_dataset
from toolkit.frame import Frame
from toolkit.geometry import pose
from toolkit.points import frame_points, is_beyond
from toolkit.rendering.renderer import Renderer
from toolkit.runtime.cache import Cache
from toolkit.runtime.run import Run
from toolkit.sensors.error_profile import ErrorProfile
from toolkit.sensors.error_profiles import PAPER_ERRORS, POOR, TYPICAL
from toolkit.sensors.error_terms import Calibration, ClockOffset, rain
from toolkit.sites.files import load_site


@pytest.fixture(scope="module")
def renders(small_traffic, small_candidates):
    return Renders(small_traffic, small_candidates)


def test_clouds_without_noise_are_what_the_renderer_measures(small_traffic, small_candidates):
    quiet, site = Renders(small_traffic, small_candidates, noise_seed=None), small_traffic.site
    renderer = Renderer(site, small_traffic.bodies, site.sensors)
    for k, snapshot in enumerate(small_traffic.snapshots):
        frame = Frame(site.sensors, renderer.render(snapshot).measurements, snapshot.objects)
        for c, expected in enumerate(frame_points(frame, area=site)):
            found = quiet.clouds(k, c)
            assert abs(len(found) - len(expected)) <= 3  # a rounded depth may leave the crop
            assert np.allclose(np.median(found, axis=0), np.median(expected, axis=0), atol=0.05)
            counted = (count_points(cloud, snapshot.objects.boxes) for cloud in (found, expected))
            assert np.abs(np.subtract(*counted)).max(initial=0) <= 8
    quiet = Renders(small_traffic, small_candidates, noise_seed=None)
    whole = Renders(small_traffic, small_candidates, errors=ErrorProfile("none", ()))
    for k in range(5):
        for c in range(4):
            points, expected = (each.clouds(k, c) for each in (whole, quiet))
            assert len(points) == len(expected)
            assert np.allclose(np.sort(points, axis=0), np.sort(expected, axis=0), atol=1e-4)


def test_clouds_are_the_same_in_company(renders, small_traffic, small_candidates):
    assert renders.clouds(1, 2).dtype == np.float32
    turned = Renders(small_traffic, small_candidates.select([3, 2]))
    for k in (3, 0, 1):
        assert np.array_equal(turned.clouds(k, 1), renders.clouds(k, 2))
        assert np.array_equal(turned.clouds(k, 0), renders.clouds(k, 3))
    assert turned.digest == renders.digest
    assert np.array_equal(pickle.loads(pickle.dumps(turned)).clouds(1, 1), renders.clouds(1, 2))


def test_keys_follow_noise_and_profile(renders, small_traffic, small_candidates):
    other = Renders(small_traffic, small_candidates, noise_seed=1)
    assert other.digest != renders.digest
    assert not np.array_equal(other.clouds(1, 2)[:50], renders.clouds(1, 2)[:50])
    paper = Renders(small_traffic, small_candidates, errors=PAPER_ERRORS)
    assert paper.digest == renders.digest
    assert paper.clouds(1, 2).tobytes() == renders.clouds(1, 2).tobytes()
    profiles = (PAPER_ERRORS, TYPICAL, POOR, ErrorProfile("typical", (*TYPICAL.terms, rain(1.0))))
    assert (
        len({Renders(small_traffic, small_candidates, errors=each).digest for each in profiles})
        == 4
    )
    renamed = Renders(small_traffic, small_candidates, errors=replace(TYPICAL, name="other"))
    assert renamed.digest == Renders(small_traffic, small_candidates, errors=TYPICAL).digest
    with pytest.raises(ValueError, match="drawn from a seed"):
        Renders(small_traffic, small_candidates, noise_seed=None, errors=TYPICAL)


def test_clouds_of_errors_are_the_same_in_any_company(small_traffic, small_candidates):
    still = small_traffic.snapshots[2]
    twice = type(small_traffic)(small_traffic.site, small_traffic.bodies, (still, still))
    found = Renders(twice, small_candidates)
    assert not np.array_equal(found.clouds(0, 0)[:50], found.clouds(1, 0)[:50])
    late = ErrorProfile("late", (ClockOffset(0.1),))
    with pytest.raises(ValueError, match=r"at most 0\.5 s apart, got 5 s"):
        Renders(small_traffic, small_candidates, errors=late).clouds(0, 0)
    dense = [replace(each, time=each.time / 50) for each in small_traffic.snapshots]
    said = Renders(
        replace(small_traffic, snapshots=tuple(dense)), small_candidates, errors=late
    ).clouds(1, 0)
    assert len(said) > 100
    rough = Renders(small_traffic, small_candidates, errors=POOR)
    turned = Renders(small_traffic, small_candidates.select([3, 2]), errors=POOR)
    for k in (3, 0):
        assert np.array_equal(turned.clouds(k, 1), rough.clouds(k, 2))
        assert np.array_equal(turned.clouds(k, 0), rough.clouds(k, 3))
    assert np.array_equal(pickle.loads(pickle.dumps(turned)).clouds(3, 1), rough.clouds(3, 2))
    other = Renders(small_traffic, small_candidates, noise_seed=1, errors=POOR)
    assert not np.array_equal(other.clouds(3, 2)[:9], rough.clouds(3, 2)[:9])


def test_errors_are_drawn_anew_for_each_block_or_once(small_traffic, small_candidates):
    """The last of five frames is of the second block of four: there the sensors are mounted
    anew."""
    crooked = ErrorProfile("crooked", (Calibration(0.02, 0.1),))

    def believed(renders):
        return [renders._read_frame(k, 0).sensors[0].pose.round(9).tolist() for k in range(5)]

    anew = Renders(small_traffic, small_candidates, errors=crooked)
    poses = believed(anew)
    assert poses[0] == poses[1] == poses[2] == poses[3] != poses[4]
    once = anew.draw_once(0, [0], 5)
    poses = believed(once)
    assert poses.count(poses[0]) == 5
    assert len(once.sensors) == 1
    assert anew.draw_once(1, [0], 3).frames == 3
    assert believed(anew.draw_once(1, [0], 5))[0] != poses[0]
    assert len({anew.digest, once.digest, Renders(small_traffic, small_candidates).digest}) == 3
    assert pickle.loads(pickle.dumps(once)).digest == once.digest


def test_far_points_and_objects(renders, small_traffic):
    points, sensor = renders.clouds(0, 1), renders.sensors[1]
    assert 0 < is_beyond(points, sensor, small_traffic.site.hybrid_radius).sum() < len(points)
    assert renders.objects(0) is small_traffic.snapshots[0].objects
    assert renders.frames == 5


def test_a_cache_is_shared_and_its_damage_repaired(
    renders, small_traffic, small_candidates, tmp_path, fail
):
    path = tmp_path / "cache.sqlite"
    first = Renders(small_traffic, small_candidates, Cache(path))
    assert np.array_equal(first.clouds(0, 1), renders.clouds(0, 1))
    with sqlite3.connect(path) as database:  # a bit of what is kept
        for key, value in database.execute("SELECT key, value FROM entries").fetchall():
            damaged = value[:-9] + bytes([value[-9] ^ 1]) + value[-8:]
            database.execute("UPDATE entries SET value = ? WHERE key = ?", [damaged, key])
    assert np.array_equal(
        Renders(small_traffic, small_candidates, Cache(path)).clouds(0, 1), renders.clouds(0, 1)
    )
    assert np.array_equal(
        Renders(small_traffic, small_candidates, Cache(path)).clouds(3, 1), renders.clouds(3, 1)
    )
    assert len(Cache(path)) == 3  # the empty site, and two parts of the frames
    fail(Renderer, "render")
    kept = Renders(small_traffic, small_candidates.select([1]), Cache(path), noise_seed=0)
    assert np.array_equal(kept.clouds(3, 0), renders.clouds(3, 1))
    with pytest.raises(AssertionError, match="render was called"):
        Renders(small_traffic, small_candidates.select([0]), Cache(path)).clouds(3, 0)


def test_a_sensor_that_was_only_turned_is_rendered_again(small_traffic, small_candidates, tmp_path):
    cache, sensor = Cache(tmp_path / "cache.sqlite"), small_candidates.sensors[1]
    turned = replace(sensor, pose=sensor.pose @ pose(yaw=0.3))
    clouds = []
    for each in (sensor, turned):
        there = replace(small_candidates.select([1]), sensors=(each,))
        clouds.append(Renders(small_traffic, there, cache).clouds(0, 0))
        assert np.array_equal(clouds[-1], Renders(small_traffic, there).clouds(0, 0))
    assert len(cache) == 4
    assert not np.array_equal(*clouds)


def test_code_that_changed_is_run_again(small_traffic, small_candidates, tmp_path, change_code):
    cache = Cache(tmp_path / "cache.sqlite")
    digest = Renders(small_traffic, small_candidates).digest
    Renders(small_traffic, small_candidates, cache).clouds(0, 0)
    change_code("placement_env.fidelity.renders")
    Renders(small_traffic, small_candidates, cache).clouds(0, 0)
    assert len(cache) == 4  # the empty site, and a part of the frames
    assert digest != Renders(small_traffic, small_candidates).digest


def test_only_so_many_stay_in_memory(renders, small_traffic, small_candidates, limits):
    limits("placement_env.fidelity.renders", MAX_PARTS_IN_MEMORY=2)
    kept = Renders(small_traffic, small_candidates, Cache())
    for c in (0, 1, 2, 0, 3):
        assert np.array_equal(kept.clouds(0, c), renders.clouds(0, c))
    assert list(kept._packed) == [(0, 0), (3, 0)]


def test_only_frames_of_the_part_that_is_asked_for_are_rendered(
    renders, small_traffic, small_candidates, limits, spy
):
    expected = [renders.clouds(k, 0) for k in (1, 3)]
    limits("placement_env.fidelity.renders", RENDER_PARTS=2)
    calls = spy(Renderer, "render")
    few = Renders(small_traffic, small_candidates, Cache())
    for k, cloud in zip((1, 3), expected, strict=True):
        assert np.array_equal(few.clouds(k, 0), cloud)
    assert [small_traffic.snapshots.index(call.args[1]) for call in calls] == [1, 3]


@pytest.fixture(scope="module")
def recording(tmp_path_factory, small_traffic):
    path = tmp_path_factory.mktemp("recording") / "two.hdf5"
    site = load_site("tjunction")
    simulate_dataset(site, path, run=Run(frames=2, seed=1), sensors=site.sensors[:2])
    with CoopDataset(path) as dataset:
        yield dataset


def test_a_recording_gives_the_points_of_an_evaluation(recording):
    renders = Recorded(recording)
    for k in (1, 0):
        expected = frame_points(with_errors(recording[k], "paper", 0), area=recording.site)
        assert all(np.array_equal(renders.clouds(k, c), cloud) for c, cloud in enumerate(expected))
        assert np.array_equal(renders.objects(k).boxes, recording[k].objects.boxes)
    assert len(renders.digest) == 64
    assert renders.digest != Recorded(recording, 1).digest


def test_a_recording_gives_the_visibility_of_an_evaluation(recording):
    seen, renders = Visibility.from_recording(recording), Recorded(recording)
    assert seen.sent.tolist() == [[len(renders.clouds(k, c)) for k in range(2)] for c in range(2)]
    far = [
        [
            is_beyond(renders.clouds(k, c), sensor, recording.site.hybrid_radius).sum()
            for k in range(2)
        ]
        for c, sensor in enumerate(recording.sensors)
    ]
    assert seen.far.tolist() == far
    clouds = frame_points(recording[1], area=recording.site)
    boxes = seen.boxes[seen.frame == 1]
    assert seen.points[:, seen.frame == 1].tolist() == [
        count_points(cloud, boxes).tolist() for cloud in clouds
    ]
    assert Visibility.from_recording(recording, 1).frames == 1


def test_a_recording_is_read_with_the_errors_of_a_profile(recording):
    rough = Recorded(recording, errors=TYPICAL)
    for k in (1, 0):
        expected = frame_points(with_errors(recording[k], TYPICAL, 0), area=recording.site)
        assert all(np.array_equal(rough.clouds(k, c), cloud) for c, cloud in enumerate(expected))
    assert (
        len({Recorded(recording, errors=each).digest for each in (PAPER_ERRORS, TYPICAL, POOR)})
        == 3
    )
    assert Recorded(recording).digest == Recorded(recording, errors=PAPER_ERRORS).digest


def test_another_profile_costs_no_rendering(small_traffic, small_candidates, tmp_path, fail):
    cache = Cache(tmp_path / "cache.sqlite")
    Renders(small_traffic, small_candidates, cache).clouds(0, 0)
    Renders(small_traffic, small_candidates, cache, errors=TYPICAL).clouds(0, 0)
    assert len(cache) == 4  # in the crop, and whole, each the empty site and a part of the frames
    fail(Renderer, "render")
    kept = Renders(small_traffic, small_candidates, cache, errors=POOR)
    assert np.array_equal(
        kept.clouds(0, 0), Renders(small_traffic, small_candidates, cache, errors=POOR).clouds(0, 0)
    )


@pytest.mark.parametrize("errors", [PAPER_ERRORS, TYPICAL], ids=["paper", "typical"])
def test_images_are_behind_the_points_and_show_the_empty_scene_but_for_traffic(
    small_traffic, small_candidates, errors
):
    found = Renders(small_traffic, small_candidates, errors=errors)
    for k, c in ((0, 1), (3, 2)):
        captured, points = found.captured(k, c), found.clouds(k, c)
        sent = captured.sending(captured.pixels)
        assert (sent.sensor.name, sent.number) == (found.sensors[c].name, k)
        placed = (
            captured.sensor.world_rays[:, captured.pixels].T
            * captured.measurement.ravel()[captured.pixels, None]
        )
        np.testing.assert_allclose(placed + captured.sensor.position, points, atol=1e-4)
        shows = found.scene(c).shows(captured.measurement).ravel()[captured.pixels]
        assert 0.5 < shows.mean() < 1
        on_cars = count_points(points[~shows], small_traffic.snapshots[k].objects.boxes).sum()
        assert (
            on_cars
            > 0.95 * count_points(points, small_traffic.snapshots[k].objects.boxes).sum() - 30
        )


def test_the_empty_scene_of_a_render_has_the_models_noise(renders):
    scene = renders.scene(1)
    assert scene is renders.scene(1)
    assert (scene.name, scene.model, scene.frames) == (
        renders.sensors[1].name,
        renders.sensors[1].model,
        1,
    )
    np.testing.assert_allclose(scene.spread[scene.first > 0], 0.015)
    assert np.isnan(scene.second).all()
