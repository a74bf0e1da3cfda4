"""What is packed: of each frame what differs from the empty site, whole under its name or not
there."""

from dataclasses import replace
from itertools import chain

import h5py
import numpy as np
import pytest

from models.training.packed import PackedFrames
from models.training.packing import (
    encode_packed_file,
    join_packed_files,
    pack,
    read_recordings,
    recording,
    sample_recordings,
)
from toolkit.objects import Objects
from toolkit.sites.site import Site

AREA = (-12.8, -12.8, 12.8, 12.8)


def ordered(points):
    return points[np.lexsort(points.round(2).T)]


def test_learnt_scenes_and_other_sensors_share_a_file(frames, packed, tmp_path):
    pack([recording(frames, AREA)], tmp_path / "learnt.packed")
    learnt = PackedFrames(tmp_path / "learnt.packed")
    for k in range(len(frames)):
        for ours, theirs in zip(learnt.points(k, None), packed.points(k, None), strict=True):
            assert len(ours) == len(theirs)
            np.testing.assert_allclose(
                ordered(ours).mean(axis=0), ordered(theirs).mean(axis=0), atol=1e-3
            )
    fewer = [replace(f, sensors=f.sensors[:1], measurements=f.measurements[:1]) for f in frames[:2]]
    path = tmp_path / "two.packed"
    assert (
        pack([recording(fewer, (-5, -5, 5, 5), 3.0), recording(frames, AREA, count=3)], path) == 5
    )
    two = PackedFrames(path)
    assert [len(two.rig(k).sensors) for k in range(5)] == [1, 1, 3, 3, 3]
    assert two.rig(0).area == (-5, -5, 5, 5)
    small = two.points(0, None)[0]
    assert len(small)
    assert (np.abs(small[:, :2]) <= 5).all()
    assert (small[:, 2] < 3).all()
    np.testing.assert_array_equal(two.objects(4).boxes, frames[2].objects.boxes)
    assert [len(p) for p in two.points(3, None)] == [len(p) for p in packed.points(1, None)]


def test_packed_files_repeat_joined_or_at_once(frames, tmp_path):
    for name in ("a", "b"):
        pack([recording(frames, AREA)], tmp_path / name)
    assert (tmp_path / "a").read_bytes() == (tmp_path / "b").read_bytes()
    fewer = [replace(f, sensors=f.sensors[:1], measurements=f.measurements[:1]) for f in frames[:2]]
    both = [(frames, AREA), (fewer, (-5, -5, 5, 5))]
    for name, chosen in (("at_once", both), ("a", both[:1]), ("b", both[1:])):
        pack([recording(each, area) for each, area in chosen], tmp_path / name)
    assert join_packed_files([tmp_path / "a", tmp_path / "b"], tmp_path / "joined") == 8
    assert (tmp_path / "joined").read_bytes() == (tmp_path / "at_once").read_bytes()
    with pytest.raises(ValueError, match="no frames"):
        join_packed_files([], tmp_path / "none")


def test_two_packs_at_once_both_work_and_drawn_junctions_are_recordings(frames, tmp_path):
    out = tmp_path / "x.packed"

    def recordings():
        yield recording(frames, AREA, count=1)
        assert pack([recording(frames, AREA, count=2)], out) == 2
        assert len(PackedFrames(out)) == 2

    assert pack(recordings(), out) == 1
    assert len(PackedFrames(out)) == 1
    assert [path.name for path in tmp_path.iterdir()] == ["x.packed"]
    site = Site("drawn", np.array(AREA))
    empty = tuple(np.zeros_like(each) + 9 for each in frames[0].measurements)
    pack([recording(frames[:2], AREA, 4.0, empty=empty)], tmp_path / "x")
    assert encode_packed_file((site, tuple(frames[:2]), empty)) == (tmp_path / "x").read_bytes()


def test_a_packed_file_written_again_is_the_same(frames, packed_file, tmp_path):
    pack(read_recordings(packed_file), tmp_path / "again.packed")
    assert (tmp_path / "again.packed").read_bytes() == packed_file.read_bytes()


def levelled(sensors, seed, area=AREA):
    rng = np.random.default_rng(seed)
    clouds = tuple(rng.uniform(-10, 10, (5 + k, 3)).astype(np.float32) for k in range(len(sensors)))
    return sensors, clouds, Objects(np.array([[float(seed), 0, 0.75, 4, 2, 1.5, 0.5]])), area


def test_recorded_clouds_are_packed_beside_simulated_frames(frames, packed, tmp_path):
    samples = [levelled(("a", "b"), 0), levelled(("a", "b"), 1), levelled(("a",), 2)]
    path = tmp_path / "mixed.packed"
    assert (
        pack(chain(sample_recordings(iter(samples)), [recording(frames, AREA, count=2)]), path) == 5
    )
    mixed = PackedFrames(path)
    assert [mixed.is_recorded(k) for k in range(5)] == [True, True, True, False, False]
    assert [len(mixed.rig(k).sensors) for k in range(5)] == [2, 2, 1, 3, 3]
    for k, each in enumerate(samples):
        for ours, cloud in zip(mixed.points(k, np.random.default_rng(0)), each[1], strict=True):
            np.testing.assert_allclose(ours, cloud, atol=0.5 / 512 + 1e-6)  # no noise is drawn
        np.testing.assert_array_equal(mixed.objects(k).boxes, each[2].boxes)
    assert len(mixed.points(1, None, [1])) == 1
    for k in range(2):
        for ours, theirs in zip(mixed.points(3 + k, None), packed.points(k, None), strict=True):
            np.testing.assert_allclose(
                ordered(ours).mean(axis=0), ordered(theirs).mean(axis=0), atol=1e-3
            )


def test_packed_clouds_can_be_packed_again_unless_damaged(tmp_path):
    pack(sample_recordings([levelled(("a",), 3)]), tmp_path / "one.packed")
    pack(read_recordings(tmp_path / "one.packed"), tmp_path / "two.packed")
    assert (tmp_path / "one.packed").read_bytes() == (tmp_path / "two.packed").read_bytes()
    path = tmp_path / "one.packed"
    for name, values in (("frames", [7]), ("ends", [[0, 99]]), ("points", [[1, 2]])):
        pack(sample_recordings([levelled(("a",), 3)]), path)
        with h5py.File(path, "a") as file:
            del file[f"clouds/{name}"]
            file[f"clouds/{name}"] = np.array(values)
        with pytest.raises(ValueError, match="not a packed file"):
            PackedFrames(path)
    with pytest.raises(ValueError, match="no frames"):
        pack([], tmp_path / "none.packed")
    assert not (tmp_path / "none.packed").exists()
