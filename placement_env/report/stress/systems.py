"""`System`: a fusion scheme and how it sends, as it is put under stress."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from toolkit.detection.codec import PAPER, Codec
from toolkit.detection.link.foreground import Foreground
from toolkit.detection.link.range_images import STEPS, RangeImages
from toolkit.detection.scheme import Scheme
from toolkit.detection.schemes import CURVE_KBIT
from toolkit.detection.sharing.adaptive import Adaptive
from toolkit.detection.sharing.foreground_differences import ForegroundDifferences

BUDGETS_KBIT = (0.5, *CURVE_KBIT)  # per sensor and frame, of adaptive sharing


@dataclass(frozen=True)
class System:
    """A scheme and how it sends, by its name in tables."""

    scheme: Scheme
    codec: Codec
    name: str


def systems_of(schemes: Sequence[Scheme], kind: str) -> list[System]:
    """Every scheme as bytes; where bytes are looked at, by the paper's counting as well, those that send points in all
    steps, and adaptive sharing within every budget of `BUDGETS_KBIT`, or its own where that is of the whole link."""
    if kind != "bytes":
        return [System(scheme, RangeImages(), step_words(STEPS[0])) for scheme in schemes]
    systems = []
    for scheme in schemes:
        if isinstance(scheme, Adaptive):  # chooses its steps itself
            budgets = [replace(scheme, budget_bits=int(1000 * kbit)) for kbit in BUDGETS_KBIT]
            kept = [scheme] if scheme.whole_link else budgets
            systems += [System(each, each.codec, f"{each.budget_bits / 1000:g} kbit") for each in kept]
            continue
        if getattr(scheme, "codec", None) is None:
            systems.append(System(scheme, PAPER, "paper"))
        if not scheme.sends_points:
            systems.append(System(scheme, RangeImages(), "bytes"))
            continue
        for step in STEPS:
            stepped = replace(scheme, step=step) if isinstance(scheme, Foreground | ForegroundDifferences) else scheme
            systems.append(System(stepped, RangeImages(step), step_words(step)))
    return systems


def step_words(step: float) -> str:
    """2 cm for 0.02."""
    return f"{100 * step:g} cm"
