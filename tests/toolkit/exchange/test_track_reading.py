"""Files of tracks come back as they were written, and others' are read or refused by name."""

import json

import numpy as np
import pytest

from toolkit.exchange.instant import Instant
from toolkit.exchange.standards import open_writer
from toolkit.exchange.track_reading import read_track_file
from toolkit.exchange.track_text import read_detection_text
from toolkit.geometry import BODY_SE3_CAMERA, pose
from toolkit.tracking.track_files import write_tracks
from toolkit.tracking.tracks import Tracks

NOW = Tracks(
    np.array([[11.0, 2, 0.8, 4.5, 1.9, 1.6, np.pi / 3], [9, -9, 1, 0.6, 0.5, 1.8, -2.0]]),
    np.array([0.9, 0.4]),
    np.array([0, 2]),
    ids=np.array([7, 3]),
    velocities=np.array([[0.0, 8.0, 0.0], [1.0, 0.0, 0.0]]),
    ages=np.array([2.5, 0.0]),
    unseen=np.array([0.0, 0.1]),
)
CAR = "0 7 Car 0 0 -1.5 100 150 220 210 1.5 1.8 4.2 2.0 1.65 15.0 -1.57"


@pytest.mark.parametrize("ending", [".json", ".csv"])
def test_ours_come_back_whole(tmp_path, ending):
    path = tmp_path / f"tracks{ending}"
    write_tracks(path, ["a", "b"], [0.0, 0.1], [Tracks.empty(), NOW])
    file = read_track_file(path)
    assert (file.is_complete, file.has_times) == (ending == ".json", True)
    frame = file.frames[-1]
    assert (frame.name, frame.time) == ("b", 0.1)
    for name, column in vars(NOW).items():
        if column is not None:
            assert np.allclose(getattr(frame.tracks, name), column, atol=1e-6), name


@pytest.mark.parametrize("name", ["kitti-tracking", "openlabel"])
def test_what_other_programs_read_comes_back(tmp_path, name):
    path = tmp_path / ("tracks.txt" if name == "kitti-tracking" else "tracks.json")
    with open_writer(name, path) as writer:
        writer.write(Instant.from_tracks(0.0, Tracks.empty()))
        writer.write(Instant.from_tracks(0.1, NOW))
    file = read_track_file(path)
    frame = file.frames[-1]
    assert frame.number == 1
    order = np.argsort(frame.tracks.ids)[::-1]
    assert frame.tracks.ids[order].tolist() == [7, 3]
    assert np.allclose(frame.tracks.boxes[order], NOW.boxes, atol=1e-5)
    assert np.allclose(frame.tracks.scores[order], NOW.scores)
    assert frame.tracks.labels[order].tolist() == [0, 2]
    assert len(file.frames) == (1 if name == "kitti-tracking" else 2)
    if name == "openlabel":
        assert frame.time == pytest.approx(0.1)
        assert np.allclose(frame.tracks.velocities[order], NOW.velocities)


def test_a_cuboids_score_counts_if_its_object_has_none(tmp_path):
    path = tmp_path / "tracks.json"
    with open_writer("openlabel", path) as writer:
        writer.write(Instant.from_tracks(0.0, NOW))
    content = json.loads(path.read_text())
    objects = content["openlabel"]["frames"]["0"]["objects"]
    for track_id, score in (("7", 0.6), ("3", 0.2)):
        data = objects[track_id]["object_data"]
        data["cuboid"][0]["attributes"] = {"num": [{"name": "score", "val": score}]}
    objects["7"]["object_data"].pop("num")
    path.write_text(json.dumps(content))
    (frame,) = read_track_file(path).frames
    assert dict(zip(frame.tracks.ids.tolist(), frame.tracks.scores.tolist(), strict=True)) == {
        7: 0.6,
        3: 0.4,
    }


