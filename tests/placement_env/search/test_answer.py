"""The answer of a search as files: what each sensor sends, and that nothing is left where it cannot
be written."""

import csv
import json
from copy import copy
from dataclasses import replace

import numpy as np
import pytest

import placement_env.search.answer as search_answer
from placement_env.candidates.candidates import paper_candidates, pool
from placement_env.fidelity.visibility import Visibility
from placement_env.objective import Objective
from placement_env.search.answer import (
    ANSWER_FILES,
    answer_files,
    check_georeference,
    curve_csv,
    kbit_per_frame,
    write_answer,
)
from placement_env.search.answer_summary import Answer
from placement_env.search.description import describe_mounted
from placement_env.search.exact import exhaustive
from placement_env.search.order import SearchOrder
from placement_env.search.portfolio.curve import CurvePoint
from placement_env.search.result import ProfileAP, Result
from placement_env.setting import Setting
from toolkit.detection.schemes import find_scheme
from toolkit.runtime.run import Run
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
    return Objective(
        Setting(first, scheme="early", fidelity="coverage", candidates=paper_candidates(first)),
        Run(frames=1),
    )


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
def test_what_is_sent_in_each_frame(scheme, kbit, objective, result):
    seen = copy(objective)
    seen.visibility, seen.scheme = SEEN, find_scheme(scheme)
    assert kbit_per_frame(seen, (0, 1)) == pytest.approx(np.array(kbit))
    assert kbit_per_frame(seen, (1,)) == pytest.approx(np.array(kbit)[1:])


def answer(objective, result, chosen=(1,), said=None, points=(), met=True):
    return Answer(objective, said or {}, (), met, result, chosen, points)


FULL = OSError(28, "No space left on device")


def test_all_files_or_none(objective, result, tmp_path, fail):
    order = SearchOrder(setting=objective.setting, method="greedy")
    full = fail(search_answer, "draw_site", FULL)
    with pytest.raises(OSError, match="No space left"):
        write_answer(tmp_path / "o", order, answer(objective, result))
    assert not (tmp_path / "o").exists()
    full.undo()
    said = write_answer(tmp_path / "o", order, answer(objective, result, said={"said": "ü"}))
    assert sorted(path.name for path in (tmp_path / "o").iterdir()) == sorted(answer_files(order))
    assert all(name in said for name in ANSWER_FILES)
    (sensor,) = load_site(tmp_path / "o" / "site.json").sensors
    assert sensor.name == objective.candidates.sensors[1].name
    assert (tmp_path / "o" / "search.json").read_text(encoding="utf-8") == '{\n "said": "ü"\n}\n'


def test_nothing_to_hand_over(objective, result, tmp_path):
    order = SearchOrder(setting=objective.setting, method="greedy")
    with pytest.raises(ValueError, match="this is an empty set"):
        write_answer(tmp_path / "o", order, answer(objective, result, (), met=False))
    parts = Objective(Setting(candidates=objective.candidates, fidelity=objective.scored_by))
    with pytest.raises(ValueError, match="has no site"):
        write_answer(tmp_path / "o", order, answer(parts, result))
    with pytest.raises(ValueError, match="an objective made from a site"):
        kbit_per_frame(parts, (0,))
    assert list(tmp_path.iterdir()) == []


POINTS = (
    CurvePoint(1, (0,), 11.0, 300.0, ("greedy", "swap"), 0.6, 0.5, 0.4, 0.55, 0.97, True),
    CurvePoint(2, (0, 1), 21.5, 400.04, (), 0.8, 0.45, 0.4, 0.5, 0.96, False),
)


