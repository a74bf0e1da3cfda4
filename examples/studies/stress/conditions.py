"""Conditions, each with one fault at one level, and the systems that are tested.

    bytes     nothing goes wrong; every scheme in every encoding
    pose      believed poses of sensors are wrong by 0 to 1 m and 0 to 1°; benchmarks of cooperative
              perception begin at 0.2 m and 0.2°
    mounting  the same for sensors on poles: 0 to 1°, and a centimetre for every tenth of a degree
    silent    a sensor sends nothing, each in turn
    pairs     two sensors send nothing, each pair in turn
    blinded   a sensor sends and sees nothing, each in turn
    frozen    a sensor repeats its first measurement, each in turn
    delay     messages arrive 0.1, 0.2 or 0.3 s late, with a jitter of a tenth
    loss      10 and 30 % of the messages are lost, singly, and 30 % in bursts of 5
    rate      sensors send every 2nd or 5th frame
    clock     sensors' clocks are off by 20, 50 or 100 ms (standard deviation)

From delay to rate, and with failing sensors in frames close together, each level is tried without
and with tracks (`toolkit.tracking.tracker`), which the centre moves to the present.

Pose errors are root mean squares. They are drawn for each sensor, and again for every block of
frames used by the bootstrap, so that the intervals cover other draws too. The last four kinds need
frames close together in time (`coview simulate --every 0.1`)."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from coview.arguments import Label, check_ious, check_schemes
from examples.studies.stress.channel import PERFECT, LinkChannel
from toolkit.detection.codec import PAPER, Codec
from toolkit.detection.link.foreground import Foreground
from toolkit.detection.link.range_images import STEPS_M, RangeImages
from toolkit.detection.scheme import Scheme
from toolkit.objects import label_index
from toolkit.sensors.error_profile import ErrorProfile
from toolkit.sensors.error_profiles import PAPER_ERRORS
from toolkit.sensors.error_terms import Calibration, ClockOffset

POSE_LEVELS = (0.0, 0.1, 0.2, 0.4, 0.6, 1.0)  # root mean square errors in m and in degrees
METRES_PER_DEGREE = 0.1  # offset of a crooked sensor
DELAYS_S = (0.1, 0.2, 0.3)
# share of lost messages, and lost messages in a burst
LOSSES: tuple[tuple[float, float | None], ...] = ((0.1, None), (0.3, None), (0.3, 5.0))
FRAME_STEPS = (2, 5)  # n, if sensors send every n-th frame
CLOCK_OFFSETS_S = (0.02, 0.05, 0.1)
IN_SEQUENCE = ("delay", "loss", "rate", "clock")  # kinds that need frames close together
KINDS = ("bytes", "pose", "mounting", "silent", "pairs", "blinded", "frozen", *IN_SEQUENCE)


@dataclass(frozen=True)
class StressQuestion:
    """Schemes and kinds of stress, and objects to find."""

    schemes: tuple[str, ...] = ("early", "foreground", "hybrid", "late")
    """Fusion schemes: early, late, hybrid and foreground."""
    kinds: tuple[str, ...] | None = None
    """Stress: bytes, pose, mounting, silent, pairs, blinded, frozen, delay, loss, rate, clock; all
    when left out."""
    label: Label = "vehicle"
    """Class of the road users to find."""
    iou: tuple[float, ...] = (0.7,)
    """IoU thresholds at which a detection counts, with rows for each."""

    def __post_init__(self) -> None:
        if not (self.schemes and self.iou):
            raise ValueError("name at least one IoU and one scheme")
        label_index(self.label)
        check_ious(self.iou)
        # schemes that are no names are the caller's objects
        check_schemes(scheme for scheme in self.schemes if isinstance(scheme, str))


@dataclass(frozen=True)
class Condition:
    """Single fault at one level.

    Attributes:
        kind: Kind of stress.
        level: Level in words.
        errors: Errors of the sensors.
        channel: Channel of their messages.
        tracks: True if the centre follows road users and moves them to the present.
        silent: Indices of sensors that send nothing.
        blinded: Indices of sensors that see nothing.
        frozen: Indices of sensors that repeat their first measurement.
        amount: Level as a number if the levels of the kind are ordered, else None.
        redrawn: True if errors are drawn again for each block of frames."""

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


def make_conditions(
    kind: str, names: Sequence[str], *, in_sequence: bool = False
) -> list[Condition]:
    """Return the conditions of a kind for sensors with these names.

    in_sequence: True for frames close together in time, in which failing sensors are tried with
    tracks too. Raises ValueError for an unknown kind."""
    numbers = range(len(names))
    match kind:
        case "bytes":
            return [Condition(kind, "nothing goes wrong")]
        case "pose" | "mounting":
            return [_make_pose_condition(kind, level) for level in POSE_LEVELS]
        case "silent":
            conditions = [Condition(kind, names[k], silent=(k,)) for k in numbers]
        case "blinded":
            conditions = [Condition(kind, names[k], blinded=(k,)) for k in numbers]
        case "frozen":
            conditions = [Condition(kind, names[k], frozen=(k,)) for k in numbers]
        case "pairs":
            conditions = [
                Condition(kind, f"{names[first]} and {names[second]}", silent=(first, second))
                for first, second in combinations(numbers, 2)
            ]
        case "clock":
            return [_make_clock_condition(kind, offset) for offset in CLOCK_OFFSETS_S]
        case "delay" | "loss" | "rate":
            levels = _list_channels(kind)
            channels = [
                Condition(kind, level, channel=channel) for level, channel in levels.items()
            ]
            return _add_tracks(channels)
        case _:
            raise ValueError(
                f"there is no kind of stress {kind!r}: choose among {', '.join(KINDS)}"
            )
    return _add_tracks(conditions) if in_sequence else conditions


def _add_tracks(conditions: Sequence[Condition]) -> list[Condition]:
    """Return each condition without and with tracks."""
    doubled = []
    for condition in conditions:
        tracked = replace(condition, level=f"{condition.level}, tracks", tracks=True)
        doubled += [condition, tracked]
    return doubled


def _make_pose_condition(kind: str, level: float) -> Condition:
    # pose or mounting errors of a level in degrees, for pose also in m
    metres = level if kind == "pose" else METRES_PER_DEGREE * level
    words = f"{level:g} m, {level:g}°" if kind == "pose" else f"{level:g}°, {100 * metres:g} cm"
    errors = _add_error(f"{kind} {level:g}", Calibration(np.deg2rad(level), metres))
    return Condition(kind, words, errors, amount=level, redrawn=True)


def _make_clock_condition(kind: str, offset_s: float) -> Condition:
    # clocks that are off by a standard deviation (s)
    errors = _add_error(f"clock {offset_s:g}", ClockOffset(offset_s))
    return Condition(kind, f"{1000 * offset_s:g} ms", errors)


def _list_channels(kind: str) -> dict[str, LinkChannel]:
    """Return the channels of delay, loss or rate, by level in words."""
    if kind == "delay":
        return {f"{s:g} s": LinkChannel(delay=s, jitter=s / 10) for s in DELAYS_S}
    if kind == "rate":
        return {f"every {step} frames": LinkChannel(every=step) for step in FRAME_STEPS}
    channels = {}
    for loss, burst in LOSSES:
        in_bursts = "" if burst is None else f" in bursts of {burst:g}"
        channels[f"{loss:.0%}{in_bursts}"] = LinkChannel(loss=loss, burst=burst)
    return channels


def _add_error(name: str, term: Calibration | ClockOffset) -> ErrorProfile:
    # error profile of the paper with one more kind of error
    return ErrorProfile(name, (*PAPER_ERRORS.terms, term))


@dataclass(frozen=True)
class System:
    """Fusion scheme and the codec of its messages, with the codec's name in tables."""

    scheme: Scheme
    codec: Codec
    name: str


def make_systems(schemes: Sequence[Scheme], kind: str) -> list[System]:
    """Return the systems to test in a kind of condition.

    Every scheme sends bytes. Under `bytes`, messages are counted as in the paper as well, and
    schemes that send points do so in all steps."""
    if kind != "bytes":
        return [System(scheme, RangeImages(), _step_name(STEPS_M[0])) for scheme in schemes]
    systems = []
    for scheme in schemes:
        if getattr(scheme, "codec", None) is None:
            systems.append(System(scheme, PAPER, "paper"))
        if not scheme.sends_points:
            systems.append(System(scheme, RangeImages(), "bytes"))
            continue
        for step in STEPS_M:
            stepped = scheme
            if isinstance(scheme, Foreground):
                stepped = replace(scheme, step=step, max_step=step)
            systems.append(System(stepped, RangeImages(step), _step_name(step)))
    return systems


def _step_name(step: float) -> str:
    # name of a codec by its step of distances (m)
    return f"{100 * step:g} cm"
