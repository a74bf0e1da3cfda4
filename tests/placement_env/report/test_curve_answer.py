"""The budget curve as files."""

import csv
import json
from dataclasses import replace

import pytest

import placement_env.report.curve_answer as curve_answer
from placement_env.report.curve_answer import curve_csv, curve_files, write_curve
from placement_env.search.portfolio.curve import CurvePoint
from placement_env.search.result import ProfileAP
from toolkit.sites.files import load_site

POINTS = (
    CurvePoint(1, (0,), 11.0, 300.0, ("greedy", "swap"), 0.6, 0.5, 0.4, 0.55, 0.97, True),
    CurvePoint(2, (0, 2), 21.5, 400.04, (), 0.8, 0.45, 0.4, 0.5, 0.96, False),
)


@pytest.fixture
def objective(street):
    street.objective.site = street.site
    return street.objective


def test_a_table_a_picture_and_the_site_with_each_set(objective, tmp_path):
    write_curve(tmp_path / "o", objective, POINTS, {"curve": [1]}, judge="detector", currency="EUR")
    assert sorted(path.name for path in (tmp_path / "o").iterdir()) == sorted(curve_files(2))
    assert json.loads((tmp_path / "o" / "curve.json").read_text()) == {"curve": [1]}
    rows = list(csv.DictReader((tmp_path / "o" / "curve.csv").open()))
    assert [row["site"] for row in rows] == ["site_1.json", "site_2.json"]
    for row, point in zip(rows, POINTS, strict=True):
        names = [sensor.name for sensor in load_site(tmp_path / "o" / row["site"]).sensors]
        assert names == [objective.names[c] for c in point.subset]
    assert (tmp_path / "o" / "curve.png").read_bytes()[:4] == b"\x89PNG"


def test_what_the_table_says(objective):
    first, second = csv.DictReader(curve_csv(objective, POINTS, "=EUR").splitlines())
    assert first == {
        "sensors": "1", "money": "", "price": "11", "price_unit": "'=EUR", "ap": "0.500000", "low": "0.400000",
        "high": "0.550000", "predicted": "0.600000", "confidence": "0.970000", "kbit_per_frame": "300.0",
        "pays": "yes", "searches": "greedy and swap", "set": objective.names[0], "site": "site_1.json",
    }  # fmt: skip
    assert (second["pays"], second["kbit_per_frame"], second["searches"]) == ("no", "400.0", "")
    (paid,) = csv.DictReader(curve_csv(objective, (replace(POINTS[0], money=22.0),)).splitlines())
    assert (paid["money"], paid["price_unit"]) == ("22", "ordinary poles")


def test_columns_of_each_error_profile_where_there_are_several(objective):
    several = (ProfileAP("paper", 0.6, 0.5, 0.7), ProfileAP("poor", 0.5, 0.4, 0.55))
    text = curve_csv(objective, (replace(POINTS[0], by_errors=several),))
    (row,) = csv.DictReader(text.splitlines())
    assert list(row)[-7:] == ["site", "ap_paper", "low_paper", "high_paper", "ap_poor", "low_poor", "high_poor"]
    assert [row[f"{figure}_poor"] for figure in ("ap", "low", "high")] == ["0.500000", "0.400000", "0.550000"]
    assert "ap_paper" not in curve_csv(objective, POINTS)


def test_as_many_files_as_there_may_be_sets():
    assert curve_files(2) == ("curve.json", "curve.csv", "curve.png", "site_1.json", "site_2.json")
    assert len(curve_files(2, by_money=True)) == 15


def test_all_of_it_or_nothing(objective, tmp_path, monkeypatch):
    with pytest.raises(ValueError, match="this curve has none"):
        write_curve(tmp_path / "o", objective, (), {}, judge="detector")

    def full(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(curve_answer, "save_site", full)
    with pytest.raises(OSError, match="make room"):
        write_curve(tmp_path / "o", objective, POINTS, {}, judge="detector")
    assert not (tmp_path / "o").exists()
