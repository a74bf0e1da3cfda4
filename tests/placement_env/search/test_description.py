"""A search's result in words."""

from dataclasses import replace

import numpy as np
import pytest

from placement_env.candidates.candidates import paper_candidates
from placement_env.objective import Objective, Score
from placement_env.protocol import Estimate
from placement_env.search import description, exclusions, result
from placement_env.setting import Setting, Weights
from toolkit.geometry import look
from toolkit.sensors.models import DepthCamera
from toolkit.sensors.sensor import Sensor
from toolkit.sites.files import load_site


def test_sensors_are_said_by_name_or_place():
    assert description.describe_sensors(["a", "b"]) == ["a", "b"]
    moved = [
        Sensor(
            "a", DepthCamera(), look((1.0, -2.0, 6.5), float(np.deg2rad(90)), float(np.deg2rad(10)))
        )
    ]
    assert description.describe_sensors(["a"], moved) == [
        "a moved to x 1.00 y -2.00 z 6.50 m, heading 90.0 (from +x) tilt 10.0 degrees"
    ]
    assert description.describe_sensors(["a"], moved, load_site("tjunction")) == [
        "a moved to x 1.00 y -2.00 z 6.50 m, bearing 270.0 tilt 10.0 degrees"
    ]


def test_scores_are_said_with_the_fidelity():
    score = Score((0, 1), 0.5, 0.6, 100.0, 200.0, 2.0, 0.4, {"ap": 0.5}, "coverage", False)
    assert (
        description.describe_score(score)
        == "coverage 0.5000, 100.0 kbit per sensor, 200.0 kbit, price 2"
    )
    assert description.describe_score(replace(score, fidelity="table")) == (
        "AP 0.5000, recall 0.6000, 100.0 kbit per sensor, 200.0 kbit, price 2 (table)"
    )


def test_doubts_are_said_or_none():
    candidates = paper_candidates(load_site("tjunction"))
    said = description.describe_doubts(
        Objective(Setting(candidates=candidates, fidelity=Unsure())), [0, 3]
    )
    assert said == [
        "the surrogate predicts the detector's AP with a standard error of 0.020",
        "warning: not fitted to DepthCamera",
    ]
    assert description.describe_doubts(
        Objective(Setting(candidates=candidates, fidelity=Unsure())), []
    ) == ["the surrogate predicts the detector's AP with an unknown error", said[1]]
    assert description.describe_doubts(Objective(Setting("tjunction", fidelity="table")), [0]) == []


def test_assessments_have_a_line_for_error_profiles():
    own = result.Contender(("greedy",), (0, 2), 0.9, 0.8, 0.7, 0.85)
    plain = result.Assessment(
        "detector", 0.8, 0.7, 0.9, 120.5, 300, 40, 0.9, 0.97, 0.95, 0.01, 9, 24, (own,), 0.81
    )
    each = (result.ProfileAP("paper", 0.9, 0.85, 0.95), result.ProfileAP("poor", 0.8, 0.7, 0.9))
    lines, more = (
        description.describe_assessment(a)
        for a in (plain, replace(plain, by_errors=each, errors_by="worst"))
    )
    assert [line for line in more if line not in lines] == [
        (
            "  the worst over error profiles: paper AP 0.900 (0.850 to 0.950), poor AP 0.800 "
            "(0.700 to 0.900)"
        )
    ]
    assert [line for line in more if line in lines] == lines
    assert description.describe_by_errors({"paper": 0.9, "poor": 0.8}) == [
        "AP at each error profile: paper 0.9000, poor 0.8000"
    ]
    assert description.describe_by_errors({}) == []


@pytest.mark.parametrize(
    ("kbit", "ap", "comm", "reason"),
    [
        (
            *(2500.0, 0.5, 0.0),
            (
                "none of the 6 candidates fits its link: in 95 % of the frames they send up to "
                "2500 kbit or more"
            ),
        ),
        (100.0, 0.0, 0.0, "no candidate that fits its link detects a vehicle in these frames"),
        (100.0, 0.5, 0.01, "no sensor is worth what it costs"),
        (100.0, 0.5, 0.0, "the search stopped before it had scored a set"),
    ],
)
def test_why_there_is_no_sensor(kbit, ap, comm, reason):
    class Constant:
        name = "constant"

        def __call__(self, subsets, /):
            detected = np.where(subsets.any(axis=1), ap, 0.0)
            return Estimate(detected, detected.copy(), subsets.sum(axis=1) * kbit)

    candidates = paper_candidates(load_site("tjunction"))
    assert exclusions.describe_empty(
        Objective(Setting(candidates=candidates, fidelity=Constant(), weights=Weights(comm)))
    ).startswith(reason)
    roomy = replace(
        candidates, mounts=tuple(replace(mount, capacity=9e9) for mount in candidates.mounts)
    )
    assert "fits its link:" not in exclusions.describe_empty(
        Objective(Setting(candidates=roomy, fidelity=Constant(), weights=Weights(comm)))
    )


class Unsure:
    """A surrogate that was fitted to something else."""

    name = "surrogate"

    def __call__(self, subsets, /):
        return Estimate(subsets.mean(axis=1), subsets.mean(axis=1), 1.0 * subsets.sum(axis=1))

    def spread(self, subsets):
        return 0.01 * subsets.sum(axis=1)

    def doubts(self, sensors=()):
        return (f"not fitted to {' '.join(sorted(sensors))}",)
