"""Conditions, one fault at one level each, and tested systems.

    bytes     nothing goes wrong; every scheme in every encoding
    pose      sensors are not where they are believed to be, by 0 to 1 m and 0 to 1°; benchmarks of
              cooperative perception begin at 0.2 m and 0.2°
    mounting  the same for sensors on poles: 0 to 1°, and a centimetre for every tenth of a degree
    silent    a sensor sends nothing, each in turn
    pairs     two sensors send nothing, each pair in turn
    blinded   a sensor sends and sees nothing, each in turn
    frozen    a sensor repeats its first measurement, each in turn
    delay     messages arrive 0.1, 0.2 or 0.3 s late, with a jitter of a tenth; with and without
              tracks
    loss      10 and 30 % of the messages are lost, singly, and 30 % in bursts of 5; with and
              without tracks
    rate      sensors send every 2nd or 5th frame; with and without tracks
    clock     sensors' clocks are off by 20, 50 or 100 ms (standard deviation)

Pose errors are root mean squares. They are drawn for each sensor, and again for every block of
frames used by the bootstrap, so that the intervals cover other draws too. The last four kinds need
frames that lie close together (`coview simulate --every 0.1`)."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from coview.arguments import Label, check_ious, check_schemes
from toolkit.detection.codec import PAPER, Codec
from toolkit.detection.link.channel import PERFECT, LinkChannel
from toolkit.detection.link.differences import ForegroundDifferences
from toolkit.detection.link.foreground import Foreground
from toolkit.detection.link.range_images import STEPS, RangeImages
from toolkit.detection.scheme import Scheme
from toolkit.objects import label_index
from toolkit.sensors.error_profiles import PAPER_ERRORS, ErrorProfile
from toolkit.sensors.error_terms import Calibration, ClockOffset

POSE_LEVELS = (0.0, 0.1, 0.2, 0.4, 0.6, 1.0)  # m and degrees
METRES_PER_DEGREE = 0.1  # offset of a crooked sensor
DELAYS = (0.1, 0.2, 0.3)  # s
# share, messages in a burst
LOSSES: tuple[tuple[float, float | None], ...] = ((0.1, None), (0.3, None), (0.3, 5.0))
RATES = (2, 5)  # every n-th frame
CLOCKS = (0.02, 0.05, 0.1)  # s
IN_SEQUENCE = ("delay", "loss", "rate", "clock")  # kinds that need frames close together
KINDS = ("bytes", "pose", "mounting", "silent", "pairs", "blinded", "frozen", *IN_SEQUENCE)


@dataclass(frozen=True)
class StressQuestion:
    """Schemes and kinds of stress, and objects to find."""

    schemes: tuple[str, ...] = ("early", "foreground", "hybrid", "late")
    """Fusion schemes: early, late, hybrid, foreground and differences (of foregrounds)."""
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
        # others are schemes of your own
        check_schemes(each for each in self.schemes if isinstance(each, str))


@dataclass(frozen=True)
class Condition:
    """Single fault at one level.

    errors: of the sensors; channel: of their messages; tracks: whether the centre moves detections
    to where they are by now; silent, blinded, frozen: sensors (indices); amount: the level as a
    number where the levels of a kind are ordered; redrawn: whether errors are redrawn for each
    block of frames."""

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


def make_conditions(kind: str, names: Sequence[str]) -> list[Condition]:
    """Return the conditions of a kind for sensors of these names. Raises ValueError for an unknown
    kind."""
    channels: dict[str, LinkChannel] = {}
    match kind:
        case "bytes":
            return [Condition(kind, "nothing goes wrong")]
        case "pose" | "mounting":
            made = []
            for level in POSE_LEVELS:
                metres = level if kind == "pose" else METRES_PER_DEGREE * level
                words = (
                    f"{level:g} m, {level:g}°"
                    if kind == "pose"
                    else f"{level:g}°, {100 * metres:g} cm"
                )
                errors = _add_error(f"{kind} {level:g}", Calibration(np.deg2rad(level), metres))
                made.append(Condition(kind, words, errors, amount=level, redrawn=True))
            return made
        case "silent":
            return [Condition(kind, name, silent=(k,)) for k, name in enumerate(names)]
        case "blinded":
            return [Condition(kind, name, blinded=(k,)) for k, name in enumerate(names)]
        case "frozen":
            return [Condition(kind, name, frozen=(k,)) for k, name in enumerate(names)]
        case "pairs":
            pairs = combinations(range(len(names)), 2)
            return [
                Condition(kind, " and ".join(names[k] for k in pair), silent=pair) for pair in pairs
            ]
        case "clock":
            return [
                Condition(kind, f"{1000 * s:g} ms", _add_error(f"clock {s:g}", ClockOffset(s)))
                for s in CLOCKS
            ]
        case "delay":
            channels = {f"{s:g} s": LinkChannel(delay=s, jitter=s / 10) for s in DELAYS}
        case "loss":
            bursts = {
                burst: "" if burst is None else f" in bursts of {burst:g}" for _, burst in LOSSES
            }
            channels = {
                f"{loss:.0%}{bursts[burst]}": LinkChannel(loss=loss, burst=burst)
                for loss, burst in LOSSES
            }
        case "rate":
            channels = {f"every {every} frames": LinkChannel(every=every) for every in RATES}
        case _:
            raise ValueError(
                f"there is no kind of stress {kind!r}: choose among {', '.join(KINDS)}"
            )
    return [
        Condition(kind, f"{level}{', tracks' if tracks else ''}", channel=channel, tracks=tracks)
        for level, channel in channels.items()
        for tracks in (False, True)
    ]


def _add_error(name: str, term: Calibration | ClockOffset) -> ErrorProfile:
    return ErrorProfile(name, (*PAPER_ERRORS.terms, term))


@dataclass(frozen=True)
class System:
    """Fusion scheme and its codec, under its name in tables."""

    scheme: Scheme
    codec: Codec
    name: str


def make_systems(schemes: Sequence[Scheme], kind: str) -> list[System]:
    """Return the systems to test in a kind of condition. Every scheme sends bytes. Under `bytes` it
    is counted the paper's way as well, and schemes that send points do so in all steps."""
    if kind != "bytes":
        return [System(scheme, RangeImages(), _step_name(STEPS[0])) for scheme in schemes]
    systems = []
    for scheme in schemes:
        if getattr(scheme, "codec", None) is None:
            systems.append(System(scheme, PAPER, "paper"))
        if not scheme.sends_points:
            systems.append(System(scheme, RangeImages(), "bytes"))
            continue
        for step in STEPS:
            stepped = (
                replace(scheme, step=step)
                if isinstance(scheme, Foreground | ForegroundDifferences)
                else scheme
            )
            systems.append(System(stepped, RangeImages(step), _step_name(step)))
    return systems


def _step_name(step: float) -> str:
    return f"{100 * step:g} cm"
