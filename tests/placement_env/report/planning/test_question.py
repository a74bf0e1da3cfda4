"""What may be asked, and what is refused in one line."""

from dataclasses import replace

import numpy as np
import pytest

from placement_env.candidates.pool import with_terms
from placement_env.candidates.sensor_catalogue import PricedModel, SensorCatalogue
from placement_env.cases import Cases
from placement_env.classes import Classes
from placement_env.report.planning.question import Question
from toolkit.sensors.models import DepthCamera
from toolkit.sites.files import load_site

SITE = load_site("tjunction")
CATALOGUE = SensorCatalogue((PricedModel("eye", DepthCamera(width=80), 1500.0),), "EUR", 4000.0, "abc")


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"sensors": None}, "a plan needs a budget: a number of sensors, a sum of money, or both"),
        ({"sensors": -1}, "budget of sensors must be a whole number of at least 0, got -1"),
        ({"money": float("nan")}, "money must be a finite number from 0 up, got nan"),
        ({"money": float("inf")}, "money must be a finite number"),
        ({"max_kbit": -5.0}, "max_kbit must be a finite number from 0 up, got -5.0"),
        ({"capacity_kbit": 0.0}, "capacity_kbit must be above 0"),
        ({"min_ap": 0.0}, "min_ap must lie above 0 and up to 1, got 0.0"),
        ({"min_ap": 90.0}, "min_ap must lie above 0 and up to 1, got 90.0"),
        ({"classes": ("vehicle", "tram")}, "there is no class 'tram': choose among vehicle, cyclist"),
        ({"classes": ()}, "classes must be one or several different ones"),
        ({"scheme": "middle"}, "middle"),
        ({"sensors": 2, "cases": Cases(failing=2)}, "of 2 sensors nothing is left when 2 fail"),
        ({"search_frames": 0}, "search_frames must be a whole number of at least 1, got 0"),
        ({"seed": -1}, "seed must be a whole number of at least 0"),
        ({"candidates": "paper", "catalogue": CATALOGUE}, "the site's own sensors have their models"),
    ],
)
def test_what_is_refused(wrong, message):
    with pytest.raises(ValueError, match=message) as refused:
        Question(site=SITE, **wrong)
    assert "\n" not in str(refused.value)


def test_prices_are_in_the_currency_and_links_as_asked():
    question = Question(site=SITE, catalogue=CATALOGUE, capacity_kbit=700.0)
    assert (question.currency, question.pole_price) == ("EUR", 4000.0)
    pool = question.pool
    assert pool.mount_prices.max() == 4000.0
    assert set(np.unique(pool.prices)) == {1500.0 + 4000.0 * 0.6, 5500.0}
    assert (pool.capacity == 700.0).all()
    assert pool.sensors[0].model == DepthCamera(width=80)


def test_without_a_catalogue_prices_are_of_poles():
    question = Question(site=SITE)
    assert (question.currency, question.pole_price, question.most_price) == ("", 1.0, np.inf)
    assert set(question.pool.prices) == {0.6, 1.0}
    same = with_terms(question.pool, 1.0, None)
    assert same.digest() == question.pool.digest()


def test_every_option_is_in_words(tmp_path):
    words = Question(site=SITE, money=9000.0, catalogue=CATALOGUE, candidates=tmp_path / "poles.geojson").in_words
    assert (words["money"], words["catalogue"], words["candidates"]) == (9000.0, ["eye"], "poles.geojson")
    assert words["frames"] == [60, 60, 120]
    assert words["detector"] == "shipped"
    assert str(tmp_path) not in str(words)


def test_the_digest_of_poles_follows_the_file(tmp_path):
    path = tmp_path / "poles.geojson"
    path.write_text("{}")
    first = Question(site=SITE, candidates=path).poles_digest
    path.write_text("{ }")
    assert Question(site=SITE, candidates=str(path)).poles_digest != first
    assert replace(Question(site=SITE), seed=1).poles_digest is None


def test_classes_are_written_down():
    plain = Question(site=SITE).in_words
    assert (plain["classes"], plain["class_weights"], plain["combine"]) == (["vehicle"], [1.0], "mean")
    question = Question(site=SITE, classes=Classes(("pedestrian", "vehicle"), combine="worst"), cases=Cases(iou=0.8))
    assert question.in_words["classes"] == ["vehicle", "pedestrian"]
    assert question.in_words["combine"] == "worst"
    assert question.in_words["class_ious"] == [0.8, 0.5]
    assert Question(site=SITE, classes=("cyclist",)).classes == Classes(("cyclist",))


def test_one_threshold_or_several_and_classes_with_their_own():
    question = Question(site=SITE, cases=Cases(iou=(0.9, 0.7), failing=1), classes=("vehicle", "pedestrian"))
    assert (question.iou, question.cases.ious) == ((0.7, 0.9), (0.7, 0.9))
    assert question.in_words["class_ious"] == [(0.7, 0.9), 0.5]
    assert question.classes.described(question.iou) == "mean of vehicle and pedestrian (IoU 0.5)"
    assert Question(site=SITE, cases=Cases(iou=(0.8,))).iou == 0.8


def test_error_profiles_are_written_down():
    plain = Question(site=SITE).in_words
    assert (plain["errors"], plain["errors_by"]) == (["paper"], "worst")
    both = Question(site=SITE, cases=Cases(errors=("typical", "poor"), errors_by="mean")).in_words
    assert (both["errors"], both["errors_by"]) == (["typical", "poor"], "mean")