def test_a_curve_is_a_table_a_picture_and_the_site_with_each_set(objective, tmp_path, fail):
    order = SearchOrder(
        setting=objective.setting, budget=2, curve=True, currency="EUR", judge="coverage"
    )
    whole = answer(objective, None, said={"curve": [1]}, points=POINTS)
    full = fail(search_answer, "save_site", FULL)
    with pytest.raises(OSError, match="make room"):
        write_answer(tmp_path / "o", order, whole)
    full.undo()
    assert not (tmp_path / "o").exists()
    write_answer(tmp_path / "o", order, whole)
    assert sorted(path.name for path in (tmp_path / "o").iterdir()) == sorted(answer_files(order))
    assert json.loads((tmp_path / "o" / "curve.json").read_text()) == {"curve": [1]}
    rows = list(csv.DictReader((tmp_path / "o" / "curve.csv").open()))
    assert [row["site"] for row in rows] == ["site_1.json", "site_2.json"]
    for row, point in zip(rows, POINTS, strict=True):
        names = [sensor.name for sensor in load_site(tmp_path / "o" / row["site"]).sensors]
        assert names == [objective.names[c] for c in point.subset]
    assert (tmp_path / "o" / "curve.png").read_bytes()[:4] == b"\x89PNG"
    assert (
        len(answer_files(replace(order, setting=replace(objective.setting, most_price=9.0)))) == 15
    )


def test_tables_of_curves_and_their_agreement_with_the_objective(objective, result):
    first, second = csv.DictReader(curve_csv(objective, POINTS, "=EUR").splitlines())
    assert first == {
        "sensors": "1",
        "money": "",
        "price": "11",
        "price_unit": "'=EUR",
        "ap": "0.500000",
        "low": "0.400000",
        "high": "0.550000",
        "predicted": "0.600000",
        "confidence": "0.970000",
        "kbit_per_frame": "300.0",
        "pays": "yes",
        "searches": "greedy and swap",
        "set": objective.names[0],
        "site": "site_1.json",
    }
    assert (second["pays"], second["kbit_per_frame"], second["searches"]) == ("no", "400.0", "")
    (paid,) = csv.DictReader(curve_csv(objective, (replace(POINTS[0], money=22.0),)).splitlines())
    assert (paid["money"], paid["price_unit"]) == ("22", "ordinary poles")
    several = (ProfileAP("paper", 0.6, 0.5, 0.7), ProfileAP("poor", 0.5, 0.4, 0.55))
    (row,) = csv.DictReader(
        curve_csv(objective, (replace(POINTS[0], by_errors=several),)).splitlines()
    )
    assert list(row)[-7:] == [
        "site",
        "ap_paper",
        "low_paper",
        "high_paper",
        "ap_poor",
        "low_poor",
        "high_poor",
    ]
    assert [row[f"{figure}_poor"] for figure in ("ap", "low", "high")] == [
        "0.500000",
        "0.400000",
        "0.550000",
    ]
    assert kbit_per_frame(objective, (0, 1)).mean(axis=1) == pytest.approx(objective.sent)
    assert kbit_per_frame(objective, (0, 1), objective.candidates.sensors).mean(
        axis=1
    ) == pytest.approx(objective.sent)


def test_curves_and_listings_name_sensors_by_their_poles():
    site = load_site("tjunction")
    candidates = pool(site, mounts=site.mounts[:2], heights=(6.0,), headings=2, tilts=(0.1,))
    objective = Objective(Setting(site, fidelity="coverage", candidates=candidates), Run(frames=1))
    subset = (0, len(candidates) - 1)
    names = [mount.name for mount in site.mounts[:2]]
    (row,) = csv.DictReader(curve_csv(objective, (replace(POINTS[1], subset=subset),)).splitlines())
    assert row["set"] == ", ".join(names)
    first, last = describe_mounted(objective, subset)
    assert first.startswith(f"{names[0]}: depth-camera, 6.0 m up, facing ")
    assert last.endswith(" degrees from north, 6 degrees down")


def test_a_georeference_is_tried_before_the_search():
    check_georeference(load_site("tjunction"))
    pytest.importorskip("pyproj")
    with pytest.raises(ValueError, match="names no projection"):
        check_georeference(replace(load_site("tjunction"), geo_reference="nonsense"))
