"""The answer of a search as files: what each sensor sends, and that nothing is left where it cannot be written."""

from dataclasses import replace

import numpy as np
import pytest

import placement_env.report.search_answer as search_answer
from placement_env.candidates.pool import paper_candidates
from placement_env.fidelity.visibility import Visibility
from placement_env.objective import Objective
from placement_env.report.search_answer import ANSWER_FILES, check_georeference, kbit_per_frame, write_answer
from placement_env.search.exact import exhaustive
from placement_env.search.result import Result
from toolkit.detection.schemes import find_scheme
from toolkit.sites.files import load_site

SEEN = Visibility(
    points=np.array([[30, 20, 19, 5], [0, 25, 40, 60]], np.float32),
    distance=np.zeros((2, 4), np.float32),
    frame=np.array([0, 0, 1, 1]),
    boxes=np.zeros((4, 7)),
    sent=np.array([[1000, 500], [100, 200]], np.float32),
    far=np.array([[400, 300], [100, 0]], np.float32),
)


@pytest.fixture(scope="module")
def objective() -> Objective:
    site = load_site("tjunction")
    first = replace(site, sensors=site.sensors[:2])
    return Objective(first, 1, "early", "coverage", candidates=paper_candidates(first))


@pytest.fixture(scope="module")
def result(objective) -> Result:
    return exhaustive.search(objective, 2)


@pytest.mark.parametrize(
    ("scheme", "kbit"),
    [
        ("early", [[96.0, 48.0], [9.6, 19.2]]),  # 96 bit a point
        ("late", [[0.512, 0.0], [0.256, 0.512]]),  # 256 bit for each vehicle seen with 20 points
        ("hybrid", [[38.4 + 0.512, 28.8], [9.6 + 0.256, 0.512]]),
    ],
)
def test_what_is_sent_in_each_frame(scheme, kbit, objective, result, monkeypatch):
    monkeypatch.setattr(objective, "visibility", SEEN)
    monkeypatch.setattr(objective, "scheme", find_scheme(scheme))
    assert kbit_per_frame(objective, (0, 1), result) == pytest.approx(np.array(kbit))
    assert kbit_per_frame(objective, (1,), result) == pytest.approx(np.array(kbit)[1:])


def test_it_agrees_with_what_the_objective_says(objective, result):
    assert kbit_per_frame(objective, (0, 1), result).mean(axis=1) == pytest.approx(objective.sent)
    moved = replace(result, sensors=objective.candidates.sensors)
    assert kbit_per_frame(objective, (0, 1), moved).mean(axis=1) == pytest.approx(objective.sent)


def test_all_files_or_none(objective, result, tmp_path, monkeypatch):
    monkeypatch.setattr(
        "toolkit.plots.plan_view.draw_site", lambda site, out: (_ for _ in ()).throw(OSError(28, "full"))
    )
    with pytest.raises(OSError, match="No space left"):
        write_answer(tmp_path / "o", objective, result, {})
    assert not (tmp_path / "o").exists()
    monkeypatch.undo()
    write_answer(tmp_path / "o", objective, result, {"said": "ü"}, chosen=(1,))
    assert sorted(path.name for path in (tmp_path / "o").iterdir()) == sorted(ANSWER_FILES)
    assert [sensor.name for sensor in load_site(tmp_path / "o" / "site.json").sensors] == [
        objective.candidates.sensors[1].name
    ]  # fmt: skip
    assert (tmp_path / "o" / "search.json").read_text(encoding="utf-8") == '{\n "said": "ü"\n}\n'


def test_nothing_to_hand_over(objective, result, tmp_path):
    with pytest.raises(ValueError, match="this is an empty set"):
        write_answer(tmp_path / "o", objective, result, {}, chosen=())
    parts = Objective.of(objective.candidates, objective.scored_by)
    with pytest.raises(ValueError, match="has no site"):
        write_answer(tmp_path / "o", parts, result, {})
    with pytest.raises(ValueError, match="an objective made from a site"):
        kbit_per_frame(parts, (0,), result)
    assert list(tmp_path.iterdir()) == []


def test_a_georeference_is_tried_before_the_search():
    check_georeference(load_site("tjunction"))
    pytest.importorskip("pyproj")
    with pytest.raises(ValueError, match="names no projection"):
        check_georeference(replace(load_site("tjunction"), geo_reference="nonsense"))


def test_names_of_files_are_those_written():
    assert ANSWER_FILES == ("schedule.csv", "plan.geojson", "site.json", search_answer.PICTURE, search_answer.ORIGIN)
