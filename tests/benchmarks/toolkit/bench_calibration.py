"""How well sensors that hang crooked are put right: turned by 1° and moved by 10 cm on top of the errors of the profile
typical, and registered by their empty scenes against their site; AP of early fusion with exact, crooked and corrected
poses.

python tests/benchmarks/toolkit/bench_calibration.py tj_test.hdf5 --draws 20
python tests/benchmarks/toolkit/bench_calibration.py town01.hdf5 --site town01.json --detector general --ap 2

Every draw is a line as it comes, then median and worst of all sensors.
"""

import argparse
import time
from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from toolkit.calibration.empty_scene import learn_empty_scenes
from toolkit.calibration.poses import find_pose
from toolkit.calibration.registration import scene_points, site_surface
from toolkit.datasets.dataset import CoopDataset
from toolkit.datasets.readings import ReadRecording, Reads, read_frame
from toolkit.detection.evaluation import Comparison, evaluate_recording
from toolkit.frame import Frame
from toolkit.objects import Detector
from toolkit.sensors.error_profiles import TYPICAL, ErrorProfile
from toolkit.sensors.error_terms import Calibration, make_rotation
from toolkit.sensors.sensor import Sensor
from toolkit.sites.files import load_site

TURNED_DEG, MOVED = 1.0, 0.1  # m
LEARNT = 12  # frames
PROFILE = ErrorProfile("typical but for poses", tuple(t for t in TYPICAL.terms if not isinstance(t, Calibration)))


class Believed:
    """A recording whose sensors are believed to hang elsewhere."""

    def __init__(self, recording: CoopDataset, sensors: Mapping[str, Sensor]) -> None:
        self.recording, self.site = recording, recording.site
        self.sensors = tuple(sensors[each.name] for each in recording.sensors)

    def __len__(self) -> int:
        return len(self.recording)

    def __getitem__(self, index: int, /) -> Frame:
        return replace(self.recording[index], sensors=self.sensors)


def crooked(sensor: Sensor, rng: np.random.Generator) -> Sensor:
    """The sensor, believed to hang otherwise than it does."""
    axis, way = rng.standard_normal((2, 3))
    error = np.eye(4)
    error[:3, :3] = make_rotation(axis / np.linalg.norm(axis) * np.deg2rad(TURNED_DEG))
    error[:3, 3] = way / np.linalg.norm(way) * MOVED
    return Sensor(sensor.name, sensor.model, sensor.pose @ error)


def residual(found: np.ndarray, true: np.ndarray) -> tuple[float, float]:
    """Degrees and centimetres between two poses."""
    turn = found[:3, :3] @ true[:3, :3].T
    sine = np.array([turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]]) / 2
    return float(np.rad2deg(np.linalg.norm(sine))), float(100 * np.linalg.norm(found[:3, 3] - true[:3, 3]))


def detector_of(name: str, recording: CoopDataset) -> Detector:
    """The site's own network, or one by its name."""
    from models.detector import load_detector, load_site_detector

    site = recording.site
    return load_site_detector(site.name, site.area) if name == "voxelnet" else load_detector(name, area=site.area)


def main() -> None:
    """One recording."""
    parser = argparse.ArgumentParser()
    parser.add_argument("recording")
    parser.add_argument("--site")
    parser.add_argument("--draws", type=int, default=20)
    parser.add_argument("--ap", type=int, default=0, help="draws of which the AP is scored")
    parser.add_argument("--frames", type=int, default=24, help="that AP is scored on")
    parser.add_argument("--detector", default="voxelnet")
    asked = parser.parse_args()
    with CoopDataset(asked.recording, load_site(asked.site) if asked.site else None) as recording:
        surface, off = site_surface(recording.site), []
        detector = detector_of(asked.detector, recording) if asked.ap else None

        def ap(sensors: Mapping[str, Sensor]) -> float:
            seen = Believed(recording, sensors)
            rows = evaluate_recording(
                seen,
                detector,
                Comparison(schemes=("early",), iou_thresholds=(0.7,)),
                reads=Reads(frames=asked.frames, errors=PROFILE),
            )
            return rows[0].ap

        if detector is not None:
            print(f"exact poses: AP@0.7 {ap({each.name: each for each in recording.sensors}):.3f}", flush=True)
        for draw in range(asked.draws):
            if draw % 5 == 0:  # other noise, and other poses before they are made crooked
                scenes = learn_empty_scenes(ReadRecording(recording, Reads(TYPICAL, draw)), LEARNT)
                believed = read_frame(recording, 0, errors=TYPICAL, noise_seed=draw).sensors
            rng, started = np.random.default_rng([draw, 7]), time.process_time()
            hung = {each.name: crooked(each, rng) for each in believed}
            put = {s.name: find_pose(scene_points(s)[0], hung[s.name], surface) for s in scenes}
            errors = [residual(put[each.name].pose, each.pose) for each in recording.sensors]
            off += errors
            lost = [name for name, each in put.items() if each.registration is None]
            seconds = (time.process_time() - started) / len(errors)
            said = f"draw {draw}: worst {max(e[0] for e in errors):.3f}°, {max(e[1] for e in errors):.2f} cm"
            said += f", {seconds:.1f} s a sensor" + (f", not found: {', '.join(lost)}" if lost else "")
            if draw < asked.ap:
                righted = {name: Sensor(name, hung[name].model, each.pose) for name, each in put.items()}
                said += f", AP@0.7 crooked {ap(hung):.3f}, corrected {ap(righted):.3f}"
            print(said, flush=True)
        turned, moved = np.array(off).T
        print(
            f"{recording.site.name}, {len(off)} poses: median {np.median(turned):.4f}°, {np.median(moved):.2f} cm; "
            f"worst {turned.max():.3f}°, {moved.max():.2f} cm"
        )


if __name__ == "__main__":
    main()