def test_axes_are_those_of_another_reader(tmp_path):
    """motrics has a box's centre in the camera's frame: x right, y down, z ahead."""
    motrics = pytest.importorskip("motrics")
    path = tmp_path / "0001.txt"
    path.write_text(f"{CAR} 5.5\n")
    (box,) = read_track_file(path).frames[0].tracks.boxes
    _, boxes, _, _ = motrics.load_kitti_3d(path)[0]
    x, y, z, length, width, height, turn = boxes[0]
    assert box[:3] == pytest.approx([z, -x, -y])
    assert box[3:6] == pytest.approx([length, width, height])
    assert np.cos(box[6] - (-turn - np.pi / 2)) == pytest.approx(1)
    assert box[2] == pytest.approx(-1.65 + 0.75)  # the camera is 1.65 m above the ground


def test_a_camera_of_somebody_else_moves_the_boxes(tmp_path):
    path = tmp_path / "0001.txt"
    path.write_text(f"{CAR}\n")
    camera = pose(0.27, 0.0, 1.73) @ BODY_SE3_CAMERA
    (box,) = read_track_file(path, camera).frames[0].tracks.boxes
    assert box[:3] == pytest.approx([15.27, -2.0, 1.73 - 1.65 + 0.75])
    # the text that coview writes is in the world frame, whatever the camera
    with open_writer("kitti-tracking", path) as writer:
        writer.write(Instant.from_tracks(0.0, NOW))
    assert np.allclose(read_track_file(path, camera).frames[0].tracks.boxes, NOW.boxes, atol=1e-5)


def test_detections_of_others(tmp_path):
    path = tmp_path / "0001.txt"
    path.write_text(
        "3,2,100,150,220,210,7.5,1.5,1.8,4.2,2.0,1.65,15.0,-1.57,-1.5\n"
        "3,1,10,150,22,210,-1.0,1.7,0.6,0.8,4.0,1.65,9.0,0,0\n"
    )
    (found,) = read_detection_text(path).values()
    assert found.labels.tolist() == [0, 2]
    assert found.scores == pytest.approx(1 / (1 + np.exp([-7.5, 1.0])))
    path.write_text(f"{CAR} 0.7\n{CAR.replace(' Car ', ' DontCare ')}\n")
    assert read_detection_text(path)[0].scores.tolist() == [0.7]
    path.write_text(f"{CAR}\n")
    assert read_detection_text(path)[0].scores.tolist() == [1.0]


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        (CAR.replace(" Car ", " Rocket "), "no class 'Rocket'"),
        (CAR.replace("0 7", "0 -1"), "ids must not be negative"),
        (f"{CAR}\n{CAR}", "7 twice"),
        (CAR.replace("4.2", "nan"), "frame 0"),
        (CAR.replace("0 7", "-2 7"), "numbered from 0"),
        ("1 2 3", "17 or 18 entries"),
        ("1,2,3", "15 entries"),
        ("1,9,0,0,0,0,1,1,1,1,1,1,1,1,1", "1 \\(pedestrian\\)"),
    ],
)
def test_damaged_text_is_refused(tmp_path, text, reason):
    path = tmp_path / "0001.txt"
    path.write_text(text)
    with pytest.raises(ValueError, match=reason) as refusal:
        read_track_file(path)
    assert "0001.txt" in str(refusal.value)


def test_damaged_json_is_refused(tmp_path):
    path = tmp_path / "tracks.json"
    write_tracks(path, ["a", "b"], [0.0, 0.1], [NOW, NOW])
    content = json.loads(path.read_text())
    content["frames"][1]["time"] = 0.0
    path.write_text(json.dumps(content))
    with pytest.raises(ValueError, match="times must rise, but 0 s of frame 'b'"):
        read_track_file(path)
    content["frames"][0]["tracks"][0]["label"] = "rocket"
    path.write_text(json.dumps(content))
    with pytest.raises(ValueError, match="rocket"):
        read_track_file(path)
    path.write_text('{"coview": "boxes"}')
    with pytest.raises(ValueError, match="coview_tracks"):
        read_track_file(path)
    with pytest.raises(ValueError, match="its ending must be"):
        read_track_file(tmp_path / "tracks.png")
