"""A street on which everything is known: points that say which cars a sensor sees, and a detector that reads them."""

from types import SimpleNamespace

import numpy as np
import pytest

from placement_env.candidates.candidates import Axes, Candidates
from placement_env.fidelity.detector import Detected
from placement_env.fidelity.protocol import Estimate
from placement_env.objective import Objective
from placement_env.report.planning.judging import Judge
from toolkit.geometry import look
from toolkit.objects import Detections, Objects
from toolkit.sensors.depth_camera import DepthCamera
from toolkit.sensors.sensor import Sensor
from toolkit.sites.site import Mount, Site

CAMERA, WIDE = DepthCamera(width=40, height=30), DepthCamera(width=80, height=30)
CAR = np.array([4.0, 2.0, 1.5, 0.0])
FRAMES = 8
# Cars at these places in every frame, by sensor who sees them; sensor 2 also sees something at the last place.
CARS = np.array([[-12.0, 0.0], [0.0, 0.0], [12.0, 0.0], [0.0, 12.0]])
SEES = np.array([[1, 1, 0, 0], [0, 1, 1, 0], [0, 0, 0, 1], [1, 0, 0, 0]], bool)
GHOST = np.array([-14.0, -14.0])
SENDS = np.array([300.0, 200.0, 100.0, 700.0])  # kbit that the searches believe


class Street:
    """What four sensors measure: two points in the middle of every car that they see."""

    def __init__(self, site, sensors, frames=FRAMES):
        self.site, self.sensors, self.frames, self.digest = site, sensors, frames, "street"

    def clouds(self, k, c):
        places = [*CARS[SEES[c]], *([GHOST] if c == 2 else [])]
        rows = [[x, y, 0.75] for x, y in places for _ in range(25)]
        return np.array(rows, np.float32).reshape(-1, 3)

    def objects(self, k):
        boxes = np.column_stack([CARS, np.full(4, 0.75), np.tile(CAR, (4, 1))])
        walker = [[5.0, -5.0, 0.9, 0.6, 0.6, 1.8, 0.0]]
        return Objects(np.vstack([boxes, walker]), np.array([0, 0, 0, 0, 2]))


class Reader:
    """A car at every place that has points; the ghost is believed most."""

    digest = "reader"

    def __call__(self, points, /):
        places = np.unique(points[:, :2], axis=0).astype(float)
        scores = np.where((places == GHOST).all(axis=1), 0.99, 0.5 + 0.01 * np.arange(len(places)))
        boxes = np.column_stack([places, np.full(len(places), 0.75), np.tile(CAR, (len(places), 1))])
        return Detections(boxes.reshape(-1, 7), scores)


class Known:
    """The share of cars that a set sees."""

    name = "surrogate"

    def __call__(self, subsets):
        share = (subsets.astype(int) @ SEES.astype(int) > 0).mean(axis=1)
        return Estimate(share, share.copy(), subsets @ SENDS)


@pytest.fixture
def street():
    """Site, candidates, the objective of the searches and a judge."""
    posts = [(-15.0, -15.0), (15.0, -15.0), (15.0, 15.0), (-15.0, 15.0)]
    mounts = tuple(
        Mount(f"post{m}", np.array([x, y, 0.0]), price=p, capacity=c)
        for m, ((x, y), p, c) in enumerate(zip(posts, (1.0, 1.0, 0.5, 3.0), (500.0, 500.0, 500.0, 500.0), strict=True))
    )
    sensors = tuple(
        Sensor(f"post{m}_eye", (CAMERA, WIDE)[m == 3], look((x, y, 5.0), float(np.arctan2(-y, -x)), 0.2))
        for m, (x, y) in enumerate(posts)
    )
    factors = np.array([[m, 0, 0, 0, int(m == 3)] for m in range(4)])
    axes = Axes(np.array([5.0]), np.zeros(1), np.zeros(1), (CAMERA, WIDE), (10.0, 20.0))
    candidates = Candidates(sensors, np.arange(4), mounts, factors, axes)
    site = Site("street", np.array([-20.0, -20.0, 20.0, 20.0]), mounts=mounts)
    objective = Objective.of(candidates, Known(), "late")
    detected = Detected(Street(site, sensors), Reader(), "early")
    return SimpleNamespace(
        site=site, candidates=candidates, objective=objective, detected=detected, judge=Judge(detected, 0)
    )
