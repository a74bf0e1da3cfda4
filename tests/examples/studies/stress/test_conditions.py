"""Conditions, and the systems that are put under them."""

import numpy as np
import pytest

from examples.studies.stress.channel import PERFECT, LinkChannel
from examples.studies.stress.conditions import IN_SEQUENCE, KINDS, make_conditions, make_systems
from toolkit.detection.link.foreground import Foreground
from toolkit.detection.link.range_images import STEPS_M, RangeImages
from toolkit.detection.paper_schemes import Early, Hybrid, Late
from toolkit.sensors.error_profiles import PAPER_ERRORS
from toolkit.sensors.error_terms import Calibration


def test_kinds_have_distinct_levels():
    for kind in KINDS:
        made = make_conditions(kind, ["a", "b"])
        assert {each.kind for each in made} == {kind}
        assert len({each.level for each in made}) == len(made) > 0
    assert set(IN_SEQUENCE) < set(KINDS)


def test_pose_errors_are_redrawn_at_each_level():
    made = make_conditions("pose", [])
    assert [(each.amount, each.level) for each in made] == [
        *(
            (0, "0 m, 0°"),
            (0.1, "0.1 m, 0.1°"),
            (0.2, "0.2 m, 0.2°"),
            (0.4, "0.4 m, 0.4°"),
            (0.6, "0.6 m, 0.6°"),
        ),
        (1, "1 m, 1°"),
    ]
    assert [each.errors.terms[-1] for each in made] == [
        Calibration(np.deg2rad(m.amount), m.amount) for m in made
    ]
    assert all(each.errors.terms[:-1] == PAPER_ERRORS.terms and each.redrawn for each in made)


def test_mounting_shifts_a_sensor_as_it_turns():
    made = make_conditions("mounting", [])
    assert [each.level for each in made[:4]] == [
        "0°, 0 cm",
        "0.1°, 1 cm",
        "0.2°, 2 cm",
        "0.4°, 4 cm",
    ]
    assert made[-1].errors.terms[-1] == Calibration(np.deg2rad(1.0), 0.1)
    assert all(each.redrawn for each in made)


def test_unknown_kinds_are_refused():
    with pytest.raises(ValueError, match="choose among bytes, pose, mounting, silent"):
        make_conditions("earthquake", [])


def test_sensors_fail_in_turn():
    made = make_conditions("pairs", ["a", "b", "c"])
    assert [(each.level, each.silent) for each in made] == [
        *(("a and b", (0, 1)), ("a and c", (0, 2)), ("b and c", (1, 2)))
    ]
    for kind in ("silent", "blinded", "frozen"):
        made = make_conditions(kind, ["a", "b"])
        assert [(each.level, getattr(each, kind)) for each in made] == [("a", (0,)), ("b", (1,))]
        assert all(each.channel == PERFECT and not each.tracks for each in made)
        followed = make_conditions(kind, ["a", "b"], in_sequence=True)
        assert followed[::2] == made
        assert [each.level for each in followed[1::2]] == ["a, tracks", "b, tracks"]
        assert all(each.tracks and getattr(each, kind) for each in followed[1::2])


def test_channels_come_in_their_kinds():
    delays = make_conditions("delay", [])
    assert [(each.level, each.channel.delay, each.tracks) for each in delays[2:4]] == [
        ("0.2 s", 0.2, False),
        ("0.2 s, tracks", 0.2, True),
    ]
    assert delays[0].channel == LinkChannel(delay=0.1, jitter=0.01)
    losses = [each.channel for each in make_conditions("loss", [])[::2]]
    assert losses == [
        LinkChannel(loss=0.1),
        LinkChannel(loss=0.3),
        LinkChannel(loss=0.3, burst=5.0),
    ]
    assert [each.level for each in make_conditions("loss", [])[-2:]] == [
        "30% in bursts of 5",
        "30% in bursts of 5, tracks",
    ]
    assert [each.channel.every for each in make_conditions("rate", [])] == [2, 2, 5, 5]


def test_schemes_come_in_their_codecs():
    steps = ["2 cm", "4 cm", "8 cm"]
    assert names([Late()]) == [("late", "paper"), ("late", "bytes")]
    assert names([Early()]) == [("early", each) for each in ("paper", *steps)]
    assert names([Hybrid()]) == [("hybrid", each) for each in ("paper", *steps)]
    assert names([Foreground()]) == [("foreground", each) for each in steps]
    assert [each.scheme for each in make_systems([Foreground()], "bytes")] == [
        Foreground(x, max_step=x) for x in STEPS_M
    ]
    assert [each.codec for each in make_systems([Early()], "bytes")[1:]] == [
        RangeImages(x) for x in STEPS_M
    ]
    assert names([Late(), Early()], "delay") == [(n, "2 cm") for n in ("late", "early")]


def names(schemes, kind="bytes"):
    return [(each.scheme.name, each.name) for each in make_systems(schemes, kind)]
