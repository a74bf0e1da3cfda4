"""Questions of plans: options in words, and bad ones refused in one line."""

import numpy as np
import pytest

from placement_env.candidates.candidates import with_terms
from placement_env.candidates.sensor_catalogue import PricedModel, SensorCatalogue
from placement_env.classes import Classes
from placement_env.report.planning.question import Question, Stock
from placement_env.setting import Setting
from toolkit.sensors.models import DepthCamera
from toolkit.sites.files import load_site

SITE = load_site("tjunction")
CATALOGUE = SensorCatalogue(
    (PricedModel("eye", DepthCamera(width=80), 1500.0),), "EUR", 4000.0, "abc"
)


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"sensors": None}, "a plan needs a budget: a number of sensors, a sum of money, or both"),
        ({"sensors": -1}, "budget of sensors must be a whole number of at least 0, got -1"),
        ({"money": -1.0}, "most_price must be 0 or more, got -1"),
        ({"max_kbit": -5.0}, "max_kbit must be a finite number from 0 up, got -5.0"),
        ({"capacity_kbit": 0.0}, "capacity_kbit must be above 0"),
        ({"min_ap": 0.0}, "min_ap must lie above 0 and up to 1, got 0.0"),
        ({"min_ap": 90.0}, "min_ap must lie above 0 and up to 1, got 90.0"),
        ({"classes": ("vehicle", "tram")}, "there is no class 'tram', it counts as heavy: choose"),
        *(
            ({"classes": ()}, "classes must be one or several different ones"),
            ({"scheme": "middle"}, "middle"),
        ),
        *(({"iou": 0.0}, "iou must lie in"), ({"iou": (0.7, 0.7)}, "several different ones")),
        ({"failing": 3}, "failing must be 0 to 2 sensors, got 3"),
        ({"levels": 5}, "traffic has 1 to 4 levels, got 5"),
        ({"sensors": 2, "failing": 2}, "of 2 sensors nothing is left when 2 fail"),
        (
            {"sensors": 1, "keep": ("a", "b")},
            "2 poles must carry a sensor and a budget of 1 is allowed",
        ),
        ({"frames": 0}, "frames must be a whole number of at least 1, got 0"),
        ({"seed": -1}, "seed must be a whole number of at least 0"),
        (
            {"candidates": "paper", "catalogue": CATALOGUE},
            "the site's own sensors have their models",
        ),
    ],
)
def test_bad_questions(ask, wrong, message):
    with pytest.raises(ValueError, match=message) as refused:
        ask(SITE, **wrong)
    assert "\n" not in str(refused.value)


def test_prices_and_links_are_those_of_the_catalogue(ask):
    question = ask(SITE, catalogue=CATALOGUE, capacity_kbit=700.0)
    pool = question.setting.pool
    assert question.currency == "EUR"
    assert pool.mount_prices.max() == 4000.0
    assert set(np.unique(pool.prices)) == {1500.0 + 4000.0 * 0.6, 5500.0}
    assert (pool.capacity == 700.0).all()
    assert pool.sensors[0].model == DepthCamera(width=80)


def test_plain_prices_are_in_poles(ask):
    question = ask(SITE)
    pool = question.setting.pool
    assert (question.currency, question.money) == ("", None)
    assert set(pool.prices) == {0.6, 1.0}
    assert with_terms(pool, 1.0, None).digest() == pool.digest()


def test_a_stock_is_made_of_a_name_alone():
    assert Question(Setting("tjunction")).stock.candidates == "paper"
    assert Question(Setting("tjunction", candidates="pool")).stock.candidates == "pool"
    with pytest.raises(ValueError, match="a plan needs a Stock of candidates"):
        Question(Setting("tjunction", candidates=Stock()(SITE)))


def test_options_are_in_words_with_digests_of_files(ask, tmp_path):
    words = ask(
        SITE, money=9000.0, catalogue=CATALOGUE, candidates=tmp_path / "poles.geojson"
    ).as_dict()
    assert (words["money"], words["catalogue"], words["candidates"]) == (
        9000.0,
        ["eye"],
        "poles.geojson",
    )
    assert words["frames"] == [60, 120, 120]
    assert words["detector"] == "shipped"
    assert str(tmp_path) not in str(words)
    path = tmp_path / "poles.geojson"
    path.write_text("{}")
    first = Stock(candidates=path).poles_digest
    path.write_text("{ }")
    assert Stock(candidates=str(path)).poles_digest != first
    assert Stock().poles_digest is None


def test_classes_are_written_down(ask):
    plain = ask(SITE).as_dict()
    assert (plain["classes"], plain["class_weights"], plain["combine"]) == (
        ["vehicle"],
        [1.0],
        "mean",
    )
    words = ask(
        SITE, classes=Classes(("pedestrian", "vehicle"), combine="worst"), iou=0.8
    ).as_dict()
    assert (words["classes"], words["combine"]) == (["vehicle", "pedestrian"], "worst")
    assert words["class_ious"] == [0.8, 0.5]
    assert ask(SITE, classes=("cyclist",)).setting.counted == Classes(("cyclist",))


def test_thresholds_are_sorted_and_written_for_each_class(ask):
    question = ask(SITE, iou=(0.9, 0.7), classes=("vehicle", "pedestrian"), failing=1)
    assert question.cases.ious == (0.7, 0.9)
    assert question.as_dict()["class_ious"] == [(0.7, 0.9), 0.5]
    assert ask(SITE, iou=(0.8,)).as_dict()["iou"] == 0.8


def test_error_profiles_are_written_down(ask):
    plain = ask(SITE).as_dict()
    assert (plain["errors"], plain["errors_by"]) == (["paper"], "worst")
    single = ask(SITE, errors=("typical",), errors_by="mean").as_dict()
    assert (single["errors"], single["errors_by"]) == (["typical"], "worst")
    both = ask(SITE, errors=("typical", "poor"), errors_by="mean").as_dict()
    assert (both["errors"], both["errors_by"]) == (["typical", "poor"], "mean")


def test_searches_and_judgement_have_settings_and_runs_of_their_own(ask):
    question = ask(SITE, candidates="paper", errors=("typical",), seed=4, frames=3)
    assert question.search_setting.cases.names == ("paper",)
    assert question.search_setting.fidelity == "surrogate"
    judged = question.judge_setting(question.setting.pool)
    assert (judged.cases.names, judged.fidelity) == (("typical",), "detector")
    parts = [question.part(name) for name in ("search", "comparison", "judgement")]
    assert [(each.seed, each.frames) for each in parts] == [(4, 3), (1000007, 3), (2000010, 3)]
    assert (
        ask(SITE, candidates="paper", scheme="foreground", iou=0.63).search_setting.fidelity
        == "coverage"
    )
