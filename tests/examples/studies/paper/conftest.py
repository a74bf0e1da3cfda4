"""Stored detections that are made up: vehicles at the T-junction, points by chance, hits where
there are points."""

import numpy as np
import pytest

from examples.studies.paper.detections import FrameRun, StoredDetections, StoredTruth
from examples.studies.paper.reproduction import all_runs
from placement_env.fidelity.detector import FALSE_ALARM, IGNORED, IOUS
from placement_env.fidelity.table import Table, TableOrigin, hash_site
from placement_env.subsets import all_subsets
from toolkit.sites.files import load_site


def cars(xy):
    one = np.ones(len(xy))
    return np.column_stack([xy, 0.75 * one, 4.4 * one, 1.8 * one, 1.5 * one, 0 * one])


def frame_run(truth, run, rng):
    """Vehicles with points are found, well by early fusion, sometimes with an ignored box or a
    false alarm beside."""
    points = truth.points[:, list(run.sensors)].sum(axis=1)
    found = np.flatnonzero(points > rng.integers(0, 40, len(points)))
    best = np.zeros(len(points))
    best[found] = np.clip(
        0.45 + 0.07 * np.log(points[found]) + rng.normal(0, 0.06, len(found)), 0.3, 0.99
    )
    alarms = rng.uniform([-40, -20], [40, 20], (rng.integers(0, 3), 2))
    boxes = np.concatenate([truth.boxes[found], cars(alarms)])
    scores = np.concatenate(
        [0.3 * best[found] + 0.6 * rng.random(len(found)), rng.uniform(0.1, 0.7, len(alarms))]
    )
    misses = np.where(rng.random(len(alarms)) < 0.3, IGNORED, FALSE_ALARM)
    hit = np.array(
        [np.concatenate([np.where(best[found] >= iou, found, FALSE_ALARM), misses]) for iou in IOUS]
    )
    published = np.where(hit >= 0, 0, hit)
    bits = rng.integers(100, 1000, len(run.sensors))
    return FrameRun(
        boxes, scores, hit.astype(np.int64), published, best, bits, rng.uniform(10, 20, 1)
    )


def make_stored(site="tjunction", frames=12, seed=0):
    rng, place = np.random.default_rng(seed), load_site(site)
    sensors, runs = place.sensors, all_runs(site, len(place.sensors))
    truths = []
    for _ in range(frames):
        count = int(rng.integers(0, 9))
        low, high = place.area[:2], place.area[2:]
        points = np.where(
            rng.random((count, len(sensors))) < 0.5, 0, rng.integers(1, 300, (count, len(sensors)))
        )
        sent = np.sort(rng.integers(100, 900, (3, len(sensors))), axis=0)[::-1]
        truths.append(StoredTruth(cars(rng.uniform(low, high, (count, 2))), points, sent.copy()))
    found = {
        run: tuple(frame_run(truth, run, rng) for truth in truths) for run in dict.fromkeys(runs)
    }
    return StoredDetections(place, sensors, tuple(truths), found, "made up", "made up")


def sensor_shares(count):
    """Of the AP, ascending; no two sets of a size have the same."""
    worth = 0.9 + 0.01 * 2.0 ** np.arange(count)
    return worth / worth.sum()


def make_exact_table(site="tjunction", detector="made up", frames=12):
    """AP by the share of sensors, and a little by which they are; late fusion a tenth below."""
    place = load_site(site)
    ap = all_subsets(len(place.sensors)) @ sensor_shares(len(place.sensors))
    figures = np.stack([ap, 0.9 * ap, 0.95 * ap], axis=1)[:, :, None] * [0.9, 0.8, 0.4]
    names = tuple(sensor.name for sensor in place.sensors)
    origin = TableOrigin(
        site, names, hash_site(place, place.sensors), frames, 50, "made up", detector, 0, ""
    )
    return Table(origin, figures.clip(0, 1), figures.clip(0, 1), figures[:, :, 0] * 100)


stored = pytest.fixture(scope="session")(lambda: make_stored())
stored_roundabout = pytest.fixture(scope="session")(
    lambda: make_stored("roundabout", frames=8, seed=1)
)
exact_table = pytest.fixture(scope="session")(lambda: make_exact_table())


@pytest.fixture(scope="session")
def exact_table_of():
    """Of a detector's digest and, if it is not the T-junction, a site."""
    return lambda detector, site="tjunction": make_exact_table(site, detector)


@pytest.fixture(scope="session")
def shares():
    return sensor_shares(6)
