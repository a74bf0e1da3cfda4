"""coview detect --to: detections in the formats of other programs, several at once."""

import json
from pathlib import Path
from typing import get_args

import numpy as np
import pytest

from coview.exchange import StandardName
from toolkit.datasets.recordings import write_recording
from toolkit.exchange.standards import STANDARDS
from toolkit.frame import Frame, SensorCloud
from toolkit.objects import Objects

STAND_IN = Path(__file__).parents[3] / "toolkit" / "exchange" / "stand_in"
DETECTOR = "found_boxes:detect"
BOXES = [[10.0, 2.0, 0.8, 4.2, 1.8, 1.5, 0.4], [-3.0, 5.0, 0.9, 0.6, 0.6, 1.8, 2.0]]


@pytest.fixture
def clouds(tmp_path, work_in):
    """Three clouds by their times, and a detector that always finds two road users."""
    rng = np.random.default_rng(0)
    frames = []
    for k in range(3):
        points = rng.uniform([-20, -20, 0], [20, 20, 0.05], (300, 3)).astype(np.float32)
        stamp = 1_700_000_000 + 0.1 * k
        cloud = SensorCloud("north", points, np.eye(4), stamp_s=stamp)
        frames.append(Frame.of_clouds(str(k), (cloud,), Objects.empty(), time=stamp))
    write_recording(frames, tmp_path / "mine", "folder")
    (tmp_path / "found_boxes.py").write_text(
        "import numpy as np\nfrom toolkit.objects import Detections\n"
        f"def detect(points):\n    return Detections(np.array({BOXES}), np.array([0.9, 0.4]), np.array([0, 2]))\n"
    )
    work_in(tmp_path)
    return tmp_path / "mine"


def test_the_names_are_those_of_the_table():
    assert list(get_args(StandardName)) == list(STANDARDS)


def test_one_file_and_several(clouds, tmp_path, run):
    pytest.importorskip("mcap")
    pytest.importorskip("foxglove_schemas_protobuf")
    asked = ("detect", clouds, "--detector", DETECTOR, "--level", "none")
    code, said, _ = run(*asked, "--to", "openlabel", "--out", tmp_path / "o.json")
    assert code == 0
    assert "6 detections in 3 clouds" in said
    content = json.loads((tmp_path / "o.json").read_text())["openlabel"]
    assert len(content["objects"]) == 6  # nobody tracked them
    first = content["frames"]["0"]
    assert float(first["frame_properties"]["timestamp"]) == pytest.approx(1.7e9, abs=1e-6)
    cuboid = first["objects"]["0"]["object_data"]["cuboid"][0]["val"]
    np.testing.assert_allclose(cuboid[:3], BOXES[0][:3], atol=1e-6)

    both = ("--to", "mcap", "kitti-tracking", "mf-json", "--origin", 48.1, 11.6)
    code, *_ = run(*asked, *both, "--out", tmp_path / "all")
    assert code == 0
    names = {file.name for file in (tmp_path / "all").iterdir()}
    assert names == {"mcap.mcap", "kitti-tracking.txt", "mf-json.json"}
    assert len((tmp_path / "all" / "kitti-tracking.txt").read_text().splitlines()) == 6


def test_messages_of_a_roadside_unit(clouds, tmp_path, run):
    """Points of the recording's clouds do not matter, only the names of their sensors."""
    pytest.importorskip("asn1tools")
    dpkt = pytest.importorskip("dpkt")
    options = ("--to", "cpm", "--asn1", STAND_IN, "--origin", 48.1, 11.6)
    asked = ("detect", clouds, "--detector", DETECTOR, "--level", "none", *options)
    code, said, _ = run(*asked, "--out", tmp_path / "found.pcap")
    assert code == 0
    assert "6 detections in 3 clouds" in said
    with (tmp_path / "found.pcap").open("rb") as file:
        times = [float(time_s) for time_s, _ in dpkt.pcap.Reader(file)]
    assert times == pytest.approx([1.7e9, 1.7e9 + 0.1, 1.7e9 + 0.2], abs=1e-6)


def test_what_it_refuses(clouds, tmp_path, refused):
    asked = ("detect", clouds, "--detector", DETECTOR, "--level", "none", "--out")
    out = tmp_path / "x.json"
    assert "must be one of kitti-tracking" in refused(*asked, out, "--to", "osl")
    assert "must end in .txt" in refused(*asked, out, "--to", "kitti-tracking")
    assert "--format and --to" in refused(*asked, out, "--to", "openlabel", "--format", "kitti")
    assert "each value once" in refused(*asked, out, "--to", "openlabel", "openlabel")
    assert "pass --origin LATITUDE LONGITUDE" in refused(*asked, out, "--to", "mf-json")
    assert "latitude must lie" in refused(*asked, out, "--to", "mf-json", "--origin", 99, 0)
    one = ("--to", "openlabel", "--origin", 1, 2)
    assert "--origin is for --to mf-json" in refused(*asked, out, *one)
    assert "--asn1 is for --to cpm" in refused(*asked, out, "--to", "openlabel", "--asn1", tmp_path)
    assert "one recording, got 2" in refused("detect", clouds, *asked[1:], out, "--to", "openlabel")
    out.write_text("x")
    assert "exists" in refused(*asked, out, "--to", "openlabel")


def test_messages_without_modules_are_refused(clouds, tmp_path, refused):
    pytest.importorskip("asn1tools")
    asked = ("detect", clouds, "--detector", DETECTOR, "--to", "cpm", "--out", tmp_path / "x.pcap")
    assert "pass --asn1 FOLDER" in refused(*asked)
    empty = tmp_path / "empty"
    empty.mkdir()
    assert "lacks the ASN.1 module CPM-PDU-Descriptions" in refused(*asked, "--asn1", empty)
    assert "is no folder: name the folder" in refused(*asked, "--asn1", tmp_path / "missing")
    assert "pass --origin LATITUDE LONGITUDE" in refused(*asked, "--asn1", STAND_IN)
    assert not (tmp_path / "x.pcap").exists()


def test_a_missing_package_is_named_with_its_extra(clouds, tmp_path, run, without_packages):
    without_packages("mcap", "foxglove_schemas_protobuf")
    asked = ("detect", clouds, "--detector", DETECTOR, "--out", tmp_path / "x.mcap", "--to", "mcap")
    code, _, error = run(*asked)
    assert code == 3
    assert error.strip().endswith("mcap, foxglove-schemas-protobuf: pip install coview[exchange]")
    assert not (tmp_path / "x.mcap").exists()
