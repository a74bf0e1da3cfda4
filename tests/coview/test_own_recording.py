"""The page on your own roadside recording, command by command, on one that is made and on a real one."""

import json
import os
from pathlib import Path

import pytest

from models.training.packed import PackedFrames
from toolkit.datasets.samples import read, write_samples

ROOT = Path(__file__).parents[2]
LOG = Path(os.environ.get("COVIEW_SHARED", ROOT.parent / "shared")) / "real" / "av2_two_lidars"
REACH = ("--area", -30, -30, 30, 30)


def rows(path, measure):
    content = json.loads(path.read_text())
    wanted = ("vehicle", "ours", measure, "all")
    return [r for r in content["rows"] if (r["label"], r["protocol"], r["measure"], r["among"]) == wanted]


@pytest.fixture(scope="session")
def own(recording, tmp_path_factory):
    """One frame of a simulated recording as a folder of clouds."""
    folder = tmp_path_factory.mktemp("own") / "mine"
    samples = [sample for sample, _ in zip(read(recording, "hdf5"), range(1), strict=False)]
    write_samples(samples, folder, "folder")
    return folder


def test_from_a_folder_to_ap(own, tmp_path, run):
    mine = (own, "--layout", "folder")
    assert "objects per sample" in run("survey", *mine)[1]
    assert run("doctor", *mine)[:2] == (0, "nothing suspected\n")
    assert run("detect", *mine, *REACH, "--level", "plane", "--still", "--out", tmp_path / "boxes.json")[0] == 0
    assert len(json.loads((tmp_path / "boxes.json").read_text())["samples"]) == 1
    assert run("evaluate", *mine, *REACH, "--level", "plane", "--still", "--out", tmp_path / "e")[0] == 0
    (row,) = rows(tmp_path / "e" / "table.json", "BEV 0.5")
    assert row["ap"] > 0.5
    assert run("convert", *mine, "--to", "kitti", "--out", tmp_path / "kitti")[0] == 0


@pytest.mark.slow
def test_from_a_folder_to_a_trained_detector(own, tmp_path, run):
    packed = tmp_path / "mine.packed"
    assert run("pack", own, "--layout", "folder", *REACH, "--level", "plane", "--out", packed)[0] == 0
    assert len(PackedFrames(packed)) == 1
    trained = ("train", "--data", packed, "--start", "general", "--preset", "general", "--epochs", 1, "--batch", 1)
    code, _, err = run(*trained, "--workers", 0, "--out", tmp_path / "runs")
    assert code == 0, err
    assert (tmp_path / "runs" / "weights.safetensors").is_file()


@pytest.mark.skipif(not LOG.is_dir(), reason="the recording is not here")
def test_the_real_log(tmp_path, run):
    pytest.importorskip("pyarrow")
    log = (LOG, "--layout", "argoverse")
    assert "162 of 162 labelled cuboids hold as many points as the set says" in run("survey", *log)[1]
    assert run("doctor", *log)[:2] == (0, "nothing suspected\n")
    found = {}
    for level in ("none", "plane"):
        arguments = ("--frames", 1, "--classes", "vehicle", "--level", level, "--out", tmp_path / level)
        assert run("evaluate", *log, *arguments)[0] == 0
        (row,) = rows(tmp_path / level / "table.json", "BEV 0.5")
        found[level] = row["ap"]
    assert found["plane"] > 0.5
    assert found["plane"] > found["none"]
