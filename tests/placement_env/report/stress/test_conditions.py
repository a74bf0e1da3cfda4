"""One thing that goes wrong, at one level."""

import numpy as np
import pytest

from placement_env.report.stress.conditions import IN_SEQUENCE, KINDS, conditions_of
from toolkit.detection.link.channel import PERFECT, LinkChannel
from toolkit.sensors.errors.pose_errors import Calibration
from toolkit.sensors.errors.profiles import PAPER_ERRORS


def test_every_kind_has_conditions_of_its_own_name_and_no_level_twice():
    for kind in KINDS:
        made = conditions_of(kind, ["a", "b"])
        assert {each.kind for each in made} == {kind}
        assert len({each.level for each in made}) == len(made) > 0
    assert set(IN_SEQUENCE) < set(KINDS)


def test_pose_errors_are_those_of_the_benchmarks_and_beside_them():
    made = conditions_of("pose", [])
    assert [(each.amount, each.level) for each in made] == [
        (0, "0 m, 0°"), (0.1, "0.1 m, 0.1°"), (0.2, "0.2 m, 0.2°"), (0.4, "0.4 m, 0.4°"), (0.6, "0.6 m, 0.6°"),
        (1, "1 m, 1°"),
    ]  # fmt: skip
    assert [each.errors.terms[-1] for each in made] == [
        Calibration(np.deg2rad(each.amount), each.amount) for each in made
    ]
    assert all(each.errors.terms[:-1] == PAPER_ERRORS.terms and each.redrawn for each in made)


def test_what_is_mounted_crooked_moves_a_centimetre_for_a_tenth_of_a_degree():
    made = conditions_of("mounting", [])
    assert [each.level for each in made[:4]] == ["0°, 0 cm", "0.1°, 1 cm", "0.2°, 2 cm", "0.4°, 4 cm"]
    assert made[-1].errors.terms[-1] == Calibration(np.deg2rad(1.0), 0.1)
    assert all(each.redrawn for each in made)


def test_each_pair_fails_in_turn():
    made = conditions_of("pairs", ["a", "b", "c"])
    assert [(each.level, each.silent) for each in made] == [
        ("a and b", (0, 1)),
        ("a and c", (0, 2)),
        ("b and c", (1, 2)),
    ]


def test_each_sensor_fails_in_turn():
    for kind in ("silent", "blinded", "frozen"):
        made = conditions_of(kind, ["a", "b"])
        assert [(each.level, getattr(each, kind)) for each in made] == [("a", (0,)), ("b", (1,))]
        assert all(each.channel == PERFECT and not each.tracks for each in made)


def test_channels_come_without_tracks_and_with_them():
    delays = conditions_of("delay", [])
    assert [(each.level, each.channel.delay, each.tracks) for each in delays[2:4]] == [
        ("0.2 s", 0.2, False),
        ("0.2 s, tracks", 0.2, True),
    ]
    assert delays[0].channel == LinkChannel(delay=0.1, jitter=0.01)
    losses = [each.channel for each in conditions_of("loss", [])[::2]]
    assert losses == [LinkChannel(loss=0.1), LinkChannel(loss=0.3), LinkChannel(loss=0.3, burst=5.0)]
    assert [each.level for each in conditions_of("loss", [])[-2:]] == [
        "30% in bursts of 5",
        "30% in bursts of 5, tracks",
    ]
    assert [each.channel.every for each in conditions_of("rate", [])] == [2, 2, 5, 5]


def test_a_kind_that_there_is_not():
    with pytest.raises(ValueError, match="choose among bytes, pose, mounting, silent"):
        conditions_of("earthquake", [])
