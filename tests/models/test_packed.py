"""A packed file gives the points and objects of the recording it was made from."""

from dataclasses import replace

import h5py
import numpy as np
import pytest
from scipy.spatial import cKDTree

from models.packed import STEPS_PER_METRE, PackedFrames
from models.packing import pack, recording
from toolkit.boxes import count_points
from toolkit.points import frame_points

AREA = (-12.8, -12.8, 12.8, 12.8)


def ordered(points):
    return points[np.lexsort(points.round(2).T)]


def test_points_are_those_of_the_recording_within_the_quantisation(frames, packed):
    assert len(packed) == len(frames)
    for k, frame in enumerate(frames):
        ours, theirs = packed.points(k, None), frame_points(frame, area=AREA)
        for s, sensor in enumerate(frame.sensors):
            farthest_ray = np.linalg.norm(sensor.model.rays(), axis=-1).max()
            distance, _ = cKDTree(ours[s]).query(theirs[s])
            assert distance.max() <= 0.5 / STEPS_PER_METRE * farthest_ray + 1e-5
            assert abs(len(ours[s]) - len(theirs[s])) <= 4  # at the very edge of the crop


def test_objects_are_those_of_the_recording(frames, packed):
    for k, frame in enumerate(frames):
        np.testing.assert_array_equal(packed.objects(k).boxes, frame.objects.boxes)
        np.testing.assert_array_equal(packed.objects(k).labels, frame.objects.labels)
        # A point on a face may fall on either side of it.
        np.testing.assert_allclose(
            count_points(np.concatenate(packed.points(k, None)), widened(frame.objects.boxes)),
            count_points(np.concatenate(frame_points(frame, area=AREA)), widened(frame.objects.boxes)),
            atol=2,
        )


def widened(boxes):
    return boxes + np.array([0, 0, 0, 0.02, 0.02, 0.02, 0])


def test_noise_is_fresh_and_has_the_sensors_spread(frames, packed):
    first, again, other = (packed.points(0, np.random.default_rng(seed))[0] for seed in (1, 1, 2))
    np.testing.assert_array_equal(first, again)
    assert len(first) != len(other) or not np.array_equal(first, other)
    rig, camera = packed.rig(0), frames[0].sensors[0]
    pixels, hovering = rig.pixels[0], 0.8 * rig.depth[0]  # things in the air everywhere, and nothing at the edges
    well_inside = rig.in_crop(rig.world(0, pixels, hovering), -0.5)
    hovering[~well_inside] = 0
    exact, noisy = (rig.points(0, pixels, hovering, rng) for rng in (None, np.random.default_rng(3)))
    assert len(exact) == len(noisy) == well_inside.sum() > 1000
    spread = (noisy - exact) @ camera.pose[:3, 2]
    assert abs(spread.mean()) < 0.1 * camera.model.sigma
    assert abs(spread.std() / camera.model.sigma - 1) < 0.05


def test_chosen_sensors_are_those_of_all(packed):
    everything, some = packed.points(1, None), packed.points(1, None, sensors=[2, 0])
    np.testing.assert_array_equal(some[0], everything[2])
    np.testing.assert_array_equal(some[1], everything[0])


def test_an_empty_scene_learnt_from_the_frames_gives_the_same_points(frames, packed, tmp_path):
    pack([recording(frames, AREA)], tmp_path / "learnt.packed")
    learnt = PackedFrames(tmp_path / "learnt.packed")
    for k in range(len(frames)):
        for ours, theirs in zip(learnt.points(k, None), packed.points(k, None), strict=True):
            assert len(ours) == len(theirs)
            np.testing.assert_allclose(ordered(ours).mean(axis=0), ordered(theirs).mean(axis=0), atol=1e-3)


def test_recordings_of_different_sensors_share_a_file(frames, packed, tmp_path):
    fewer = [replace(f, sensors=f.sensors[:1], measurements=f.measurements[:1]) for f in frames[:2]]
    path = tmp_path / "two.packed"
    assert pack([recording(fewer, (-5, -5, 5, 5), 3.0), recording(frames, AREA, count=3)], path) == 5
    two = PackedFrames(path)
    assert [len(two.rig(k).sensors) for k in range(5)] == [1, 1, 3, 3, 3]
    assert two.rig(0).area == (-5, -5, 5, 5)
    small = two.points(0, None)[0]
    assert len(small)
    assert (np.abs(small[:, :2]) <= 5).all()
    assert (small[:, 2] < 3).all()
    np.testing.assert_array_equal(two.objects(4).boxes, frames[2].objects.boxes)
    assert [len(p) for p in two.points(3, None)] == [len(p) for p in packed.points(1, None)]


def test_same_recording_same_bytes(frames, tmp_path):
    for name in ("a", "b"):
        pack([recording(frames, AREA)], tmp_path / name)
    assert (tmp_path / "a").read_bytes() == (tmp_path / "b").read_bytes()


def test_what_fails_leaves_no_file(tmp_path):
    with pytest.raises(ValueError, match="no frames"):
        pack([], tmp_path / "none.packed")
    assert not (tmp_path / "none.packed").exists()


@pytest.mark.parametrize("damage", ["cut", "text", "missing", "other"])
def test_damage_is_named_in_one_line(packed_file, tmp_path, damage):
    path = tmp_path / "damaged.packed"
    if damage == "cut":
        path.write_bytes(packed_file.read_bytes()[:-2000])
    elif damage == "text":
        path.write_text("not a packed file")
    elif damage == "other":
        h5py.File(path, "w").close()
    with pytest.raises((ValueError, FileNotFoundError), match=r"damaged.packed") as error:
        PackedFrames(path)
    assert "\n" not in str(error.value)


def test_two_packs_at_once_to_one_file_both_work(frames, tmp_path):
    out = tmp_path / "x.packed"

    def recordings():
        yield recording(frames, AREA, count=1)
        assert pack([recording(frames, AREA, count=2)], out) == 2
        assert len(PackedFrames(out)) == 2

    assert pack(recordings(), out) == 1
    assert len(PackedFrames(out)) == 1
    assert [path.name for path in tmp_path.iterdir()] == ["x.packed"]
