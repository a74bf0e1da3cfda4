"""Continuous traffic of a plan: when it is made, that it is kept, and when it is refused."""

from importlib.util import find_spec

import numpy as np
import pytest

from placement_env.candidates.candidates import paper_candidates
from placement_env.report.planning.motion import MIN_MOTION_FRAMES, measure_motion
from toolkit.bodies.fleet import fleet_named
from toolkit.datasets.simulation import Job
from toolkit.objects import Detections
from toolkit.sites.files import load_site
from toolkit.traffic.ways import NoPassage

needs_sumo = pytest.mark.skipif(find_spec("libsumo") is None, reason="traffic needs SUMO")
SITE = load_site("tjunction")
CANDIDATES = paper_candidates(SITE)


class Blind:
    digest = "blind"
    labels = ("vehicle",)

    def __init__(self):
        self.calls = 0

    def __call__(self, points):
        self.calls += 1
        return Detections.empty()


def test_a_few_frames_are_too_short(ask, fail):
    fail("placement_env.report.planning.motion", "simulate_continuous_traffic", AssertionError)
    question = ask(SITE, sensors=2, frames=MIN_MOTION_FRAMES - 1, candidates="paper")
    figures = measure_motion(question, CANDIDATES, (0, 3), Blind())
    assert figures.refusal == (
        "Road users are not followed: 19 frames at 10 Hz are too short, 20 --frames or more are "
        "needed."
    )
    assert (figures.frames, figures.classes) == (0, ())


def test_a_site_without_a_way_through_says_so(ask, fail):
    error = NoPassage("site 'tjunction': no road leads past: import a larger piece of the map")
    fail("placement_env.report.planning.motion", "simulate_continuous_traffic", error)
    question = ask(SITE, sensors=2, frames=20, candidates="paper")
    figures = measure_motion(question, CANDIDATES, (0, 3), Blind())
    assert figures.refusal == f"Road users are not followed: {error}."


@needs_sumo
def test_figures_are_kept_and_come_from_traffic_of_their_own(ask, tmp_path, spy):
    """The same traffic as of `coview simulate` with this seed, detected in only once."""
    question = ask(
        SITE, sensors=2, frames=20, seed=5, candidates="paper", cache=tmp_path, errors=("poor",)
    )
    calls = spy("placement_env.report.planning.motion", "Renders")
    first = Blind()
    figures = measure_motion(question, CANDIDATES, (0, 3), first)
    assert first.calls == 20
    (vehicles,) = figures.classes
    assert vehicles.mostly_tracked.value == 0
    assert figures.frames == 20
    assert [figures.interval_s, figures.seconds] == pytest.approx([0.1, 1.9])
    assert (figures.seed, figures.errors) == (5 + 3 * 1_000_003, "poor")
    (call,) = calls
    traffic, candidates = call.args[:2]
    assert [sensor.name for sensor in candidates.sensors] == ["d0", "d3"]
    assert call.named["redrawn"] is False
    job = Job(SITE, SITE.sensors, fleet_named(), frames=20, seed=figures.seed, interval=0.1)
    recorded = job.with_traffic().traffic
    for k, snapshot in enumerate(traffic.snapshots):
        objects, _ = recorded.objects(k)
        np.testing.assert_array_equal(snapshot.objects.boxes, objects.boxes)
        assert snapshot.objects.ids.tolist() == objects.ids.tolist()
        assert snapshot.time == pytest.approx(0.1 * k)
    again = Blind()
    # as text, since NaN is not equal to NaN
    assert repr(measure_motion(question, CANDIDATES, (0, 3), again)) == repr(figures)
    assert again.calls == 0
