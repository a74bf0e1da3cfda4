import json
import re
from dataclasses import replace

import numpy as np
import pytest

from placement_env.objective import Score
from placement_env.search.exact import exhaustive
from placement_env.search.result import (
    Assessment,
    Certificate,
    Contender,
    History,
    ProfileAP,
    Result,
)
from toolkit.geometry import look
from toolkit.sensors.models import DepthCamera, SpinningLidar
from toolkit.sensors.sensor import Sensor

HISTORY = History(np.array([1, 5, 9]), np.array([0.1, 0.5, 0.9]), np.array([0.2, 0.6, 0.6]))


@pytest.mark.parametrize(
    ("limits", "reward"),
    [
        *(
            ({}, 0.6),
            ({"evaluations": 0.0}, 0.0),
            ({"evaluations": 4.0}, 0.2),
            ({"seconds": 0.5}, 0.6),
        ),
        ({"seconds": 0.4}, 0.2),
    ],
)
def test_history_knows_the_best_at_any_time(limits, reward):
    assert HISTORY.at(**limits) == reward


@pytest.mark.parametrize(("bound", "gap"), [(np.inf, np.inf), (0.75, 0.25), (0.5, 0.0), (0.4, 0.0)])
def test_the_gap_is_what_the_optimum_may_be_better(bound, gap):
    assert Certificate("bound", 0.5, bound).gap == gap


def test_a_result_reads_as_one_line(make):
    said = str(exhaustive.search(make(3, 1), 2))
    assert said.startswith("exhaustive: {")
    assert "after 6 sets" in said
    assert "optimal, at most" in said


@pytest.fixture
def whole(make):
    """A result with every field in use, numbers that JSON has not among them."""
    found = exhaustive.search(make(3, 1), 2)
    contender = Contender(("greedy", "swap"), (0, 2), 0.9, 0.8, 0.7, 0.85)
    judged = Assessment(
        "detector", 0.8, 0.7, 0.9, 120.5, 300, 40, 0.9, 0.97, 0.95, 0.01, 9, 24, (contender,)
    )
    over = (ProfileAP("paper", 0.9, 0.85, 0.95), ProfileAP("poor", 0.8, 0.7, 0.9))
    judged = replace(judged, by_errors=over, errors_by="worst")
    empty = Score(
        (1,),
        0.1,
        0.2,
        3.0,
        3.0,
        1.0,
        0.1,
        {"ap": 0.1},
        "coverage",
        False,
        {"vehicle": 0.1, "heavy": np.nan},
    )
    at = look((1.0, 2.0, 3.0), 0.1)
    poses = (Sensor("a", DepthCamera(width=9), at), Sensor("b", SpinningLidar(), at))
    unknown = Certificate("none", 0.5, note="nothing")
    return replace(found, front=(empty,), sensors=poses, assessment=judged, certificate=unknown)


def test_results_are_read_as_written(whole, make, tmp_path):
    whole.save(tmp_path / "result.json")
    again = Result.load(tmp_path / "result.json")
    for name in (
        "method",
        "best",
        "certificate",
        "evaluations",
        "seconds",
        "by_size",
        "sensors",
        "assessment",
    ):
        assert getattr(again, name) == getattr(whole, name), name


def test_numbers_that_json_lacks_come_back(whole, tmp_path):
    whole.save(tmp_path / "result.json")
    again = Result.load(tmp_path / "result.json")
    assert again.certificate.bound == np.inf
    assert again.assessment.curse == pytest.approx(0.1)
    assert again.assessment.by_errors[1] == ProfileAP("poor", 0.8, 0.7, 0.9)
    assert np.isnan(again.front[0].class_ap["heavy"])
    assert again.front[0].class_ap["vehicle"] == 0.1
    for name, column in vars(whole.history).items():
        assert np.array_equal(getattr(again.history, name), column), name
        assert getattr(again.history, name).dtype == column.dtype


def test_a_result_is_saved_again_as_it_was(whole, make, tmp_path):
    whole.save(tmp_path / "result.json")
    again = Result.load(tmp_path / "result.json")
    assert str(again) == str(whole)
    again.save(tmp_path / "again.json")
    assert (tmp_path / "again.json").read_bytes() == (tmp_path / "result.json").read_bytes()
    assert again.origin == whole.origin
    assert whole.origin["sensors"] == [
        make(3, 1).names[member] for member in exhaustive.search(make(3, 1), 2).best.subset
    ]
    assert "coview" in whole.origin


def test_results_overwrite_when_told_to(whole, tmp_path):
    whole.save(tmp_path / "again.json")
    with pytest.raises(FileExistsError, match=r"again\.json exists"):
        whole.save(tmp_path / "again.json")
    whole.save(tmp_path / "again.json", overwrite=True)


def test_results_without_error_profiles_are_read(whole, tmp_path):
    whole.save(tmp_path / "new.json")
    content = json.loads((tmp_path / "new.json").read_text())
    for name in ("by_errors", "errors_by"):
        del content["assessment"][name]
    (tmp_path / "old.json").write_text(json.dumps(content))
    read = Result.load(tmp_path / "old.json").assessment
    assert (read.by_errors, read.errors_by, read.ap) == ((), "", 0.8)


@pytest.mark.parametrize(
    "change",
    [
        *(lambda c: c | {"coview_result": 2}, lambda c: c | {"best": []}),
        *(
            lambda c: {name: value for name, value in c.items() if name != "history"},
            lambda c: c | {"extra": 1},
        ),
        lambda c: c | {"sensors": [{"name": "a", "model": "Telepathy", "values": {}, "pose": []}]},
        *(lambda c: c | {"certificate": None}, lambda c: [c]),
        *(
            lambda c: c | {"best": c["best"] | {"ap": 2.0}},
            lambda c: c | {"front": [c["best"] | {"kbit": -5.0}]},
        ),
        *(
            lambda c: c | {"seconds": -1.0},
            lambda c: c | {"assessment": c["assessment"] | {"high": 1.5}},
        ),
        *(
            lambda c: c | {"best": c["best"] | {"subset": [0.5]}},
            lambda c: c | {"best": c["best"] | {"subset": ["1"]}},
        ),
        lambda c: c | {"history": c["history"] | {"evaluations": [2**70]}},
    ],
)
def test_a_damaged_result_is_one_line(whole, tmp_path, change):
    path = tmp_path / "result.json"
    whole.save(path)
    path.write_text(json.dumps(change(json.loads(path.read_text()))))
    with pytest.raises(ValueError, match="is no result of a search") as refused:
        Result.load(path)
    assert "\n" not in str(refused.value)


def test_a_number_that_no_computer_holds_is_refused(whole, tmp_path):
    path = tmp_path / "result.json"
    whole.save(path)
    path.write_text(re.sub(r'("subset": \[\s*)\d+', r"\g<1>1e400", path.read_text(), count=1))
    with pytest.raises(ValueError, match="is no result of a search"):
        Result.load(path)
