"""Where a plan's figures come from: a digest that follows every input."""

from dataclasses import replace

import numpy as np
import shapely

from placement_env.candidates.sensor_catalogue import SensorCatalogue
from placement_env.cases import Cases
from placement_env.fidelity.traffic import Traffic
from placement_env.report.planning.provenance import plan_origin
from placement_env.report.planning.question import Question
from toolkit.objects import Detections, Objects
from toolkit.sensors.error_profiles import TYPICAL
from toolkit.traffic.snapshots import Snapshot


class Reader:
    digest = "reader 1"

    def __call__(self, points):
        return Detections.empty()


def origin(street, question, detector=None, *, frames=1):
    one = Snapshot(Objects.empty(), np.zeros(0, np.int64))
    traffic = [Traffic(question.site, (), (one,) * frames)] * 3
    return plan_origin(
        question, street.candidates, traffic, detector or Reader(), network="general", search_fidelity="surrogate"
    )


def test_everything_that_matters_is_in_it(street, tmp_path):
    poles = tmp_path / "poles.geojson"
    poles.write_text("one")
    catalogue = SensorCatalogue((), "EUR", None, "digest of it")
    question = Question(site=street.site, candidates=poles, catalogue=catalogue, seed=5)
    before = origin(street, question)
    assert before == origin(street, question)
    assert (before["detector_digest"], before["catalogue_sha256"]) == ("reader 1", "digest of it")
    assert [part["seed"] for part in before["traffic"].values()] == [5, 6, 7]
    assert {"coview", "python", "numpy", "torch"} <= set(before["versions"])
    assert str(tmp_path) not in str(before)
    poles.write_text("two")
    changed = origin(street, question)
    assert {key for key in before if before[key] != changed[key]} == {"poles_sha256"}


def test_each_input_changes_its_digest(street):
    question = Question(site=street.site)
    before = origin(street, question)
    other_site = replace(question, site=replace(street.site, height=5.0))
    assert origin(street, other_site)["site_sha256"] != before["site_sha256"]
    fenced = replace(question, keep_out=(shapely.box(0, 0, 1, 1),))
    assert origin(street, fenced)["keep_out_sha256"] != before["keep_out_sha256"]
    assert origin(street, replace(question, cases=Cases(errors=TYPICAL)))["errors"] != before["errors"]
    assert origin(street, question, frames=2)["traffic"] != before["traffic"]
    assert before["poles_sha256"] is None
