"""`FrameDetections`: a detector that gains by it is asked for many sets at once, and says what it
says one by one."""

import numpy as np
import pytest

from placement_env.fidelity.detector import Detected, Measured
from placement_env.fidelity.renders import Renders
from toolkit.boxes import count_points
from toolkit.detection.codec import PAPER
from toolkit.detection.link.range_images import RangeImages
from toolkit.geometry import look
from toolkit.objects import Detections, Objects
from toolkit.runtime.cache import Cache
from toolkit.sensors.models import DepthCamera
from toolkit.sensors.sensor import Sensor
from toolkit.sites.site import Site

SETS = np.array([[row >> c & 1 for c in range(4)] for row in range(16)], bool)
PLACES = np.array([-24.0, -12, 0, 12, 24])
BOXES = np.column_stack([PLACES, 0 * PLACES, 0 * PLACES + 0.75, np.tile([4, 2, 1.5, 0], (5, 1))])


class Street:
    """Cars in a row, each of which some of three cameras have points on; the fourth camera sees
    nothing."""

    site = Site("street", np.array([-40.0, -10.0, 40.0, 10.0]))
    sensors = tuple(
        Sensor(f"s{k}", DepthCamera(40, 30, 1), look((-30.0 + 20 * k, 0.0, 5.2), 0.0))
        for k in range(4)
    )
    frames = 2
    digest = "street"

    def clouds(self, k, c):
        rng = np.random.default_rng([k, c])
        counts = rng.integers(0, 9, len(BOXES)) * (c < 3)
        around = rng.uniform(-0.5, 0.5, (counts.sum(), 3)) * BOXES[0, 3:6]
        return (np.repeat(BOXES[:, :3], counts, axis=0) + around).astype(np.float32)

    def objects(self, k):
        return Objects(BOXES)


class OneByOne:
    """A car where there are points of one, the surer the more there are; it counts its calls."""

    digest = "places"

    def __init__(self):
        self.calls = 0

    def __call__(self, points):
        self.calls += 1
        counts = count_points(points, BOXES)
        return Detections(BOXES, np.round(counts / 40, 2))[counts > 3]


class AtOnce(OneByOne):
    def __init__(self):
        super().__init__()
        self.asked = []

    def unions(self, clouds, unions):
        assert all(len(cloud) for cloud in clouds)
        assert len(clouds) == unions.shape[1]
        self.asked.append(len(unions))
        none = np.zeros((0, 3), np.float32)
        points = [
            np.concatenate([none, *(clouds[c] for c in np.flatnonzero(row))]) for row in unions
        ]
        return [OneByOne()(each) for each in points]


@pytest.mark.parametrize(("scheme", "asked"), [("late", [4]), ("early", [8]), ("hybrid", [8, 3])])
def test_all_sets_of_a_frame_are_asked_for_at_once(scheme, asked):
    """Of three sensors that see anything: their own points, seven sets of these, and the same of
    their far ones; and what the fourth sees, which is nothing."""
    assert isinstance(Street(), Measured)
    detector, alone = AtOnce(), OneByOne()
    at_once = Detected(Street(), detector, scheme, memo=Cache())
    expected = Detected(Street(), alone, scheme).estimates(SETS)
    assert 0.2 < expected[0.7].ap.max() <= 1
    for _ in range(2):  # what is known is not asked for again
        for iou, figures in at_once.estimates(SETS).items():
            np.testing.assert_array_equal(figures, expected[iou])
        assert (detector.asked, detector.calls) == (asked * 2, 0)
    assert alone.calls == 2 * sum(asked)


def test_what_is_known_is_not_asked_for():
    memo, detector = Cache(), AtOnce()
    early = Detected(Street(), detector, "early", memo=memo)
    early(SETS[[1, 2]])
    early(SETS[1:4])  # one more, which goes by itself
    assert (detector.asked, detector.calls) == ([2, 2], 2)
    early(SETS[4:8])
    assert detector.asked == [2, 2, 4, 4]
    Detected(Street(), detector, "late", memo=memo)(SETS[1:8])
    assert (detector.asked, detector.calls) == ([2, 2, 4, 4], 2)


def test_schemes_at_once_detect_what_they_detect_one_by_one(small_traffic, small_candidates):
    renders, some = (
        Renders(small_traffic, small_candidates),
        np.array([[1, 0, 1, 0], [1, 0, 0, 0], [0, 0, 1, 0]], bool),
    )
    for scheme, codec in (("foreground", PAPER), ("early", RangeImages(0.04))):
        alone, at_once = OneByOne(), AtOnce()
        expected = Detected(renders, alone, scheme, codec=codec).partial(some, 2)
        np.testing.assert_array_equal(
            Detected(renders, at_once, scheme, codec=codec).partial(some, 2), expected
        )
        assert at_once.asked
        assert at_once.calls + sum(at_once.asked) == alone.calls
