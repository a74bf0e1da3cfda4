"""Sound files of tracks, detections and flows, the configuration of a centre and messages of a
sensor, and what reads them."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
from mutants import BYTES, JSON, TEXT, Mutation

from toolkit.calibration.empty_scene import EmptyScene
from toolkit.centre.centre_config import load_centre_config
from toolkit.counting.arms import find_arms
from toolkit.counting.conflicts import find_conflicts
from toolkit.counting.counts import count_street
from toolkit.counting.fragments import join_fragments
from toolkit.counting.trajectories import collect_trajectories
from toolkit.detection.link.foreground import encode_in_packet
from toolkit.detection.link.sensor_codec import SensorCodec
from toolkit.detection.messages import RangeImage
from toolkit.detection.track_evaluation import evaluate_tracks
from toolkit.detection.track_truth import TrueFrame, pair_with_truth
from toolkit.exchange.instant import Instant
from toolkit.exchange.standards import open_writer
from toolkit.exchange.track_lookup import FrameKey
from toolkit.exchange.track_reading import read_track_file
from toolkit.exchange.track_text import read_detection_text
from toolkit.frame import Everywhere
from toolkit.geometry import look
from toolkit.objects import Detections, Objects
from toolkit.runtime.reading import read_plain
from toolkit.sensors.models import DepthCamera
from toolkit.sensors.sensor import Sensor
from toolkit.sites.files import load_site
from toolkit.tracking.track_files import write_tracks
from toolkit.tracking.tracker import track_live
from toolkit.traffic.flow import Flow

FRAMES = 8
STEP_S = 0.2
TIMES = [STEP_S * k for k in range(FRAMES)]
NAMES = [f"{k:06d}" for k in range(FRAMES)]
SITE = load_site("tjunction")
SENSOR = Sensor("s", DepthCamera(width=160, height=120), look((0.0, 0.0, 6.0), 0.0, 0.4))
SCENE = EmptyScene.from_render(SENSOR, np.full(SENSOR.model.shape, 60, np.float32))


def objects(k: int) -> Objects:
    """Two cars that meet, a walker and a bus that waits."""
    boxes = np.array(
        [
            [-20 + 2 * k, 0, 0.8, 4.4, 1.8, 1.6, 0.0],
            [2, -20 + 2 * k, 0.8, 4.2, 1.8, 1.5, np.pi / 2],
            [5 + 0.3 * k, 6, 0.9, 0.5, 0.6, 1.8, 0.1],
            [-9, 5, 1.5, 11, 2.5, 3.0, 0.0],
        ]
    )
    return Objects(boxes, np.array([0, 0, 1, 3]), np.arange(4))


def detections(k: int) -> Detections:
    scores = np.array([0.95, 0.9, 0.8, 0.7])
    return Detections(objects(k).boxes, scores, objects(k).labels)


def make_tracks(path: Path) -> None:
    """By the tracker, as `coview track` writes them."""
    write_tracks(path, NAMES, TIMES, track_live([detections(k) for k in range(FRAMES)], TIMES))


def make_by(standard: str) -> Callable[[Path], None]:
    """As `coview track --to` writes them."""

    def make(path: Path) -> None:
        with open_writer(standard, path) as writer:
            for k, time in enumerate(TIMES):
                found = detections(k)
                ids = np.arange(len(found))
                writer.write(Instant(time, found.boxes, found.labels, found.scores, ids))

    return make


def make_detections(path: Path) -> None:
    """As detectors of KITTI's tracking benchmark write them, with logits."""
    row = (
        "{frame} {id} Car 0 0 -1.57 100 100 200 200 1.50 1.60 4.00 -2.00 1.65 {ahead} 0.00 {logit}"
    )
    lines = [
        row.format(frame=k, id=number, ahead=20.0 + 8 * number + k, logit=2.5 - number)
        for k in range(FRAMES)
        for number in range(2)
    ]
    path.write_text("\n".join([*lines, ""]))


def make_flow(path: Path) -> None:
    path.write_text(
        "kind,entry,exit,per_hour\nvehicle,north,south,300\nvehicle,south,west,80.5\n"
        "cyclist,west,north,30\npedestrian,north,south,40\n"
    )


def make_centre(path: Path) -> None:
    path.write_text(
        'coview_run = 1\ndetector = "tjunction+background"\n[[input]]\nkind = "velodyne"\n'
        'name = "north"\nport = 2369\naddress = "192.168.1.201"\n[[input]]\nkind = "velodyne"\n'
        'name = "south"\n[[input]]\nkind = "ouster"\nname = "east"\nmetadata = "east.json"\n[replay]\ninterval_s = 0.2\n[[sensor]]\nname = "north"\n'
        "pose = [[1, 0, 0, 5], [0, 1, 0, 0], [0, 0, 1, 6]]\nclock_offset_s = 0.02\n"
        'background = "scenes.npz"\n[place]\nlevel = "plane"\narea = [-40, -30, 40, 30]\n'
        '[output]\nfolder = "out"\nto = ["mcap", "mf-json"]\npiece_s = 30\n'
        "origin = [48.137, 11.575]\n[page]\nport = 8081\n[health]\n"
        'file = "health.jsonl"\nevery_s = 5\n'
    )


def make_message(path: Path) -> None:
    image = np.zeros(SENSOR.model.shape, np.float32)
    image[:8, :16] = np.random.default_rng(0).uniform(20.0, 20.5, (8, 16))
    path.write_bytes(encode_in_packet(RangeImage(SENSOR, image, 1.0, 3), SCENE))


def read_tracks(path: Path) -> None:
    """As `evaluate --tracks`, `count` and `conflicts` read them."""
    file = read_track_file(path)
    tracks = [frame.tracks for frame in file.frames]
    times = [frame.time if file.has_times else STEP_S * frame.number for frame in file.frames]
    trajectories = join_fragments(collect_trajectories(tracks, times))
    count_street(trajectories, SITE, find_arms(SITE), times)
    find_conflicts(trajectories, SITE.area)
    truth = []
    for k in range(FRAMES):
        every = np.ones(len(objects(k)), np.bool_)
        key = FrameKey(k, NAMES[k], TIMES[k])
        truth.append(TrueFrame(key, objects(k), every, SITE.area, Everywhere()))
    str(evaluate_tracks(pair_with_truth(file, truth)))


def read_detections(path: Path) -> None:
    """As `coview track detections.txt` reads them."""
    found = read_detection_text(path)
    numbers = sorted(found)
    track_live([found[number] for number in numbers], [STEP_S * number for number in numbers])


def read_message(path: Path) -> None:
    frame = SensorCodec(SENSOR, SCENE, (-100.0, -100.0, 100.0, 100.0)).decode(read_plain(path))
    assert np.isfinite(frame.points()).all()


# name of the format: what makes it, what reads it, what damages it
FILES: dict[str, tuple[Callable[[Path], None], Callable[[Path], object], tuple[Mutation, ...]]] = {
    "tracks.json": (make_tracks, read_tracks, JSON),
    "tracks.csv": (make_tracks, read_tracks, TEXT),
    "tracks-kitti.txt": (make_by("kitti-tracking"), read_tracks, TEXT),
    "tracks-openlabel.json": (make_by("openlabel"), read_tracks, JSON),
    "detections.txt": (make_detections, read_detections, TEXT),
    "flow.csv": (make_flow, Flow.read, TEXT),
    "centre.toml": (make_centre, load_centre_config, TEXT),
    "foreground.message": (make_message, read_message, BYTES),
}
