"""How well sensors that hang crooked are put right: turned by 1° and moved by 10 cm on top of the
errors of the profile typical, and registered by their empty scenes against their site.

python tests/benchmarks/toolkit/bench_calibration.py tj_test.hdf5 --draws 20
python tests/benchmarks/toolkit/bench_calibration.py town01.hdf5 --site town01.json

Every draw is a line as it comes, then median and worst of all sensors.
"""

import argparse
import time

import numpy as np

from tests.benchmarks.figures import record
from toolkit.calibration.empty_scene import learn_empty_scenes
from toolkit.calibration.poses import find_pose
from toolkit.calibration.registration import scene_points, site_surface
from toolkit.datasets.dataset import CoopDataset
from toolkit.datasets.recordings import ReadRecording, Reads, read_frame
from toolkit.sensors.error_profiles import TYPICAL
from toolkit.sensors.error_terms import make_rotation
from toolkit.sensors.sensor import Sensor
from toolkit.sites.files import load_site

TURNED_DEG, MOVED = 1.0, 0.1  # m
LEARNT = 12  # frames


def crooked(sensor: Sensor, rng: np.random.Generator) -> Sensor:
    """The sensor, believed to hang otherwise than it does."""
    axis, way = rng.standard_normal((2, 3))
    error = np.eye(4)
    error[:3, :3] = make_rotation(axis / np.linalg.norm(axis) * np.deg2rad(TURNED_DEG))
    error[:3, 3] = way / np.linalg.norm(way) * MOVED
    return Sensor(sensor.name, sensor.model, sensor.pose @ error)


def residual(found: np.ndarray, true: np.ndarray) -> tuple[float, float]:
    turn = found[:3, :3] @ true[:3, :3].T
    sine = np.array([turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]]) / 2
    return float(np.rad2deg(np.linalg.norm(sine))), float(
        100 * np.linalg.norm(found[:3, 3] - true[:3, 3])
    )


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("recording")
    parser.add_argument("--site")
    parser.add_argument("--draws", type=int, default=20)
    parser.add_argument(
        "--row", nargs=2, help="site and sensors, as the page of figures names them"
    )
    asked = parser.parse_args()
    with CoopDataset(asked.recording, load_site(asked.site) if asked.site else None) as recording:
        surface, off = site_surface(recording.site), []
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
            said = (
                f"draw {draw}: worst {max(e[0] for e in errors):.3f}°, "
                f"{max(e[1] for e in errors):.2f} cm"
            )
            said += f", {seconds:.1f} s a sensor" + (
                f", not found: {', '.join(lost)}" if lost else ""
            )
            print(said, flush=True)
        turned, moved = np.array(off).T
        print(
            f"{recording.site.name}, {len(off)} poses: median {np.median(turned):.4f}°, "
            f"{np.median(moved):.2f} cm; worst {turned.max():.3f}°, {moved.max():.2f} cm"
        )
        if asked.row:
            middle = f"{np.median(turned):.3f}°, {np.median(moved):.1f} cm"
            worst = f"{turned.max():.3f}°, {moved.max():.1f} cm"
            site_name, sensors = asked.row
            record("calibration", site_name, [sensors, middle, worst])


if __name__ == "__main__":
    main()
