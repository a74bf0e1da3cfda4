"""A packed file gives the points and objects of the recording it was made from."""

import h5py
import numpy as np
import pytest
from scipy.spatial import cKDTree

from models.training.packed import STEPS_PER_METRE, PackedFrames
from models.training.packing import join_packed_files, pack, recording
from models.training.samples import apply_errors
from toolkit.boxes import count_points
from toolkit.geometry import level_rows
from toolkit.points import frame_points
from toolkit.sensors.error_profiles import PAPER_ERRORS
from toolkit.sites.site import Relief, Site

AREA = (-12.8, -12.8, 12.8, 12.8)


def test_points_are_those_of_the_recording_with_fresh_noise(frames, packed):
    assert len(packed) == len(frames)
    for k, frame in enumerate(frames):
        ours, theirs = packed.points(k, None), frame_points(frame, area=AREA)
        for s, sensor in enumerate(frame.sensors):
            farthest_ray = np.linalg.norm(sensor.model.rays(), axis=-1).max()
            distance, _ = cKDTree(ours[s]).query(theirs[s])
            assert distance.max() <= 0.5 / STEPS_PER_METRE * farthest_ray + 1e-5
            assert abs(len(ours[s]) - len(theirs[s])) <= 4  # at the very edge of the crop
    for k, frame in enumerate(frames):
        np.testing.assert_array_equal(packed.objects(k).boxes, frame.objects.boxes)
        np.testing.assert_array_equal(packed.objects(k).labels, frame.objects.labels)
        # A point on a face may fall on either side of it.
        np.testing.assert_allclose(
            count_points(np.concatenate(packed.points(k, None)), widened(frame.objects.boxes)),
            count_points(
                np.concatenate(frame_points(frame, area=AREA)), widened(frame.objects.boxes)
            ),
            atol=2,
        )
    first, again, other = (packed.points(0, np.random.default_rng(seed))[0] for seed in (1, 1, 2))
    np.testing.assert_array_equal(first, again)
    assert len(first) != len(other) or not np.array_equal(first, other)
    rig, camera = packed.rig(0), frames[0].sensors[0]
    # things in the air everywhere, and nothing at the edges
    pixels, hovering = (rig.pixels[0], 0.8 * rig.depth[0])
    well_inside = rig.in_crop(rig.world(0, pixels, hovering), -0.5)
    hovering[~well_inside] = 0
    exact, noisy = (
        rig.measure(0, pixels, hovering, rng)[0] for rng in (None, np.random.default_rng(3))
    )
    assert len(exact) == len(noisy) == well_inside.sum() > 1000
    spread = (noisy - exact) @ camera.pose[:3, 2]
    assert abs(spread.mean()) < 0.1 * camera.model.sigma
    assert abs(spread.std() / camera.model.sigma - 1) < 0.05


def widened(boxes):
    return boxes + np.array([0, 0, 0, 0.02, 0.02, 0.02, 0])


def test_chosen_sensors_are_those_of_all(packed):
    everything, some = packed.points(1, None), packed.points(1, None, sensors=[2, 0])
    np.testing.assert_array_equal(some[0], everything[2])
    np.testing.assert_array_equal(some[1], everything[0])


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


def test_on_a_slope_points_and_objects_come_as_on_level_ground(frames, tmp_path):
    slope = (0.01, -0.02)
    site = Site("steep", np.array(AREA), relief=Relief(0.0, 0, slope))
    pack([recording(frames, AREA, slope=slope)], tmp_path / "steep.packed")
    join_packed_files([tmp_path / "steep.packed"], tmp_path / "again.packed")
    for name in ("steep", "again"):
        packed = PackedFrames(tmp_path / f"{name}.packed")
        assert packed.rig(0).slope == slope
        np.testing.assert_array_equal(packed.objects(1).boxes, frames[1].objects.boxes)
        np.testing.assert_allclose(
            packed.level_objects(1).boxes, level_rows(frames[1].objects.boxes, slope)
        )
        for ours, theirs in zip(
            packed.points(1, None), frame_points(frames[1], area=site), strict=True
        ):
            distance, _ = cKDTree(ours).query(level_rows(theirs, slope))
            assert distance.max() < 0.003
            assert abs(len(ours) - len(theirs)) <= 4
        assert (np.concatenate(apply_errors(packed, 1, PAPER_ERRORS, 3))[:, 2] > 0).all()


def test_a_slope_of_a_file_that_is_none_is_refused(packed_file, tmp_path):
    broken = tmp_path / "broken.packed"
    broken.write_bytes(packed_file.read_bytes())
    with h5py.File(broken, "r+") as file:
        file["rigs/0"].attrs["slope"] = [0.5, 0.0]
    with pytest.raises(ValueError, match="slope must be a rise along x and along y"):
        PackedFrames(broken)


@pytest.mark.parametrize("number", [-7, 10_000_000])
def test_a_pixel_that_the_sensor_lacks_is_named(packed_file, tmp_path, number):
    broken = tmp_path / "broken.packed"
    broken.write_bytes(packed_file.read_bytes())
    with h5py.File(broken, "r+") as file:
        pixels = file["rigs/0/pixels"][:].astype(np.int64)
        pixels[0] = number
        del file["rigs/0/pixels"]
        file["rigs/0/pixels"] = pixels
    with pytest.raises(ValueError, match=rf"rigs/0/pixels must be of the .* got {number}\b"):
        PackedFrames(broken)
