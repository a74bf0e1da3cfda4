"""coview convert and coview survey --layout: from a simulated recording to a public layout and
back."""

import json
import shutil
from itertools import islice

import h5py
import numpy as np
import pytest

from toolkit.datasets.box_frames import move_boxes
from toolkit.datasets.recording_views import read


def test_our_recording_as_kitti_and_back(recording, tmp_path, run):
    arguments = ("convert", recording, "--layout", "hdf5", "--frames", 1)
    assert run(*arguments, "--to", "kitti", "--out", tmp_path / "k")[0] == 0
    (before,), (after,) = [next(read(recording, "hdf5"))], read(tmp_path / "k", "kitti")
    np.testing.assert_allclose(after.objects.boxes[:, :6], before.objects.boxes[:, :6], atol=1e-3)
    code, said, _ = run(
        "convert",
        tmp_path / "k",
        "--layout",
        "kitti",
        "--to",
        "folder",
        "--classes",
        "vehicle",
        "--out",
        tmp_path / "f",
        "--json",
    )
    assert code == 0
    assert json.loads(said)["samples"] == 1
    (again,) = read(tmp_path / "f", "folder")
    assert set(again.objects.labels.tolist()) == {0}
    code, said, _ = run("survey", tmp_path / "f", "--layout", "folder", "--json")
    assert code == 0
    assert json.loads(said)["objects_per_frame"]["vehicle"] == len(again.objects)


def test_into_our_hdf5_and_out_of_it(recording, tmp_path, run, work_in):
    """Recorded clouds as one file, which is scored, surveyed and packed as any other layout."""
    source = "import toolkit.objects as o\ndef it(points): return o.Detections.empty()\n"
    (tmp_path / "finds_nothing.py").write_text(source)
    work_in(tmp_path)
    clouds = tmp_path / "clouds.hdf5"
    assert (
        run(
            "convert", recording, "--layout", "hdf5", "--to", "hdf5", "--frames", 1, "--out", clouds
        )[0]
        == 0
    )
    (before,), (after,) = [next(read(recording, "hdf5"))], read(clouds, "hdf5")
    np.testing.assert_array_equal(after.objects.boxes, before.objects.boxes)
    np.testing.assert_array_equal(after.points(), before.points())
    assert (
        after.complete.record()
        == before.complete.record()
        == {"kind": "rectangle", "area": [-40, -20, 40, 20]}
    )
    code, said, _ = run("survey", clouds, "--layout", "hdf5", "--json")
    assert code == 0
    assert json.loads(said)["frames"] == 1
    assert run("doctor", clouds, "--layout", "hdf5")[:2] == (0, "nothing suspected\n")
    area = ("--layout", "hdf5", "--area", -40, -20, 40, 20)
    assert run("pack", clouds, *area, "--out", tmp_path / "c.packed")[0] == 0
    code, said, problems = run(
        "evaluate", clouds, "--detector", "finds_nothing:it", *area, "--out", tmp_path / "e"
    )
    assert code == 0, problems
    assert (
        run("convert", clouds, "--layout", "hdf5", "--to", "openlabel", "--out", tmp_path / "back")[
            0
        ]
        == 0
    )
    (back,) = read(tmp_path / "back", "openlabel")
    np.testing.assert_allclose(back.objects.boxes[:, :6], before.objects.boxes[:, :6], atol=1e-3)


@pytest.mark.parametrize("layout", ["nuscenes", "openlabel", "hdf5"])
def test_a_published_recording_goes_into_other_layouts(recording, tmp_path, run, layout):
    """One without what only ours has: it is recognised by its cameras."""
    published, out = tmp_path / "published.hdf5", tmp_path / ("o.hdf5" if layout == "hdf5" else "o")
    shutil.copy(recording, published)
    with h5py.File(published, "r+") as file:
        del file["coview"]
        for group in file["cameras"].values():
            for name in list(group.attrs):
                del group.attrs[name]
    arguments = (
        "convert",
        published,
        "--layout",
        "hdf5",
        "--frames",
        2,
        "--to",
        layout,
        "--out",
        out,
    )
    assert run(*arguments)[0] == 0
    for before, after in zip(islice(read(recording, "hdf5"), 2), read(out, layout), strict=True):
        a, b = (
            move_boxes(sample.map_SE3_world, sample.objects.boxes) for sample in (before, after)
        )
        if layout == "openlabel":  # which has no place for a map
            a, b = before.objects.boxes, after.objects.boxes
        np.testing.assert_allclose(a[:, :6], b[:, :6], atol=1e-3)
        assert np.rad2deg(np.abs(np.angle(np.exp(1j * (a[:, 6] - b[:, 6]))))).max() < 0.01
        assert after.objects.labels.tolist() == before.objects.labels.tolist()
        assert len(after.points()) == len(before.points())


def test_a_file_that_is_there_is_kept(recording, tmp_path, refused):
    clouds = tmp_path / "clouds.hdf5"
    clouds.write_bytes(b"mine")
    arguments = ("convert", recording, "--layout", "hdf5", "--to", "hdf5")
    assert "--overwrite" in refused(*arguments, "--out", clouds)
    assert "is a folder" in refused(*arguments, "--out", tmp_path, "--overwrite")
    assert clouds.read_bytes() == b"mine"


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        *((("--to", "rcooper"), "only read"), (("--to", "kiti"), "no layout 'kiti'")),
        (("--to", "folder", "--frames", 0), "--frames must be at least 1"),
    ],
)
def test_what_is_refused(recording, tmp_path, refused, arguments, says):
    assert says in refused(
        "convert", recording, "--layout", "hdf5", *arguments, "--out", tmp_path / "x"
    )
    assert not (tmp_path / "x").exists()


def test_sensors_with_errors(recording, tmp_path, run, refused):
    arguments = ("convert", recording, "--layout", "hdf5", "--frames", 1, "--to", "folder")
    assert run(*arguments, "--errors", "surveyed", "--seed", 3, "--out", tmp_path / "e")[0] == 0
    (crooked,), true = read(tmp_path / "e", "folder"), next(read(recording, "hdf5"))
    pairs = zip(crooked.clouds, true.clouds, strict=True)
    moved = [np.abs(a.world_SE3_sensor - b.world_SE3_sensor).max() for a, b in pairs]
    assert 0 < min(moved) < max(moved) < 0.1
    assert "unknown error profile 'bad'" in refused(
        *arguments, "--errors", "bad", "--out", tmp_path / "x"
    )
    says = refused(
        "convert",
        tmp_path / "e",
        "--layout",
        "folder",
        "--to",
        "kitti",
        "--errors",
        "typical",
        "--out",
        tmp_path / "x",
    )
    assert "recorded clouds have errors of their own" in says


def test_links_out_of_a_data_set_are_not_followed(recording, tmp_path, run, refused):
    assert (
        run("convert", recording, "--frames", 1, "--to", "folder", "--out", tmp_path / "f")[0] == 0
    )
    cloud = next((tmp_path / "f").glob("*/*.pcd"))
    cloud.rename(tmp_path / "elsewhere.pcd")
    cloud.symlink_to(tmp_path / "elsewhere.pcd")
    assert run("survey", tmp_path / "f")[0] == 0
    for command in (("convert", "--to", "kitti"), ("pack",)):
        assert "leads out of" in refused(
            command[0], tmp_path / "f", *command[1:], "--out", tmp_path / "out"
        )
        assert not (tmp_path / "out").exists()
