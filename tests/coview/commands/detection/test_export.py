"""`coview export`, and its files as detectors of every command."""

import json

import numpy as np
import pytest

from coview.detector_spec import DetectorSpec
from coview.detectors import load_detector, open_detector
from models.network.grid import voxelise
from models.onnx_files import OnnxDetector
from toolkit.datasets.dataset import CoopDataset
from toolkit.detection.background import KnownBackground
from toolkit.points import frame_points

pytest.importorskip("onnxscript")
onnx = pytest.importorskip("onnx")


@pytest.mark.slow
@pytest.mark.parametrize("name", ["tjunction", "general", "roundabout"])
def test_shipped_networks_detect_the_same(name, recording, tmp_path, run):
    site = CoopDataset(recording).site
    area = site.area.tolist() if name == "general" else None
    asked = ("export", name, tmp_path / "a.onnx", "--json", *(("--area", *area) if area else ()))
    code, said, err = run(*asked)
    assert code == 0, err
    assert json.loads(said)["card"] == str(tmp_path / "a.onnx.json")
    nodes = onnx.load(tmp_path / "a.onnx").graph.node
    assert not [
        each for each in nodes if each.op_type == "ScatterND" and each.attribute
    ]  # its threads lose summands
    exported, torches = load_detector(tmp_path / "a.onnx"), load_detector(name, area=area)
    assert isinstance(exported.network, OnnxDetector)
    assert (exported.labels, exported.area) == (torches.labels, torches.area)
    found = 0
    for frame in (CoopDataset(recording)[k] for k in range(2)):
        points = np.concatenate(frame_points(frame, area=site)).astype(np.float32)
        for some in (points, points[::7], points[:50]):
            maps = torches.network.network(voxelise(some, torches.network.config))._asdict()
            for key, each in exported.network.run(some).items():
                np.testing.assert_allclose(each, maps[key], atol=1e-4, rtol=1e-5)
            one, other = exported.network(some), torches.network(some)
            np.testing.assert_allclose(one.boxes, other.boxes, atol=2e-3)
            np.testing.assert_allclose(one.scores, other.scores, atol=1e-4)
            np.testing.assert_array_equal(one.labels, other.labels)
            found += len(one)
    assert found > 10


@pytest.mark.slow
def test_commands_take_the_file_for_a_detector(recording, tmp_path, run, refused):
    area = ("--area", -40, -20, 40, 20)
    assert run("export", "tjunction", tmp_path / "t.onnx")[0] == 0
    assert "exists" in refused("export", "tjunction", tmp_path / "t.onnx")
    rows = []
    for detector in ("tjunction", tmp_path / "t.onnx"):
        evaluated = ("evaluate", recording, "--schemes", "early", "--detector", detector, "--json")
        code, said, err = run(*evaluated, "--out", tmp_path / f"{len(rows)}")
        assert code == 0, err
        rows.append([each["ap"] for each in json.loads(said)["rows"]])
    np.testing.assert_allclose(*rows, atol=1e-3)
    site = CoopDataset(recording).site
    known = open_detector(DetectorSpec.from_name(f"{tmp_path / 't.onnx'}+background"), site)
    assert isinstance(known, KnownBackground)
    assert known.name == f"{tmp_path / 't.onnx'}+background"
    found = ("detect", recording, "--detector", tmp_path / "t.onnx")
    assert run(*found, *area, "--level", "none", "--out", tmp_path / "boxes.json")[0] == 0
    assert "got -9 -20 9 20" in refused(
        *found, "--area", -9, -20, 9, 20, "--out", tmp_path / "b.json"
    )
    card = tmp_path / "t.onnx.json"
    card.write_text(card.read_text().replace('"sha256"', '"sha"'))
    assert "has no sha" in refused(*found, "--out", tmp_path / "b.json")
    card.unlink()
    assert "needs NAME.onnx and its card" in refused(*found, "--out", tmp_path / "b.json")
    assert "no such file of weights" in refused(
        "evaluate", recording, "--detector", tmp_path / "none.onnx"
    )


def test_what_cannot_be_exported_is_refused(tmp_path, refused):
    assert "must end in .onnx" in refused("export", "general", tmp_path / "g.bin")
    assert "no weights named 'nothing'" in refused("export", "nothing", tmp_path / "g.onnx")
    assert "for the area" in refused(
        "export", "tjunction", tmp_path / "t.onnx", "--area", 0, 0, 9, 9
    )
