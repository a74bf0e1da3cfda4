"""Conditions: one thing that goes wrong, at one level.

    bytes     nothing goes wrong; every scheme in every encoding
    pose      sensors are not where they are believed to be: 0.2 m and 0.2°, the level that benchmarks of cooperative
              perception begin with, 0.4 and 0.6, and beside these 0, 0.1 and 1
    mounting  the same of sensors on poles: 0 to 1°, and a centimetre for every tenth of a degree
    silent    a sensor sends nothing, each in turn
    pairs     two sensors send nothing, each pair in turn
    blinded   a sensor sends and sees nothing, each in turn
    frozen    a sensor repeats what it measured first, each in turn
    delay     messages arrive 0.1, 0.2 or 0.3 s late, with a jitter of a tenth; with and without tracks
    loss      10 and 30 % of the messages are lost, singly, and 30 % in bursts of 5; with and without tracks
    rate      sensors send every 2nd or 5th frame; with and without tracks
    clock     sensors' clocks are off by 20, 50 or 100 ms (standard deviation)

Pose errors are root mean squares, drawn for each sensor and anew for every block of frames by which intervals are
found, so that these hold what other errors would have been as well. The last four need frames that lie close together
(`coview simulate --every 0.1`).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from toolkit.detection.link.channel import PERFECT, LinkChannel
from toolkit.sensors.errors.clock import ClockOffset
from toolkit.sensors.errors.pose_errors import Calibration
from toolkit.sensors.errors.profile import ErrorProfile
from toolkit.sensors.errors.profiles import PAPER_ERRORS

POSE_LEVELS = (0.0, 0.1, 0.2, 0.4, 0.6, 1.0)  # m and degrees
MOVED_PER_DEGREE = 0.1  # m, of sensors that are mounted crooked
DELAYS = (0.1, 0.2, 0.3)  # s
LOSSES: tuple[tuple[float, float | None], ...] = ((0.1, None), (0.3, None), (0.3, 5.0))  # share, messages in a burst
RATES = (2, 5)  # every so-many-th frame
CLOCKS = (0.02, 0.05, 0.1)  # s


@dataclass(frozen=True)
class Condition:
    """What goes wrong. kind, level: in words; errors: of the sensors; channel: of their messages; tracks: whether the
    centre shows what it detected where it is by now; silent, blinded, frozen: sensors (indices); amount: the level as a
    number, where those of a kind are more or less of the same; redrawn: whether errors are drawn anew block by
    block."""

    kind: str
    level: str
    errors: ErrorProfile = PAPER_ERRORS
    channel: LinkChannel = PERFECT
    tracks: bool = False
    silent: tuple[int, ...] = ()
    blinded: tuple[int, ...] = ()
    frozen: tuple[int, ...] = ()
    amount: float | None = None
    redrawn: bool = False


def conditions_of(kind: str, names: Sequence[str]) -> list[Condition]:
    """The conditions of a kind, for sensors with these names. Raises ValueError, which lists what there is, for a kind
    that there is not."""
    if kind not in KINDS:
        raise ValueError(f"there is no kind of stress {kind!r}: choose among {', '.join(KINDS)}")
    return _MAKERS[kind](names)


def _bytes(names: Sequence[str]) -> list[Condition]:
    return [Condition("bytes", "nothing goes wrong")]


def _pose(names: Sequence[str]) -> list[Condition]:
    return [_misplaced("pose", level, level, f"{level:g} m, {level:g}°") for level in POSE_LEVELS]


def _mounting(names: Sequence[str]) -> list[Condition]:
    moved = [(level, MOVED_PER_DEGREE * level) for level in POSE_LEVELS]
    return [_misplaced("mounting", deg, m, f"{deg:g}°, {100 * m:g} cm") for deg, m in moved]


def _misplaced(kind: str, deg: float, metres: float, words: str) -> Condition:
    errors = _with(f"{kind} {deg:g}", Calibration(np.deg2rad(deg), metres))
    return Condition(kind, words, errors, amount=deg, redrawn=True)


def _clock(names: Sequence[str]) -> list[Condition]:
    return [Condition("clock", f"{1000 * s:g} ms", _with(f"clock {s:g}", ClockOffset(s))) for s in CLOCKS]


def _with(name: str, term: Calibration | ClockOffset) -> ErrorProfile:
    return ErrorProfile(name, (*PAPER_ERRORS.terms, term))


def _silent(names: Sequence[str]) -> list[Condition]:
    return [Condition("silent", name, silent=(k,)) for k, name in enumerate(names)]


def _pairs(names: Sequence[str]) -> list[Condition]:
    pairs = combinations(range(len(names)), 2)
    return [Condition("pairs", " and ".join(names[k] for k in pair), silent=pair) for pair in pairs]


def _blinded(names: Sequence[str]) -> list[Condition]:
    return [Condition("blinded", name, blinded=(k,)) for k, name in enumerate(names)]


def _frozen(names: Sequence[str]) -> list[Condition]:
    return [Condition("frozen", name, frozen=(k,)) for k, name in enumerate(names)]


def _delay(names: Sequence[str]) -> list[Condition]:
    return _twice([("delay", f"{delay:g} s", LinkChannel(delay=delay, jitter=delay / 10)) for delay in DELAYS])


def _loss(names: Sequence[str]) -> list[Condition]:
    named = [(share, burst, "" if burst is None else f" in bursts of {burst:g}") for share, burst in LOSSES]
    return _twice(
        [("loss", f"{share:.0%}{words}", LinkChannel(loss=share, burst=burst)) for share, burst, words in named]
    )


def _rate(names: Sequence[str]) -> list[Condition]:
    return _twice([("rate", f"every {every} frames", LinkChannel(every=every)) for every in RATES])


def _twice(made: Sequence[tuple[str, str, LinkChannel]]) -> list[Condition]:
    """Without tracks and with them."""
    return [
        Condition(kind, f"{level}{', tracks' if tracks else ''}", channel=channel, tracks=tracks)
        for kind, level, channel in made
        for tracks in (False, True)
    ]


_MAKERS: dict[str, Callable[[Sequence[str]], list[Condition]]] = {
    "bytes": _bytes, "pose": _pose, "mounting": _mounting, "silent": _silent, "pairs": _pairs, "blinded": _blinded,
    "frozen": _frozen, "delay": _delay, "loss": _loss, "rate": _rate, "clock": _clock,
}  # fmt: skip
KINDS = tuple(_MAKERS)
IN_SEQUENCE = ("delay", "loss", "rate", "clock")  # kinds that need frames close together
