"""Schemes and how they send."""

from placement_env.report.stress.systems import systems_of
from toolkit.detection.early import Early
from toolkit.detection.hybrid import Hybrid
from toolkit.detection.late import Late
from toolkit.detection.link.foreground import Foreground
from toolkit.detection.link.range_images import STEPS, RangeImages
from toolkit.detection.sharing.adaptive import Adaptive


def said(schemes, kind="bytes"):
    return [(each.scheme.name, each.name) for each in systems_of(schemes, kind)]


def test_where_bytes_are_looked_at_everything_is_sent_in_every_way_it_has():
    steps = ["2 cm", "4 cm", "8 cm"]
    assert said([Late()]) == [("late", "paper"), ("late", "bytes")]
    assert said([Early()]) == [("early", each) for each in ("paper", *steps)]
    assert said([Hybrid()]) == [("hybrid", each) for each in ("paper", *steps)]
    assert said([Foreground()]) == [("foreground", each) for each in steps]
    assert [each.scheme for each in systems_of([Foreground()], "bytes")] == [Foreground(x) for x in STEPS]
    assert [each.codec for each in systems_of([Early()], "bytes")[1:]] == [RangeImages(x) for x in STEPS]


def test_adaptive_sharing_has_every_budget_unless_its_own_is_of_the_whole_link():
    made = systems_of([Adaptive(sigmas=5.0)], "bytes")
    assert [each.name for each in made] == [f"{kbit} kbit" for kbit in ("0.5", "1", "1.5", "2", "3", "4", "5", "6")]
    budgets = [500, 1000, 1500, 2000, 3000, 4000, 5000, 6000]
    assert [each.scheme for each in made] == [Adaptive(bits, sigmas=5.0) for bits in budgets]
    whole = Adaptive(18_000, whole_link=True)
    assert [each.scheme for each in systems_of([whole], "bytes")] == [whole]


def test_elsewhere_everything_is_bytes_in_the_finest_step():
    assert said([Late(), Early(), Adaptive()], "delay") == [(n, "2 cm") for n in ("late", "early", "adaptive")]
