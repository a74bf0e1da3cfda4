import numpy as np
import pytest

from toolkit.calibration.ground import Ground
from toolkit.datasets.sample import Sample, SensorCloud
from toolkit.detection.hybrid import Hybrid
from toolkit.detection.samples.views import sample_view
from toolkit.detection.schemes import SCHEMES
from toolkit.geometry import pose
from toolkit.objects import Detections, Objects

AREA = np.array([-50.0, -50, 50, 50])


class Counts:
    """A detection whose score is the share of 100 points it saw."""

    def __init__(self):
        self.seen = []

    def __call__(self, points):
        self.seen.append(points)
        box = np.array([[*points.mean(axis=0), 4, 2, 1.5, 0.0]])
        return Detections(box, np.array([len(points) / 100]))


def sample():
    """Two sensors in a world whose ground lies 10 m up; 30 points beside the first, 20 points 40 m from both."""
    near, far = np.tile([1.0, 0, -3.0], (30, 1)), np.tile([0.0, 40, -3.0], (20, 1))
    clouds = (
        SensorCloud("a", near.astype(np.float32), pose(100.0, 0.0, 14.0)),
        SensorCloud("b", far.astype(np.float32), pose(110.0, 0.0, 14.0)),
    )
    return Sample("0", clouds, Objects.empty())


def view(detector):
    return sample_view(sample(), detector, Ground(np.array([0.0, 0, 10.0])), np.array([100.0, 0]), AREA)


def test_clouds_are_counted_from_the_middle_on_the_ground():
    made = view(Counts())
    assert made.cloud(0).points.tolist() == [[1, 0, 1]] * 30
    assert made.cloud(1).points.tolist() == [[10, 40, 1]] * 20
    assert made.cloud(0).points.dtype == np.float32
    assert made.sensors[1].position.tolist() == [10, 0, 4]


@pytest.mark.parametrize(("scheme", "kbit"), [("early", 96 * 25 / 1000), ("late", 0.256)])
def test_fusion_as_on_simulated_frames(scheme, kbit):
    detector = Counts()
    fused = SCHEMES[scheme].fuse(view(detector), [0, 1])
    assert fused.kbit_per_sensor == pytest.approx(kbit)
    assert [len(points) for points in detector.seen] == ([50] if scheme == "early" else [30, 20])
    assert len(fused.detections) == (1 if scheme == "early" else 2)


def test_hybrid_sends_the_far_points():
    detector = Counts()
    fused = Hybrid(radius=15.0).fuse(view(detector), [0, 1])
    assert fused.bits.tolist() == [256, 256 + 20 * 96]
    assert [len(points) for points in detector.seen] == [20, 30, 20]


def test_a_sensor_without_points_in_the_area_detects_nothing():
    detector = Counts()
    nothing = sample_view(sample(), detector, None, np.zeros(2), AREA)  # points are at x = 101 and 110, z = 11
    assert SCHEMES["late"].fuse(nothing, [0, 1]).kbit_per_sensor == 0
    assert detector.seen == []
