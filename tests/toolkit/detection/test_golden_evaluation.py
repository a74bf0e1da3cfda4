"""`evaluate_dataset` with the clustering detector on a fixed, rendered recording says what it always said."""

import numpy as np
import pytest

from toolkit.bodies.fleet import catalogue
from toolkit.detection.cluster import ClusterDetector
from toolkit.detection.evaluation import evaluate_dataset
from toolkit.frame import Frame
from toolkit.geometry import look, pose
from toolkit.objects import Objects
from toolkit.points import frame_points
from toolkit.rendering.renderer import Renderer
from toolkit.sensors.depth_camera import DepthCamera
from toolkit.sensors.sensor import Sensor
from toolkit.sensors.spinning_lidar import SpinningLidar
from toolkit.sites.site import Site
from toolkit.traffic.snapshots import Snapshot

CAMERA = DepthCamera(width=200, height=150)
SENSORS = (
    Sensor("west", CAMERA, look((-22.0, -16.0, 6.0), 0.7, tilt=0.3)),
    Sensor("east", CAMERA, look((22.0, 16.0, 5.0), -2.4, tilt=0.3)),
    Sensor("lidar", SpinningLidar(channels=24, azimuth_step=float(np.deg2rad(1.0))), pose(3.0, 9.0, 3.5, yaw=2.0)),
)
SITE = Site("somewhere", np.array([-20.0, -14, 20, 14]), sensors=SENSORS)
GOLDEN = {  # AP at IoU 0.7 and 0.5, recall at 0.7, kbit per sensor
    ("early", (0, 1, 2)): (1.0, 1.0, 1.0, 155.616),
    ("early", (0,)): (0.35714285714285715, 0.7142857142857143, 0.35714285714285715, 130.336),
    ("early", (2, 0)): (0.903061224489796, 1.0, 0.9285714285714286, 171.792),
    ("late", (0, 1, 2)): (0.69421768707483, 0.8622448979591839, 0.7857142857142857, 1.0808888888888888),
    ("late", (0,)): (0.35714285714285715, 0.7142857142857143, 0.35714285714285715, 0.9386666666666666),
    ("late", (2, 0)): (0.6650175221603793, 1.0, 0.7142857142857143, 1.1093333333333333),
    ("hybrid", (0, 1, 2)): (0.892857142857143, 0.892857142857143, 0.9285714285714286, 78.58488888888888),
    ("hybrid", (0,)): (0.35714285714285715, 0.7142857142857143, 0.35714285714285715, 89.70666666666666),
    ("hybrid", (2, 0)): (0.8172541743970314, 1.0, 0.8571428571428571, 78.29333333333334),
}


class Recording:
    """Cars in rows, some of them outside the area, rendered without noise."""

    site, sensors = SITE, SENSORS

    def __init__(self, frames: int = 3) -> None:
        rng, bodies = np.random.default_rng(5), catalogue()
        renderer = Renderer(SITE, bodies, SENSORS, threads=1)
        self.empty = Frame(SENSORS, tuple(renderer.background), Objects.empty())
        self.frames = []
        for k in range(frames):
            chosen, cells = rng.integers(12, size=8), rng.permutation(20)[:8]
            xy = np.column_stack([cells % 5 - 2, cells // 5 - 1.5]) * [11.0, 9.0]
            sizes = np.array([bodies[b].size for b in chosen])
            boxes = np.column_stack([xy, sizes[:, 2] / 2, sizes, rng.uniform(-np.pi, np.pi, 8)])
            objects = Objects(boxes, np.array([bodies[b].label for b in chosen]))
            rendered = renderer.render(Snapshot(objects, chosen, 1.0 * k))
            self.frames.append(Frame(SENSORS, rendered.measurements, objects, index=k))

    def __len__(self) -> int:
        return len(self.frames)

    def __getitem__(self, k: int) -> Frame:
        return self.frames[k]


@pytest.fixture(scope="module")
def rows():
    recording = Recording()
    sweeps = [frame_points(recording.empty, area=SITE, rng=np.random.default_rng(seed)) for seed in range(4)]
    detector = ClusterDetector.learn([cloud for sweep in sweeps for cloud in sweep])
    return evaluate_dataset(
        recording, detector, sensor_sets=[None, ["west"], [2, 0]], iou_thresholds=(0.5, 0.7), radius=9.0
    )


def test_figures_are_the_same_to_the_last_digit(rows):
    found = {
        (row.scheme, row.sensors): (row.ap, low.ap, row.recall, row.kbit_per_sensor)
        for low, row in zip(rows[::2], rows[1::2], strict=True)
    }
    assert found == GOLDEN
