"""The fusion schemes that go by a name: the one place where they are looked up."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from toolkit.detection.early import Early
from toolkit.detection.hybrid import Hybrid
from toolkit.detection.late import Late
from toolkit.detection.link.differences import KEY_EVERY, RefersTo
from toolkit.detection.link.foreground import Foreground
from toolkit.detection.scheme import Scheme
from toolkit.detection.sharing.adaptive import Adaptive
from toolkit.detection.sharing.foreground_differences import ForegroundDifferences
from toolkit.detection.sharing.requests import MOST_GRANT

PAPER_SCHEMES = ("early", "late", "hybrid")  # what tables of sensor sets and observations hold, in this order
SCHEMES: dict[str, Scheme] = {
    "early": Early(), "late": Late(), "hybrid": Hybrid(), "foreground": Foreground(), "adaptive": Adaptive(),
    "differences": ForegroundDifferences(),
}  # fmt: skip
CURVE_KBIT = (1.0, 1.5, 2.0, 3.0, 4.0, 5.0, 6.0)  # per sensor and frame


def schemes_in_steps(
    step: float, *, adaptive: Adaptive | None = None, refers_to: RefersTo = "previous", key_every: int = KEY_EVERY
) -> dict[str, Scheme]:
    """The same, those that send numbers in steps doing so in these (m); adaptive: in place of the usual budget;
    refers_to, key_every: of differences."""
    differences = ForegroundDifferences(step, refers_to, key_every)
    stepped: dict[str, Scheme] = {"foreground": Foreground(step), "differences": differences}
    return SCHEMES | stepped | ({} if adaptive is None else {"adaptive": adaptive})


def sharing_curve(
    kbit: Sequence[float] = CURVE_KBIT, *, sensors: int | None = None, step: float = 0.02
) -> tuple[Scheme, ...]:
    """Schemes from boxes only to everything: late, adaptive with each budget (kbit per sensor and frame), foreground,
    early. sensors: that share a link, each budget being that of all together; None where each has its own."""
    budgets = [adaptive_of(each * (sensors or 1), whole_link=sensors is not None) for each in sorted(kbit)]
    named = [replace(each, name=f"adaptive {kbit:g}") for each, kbit in zip(budgets, sorted(kbit), strict=True)]
    return Late(), *named, Foreground(step), Early()


def adaptive_of(kbit: float, *, whole_link: bool = False) -> Adaptive:
    """Adaptive sharing by a budget in kbit per frame. Raises ValueError for one that is none."""
    if not 0 <= kbit < MOST_GRANT / 1000:
        raise ValueError(f"a budget must be 0 to {MOST_GRANT // 1000} kbit, got {kbit}: such as 3")
    return Adaptive(int(kbit * 1000), whole_link)


def scheme_of(scheme: Scheme | str) -> Scheme:
    """A scheme by its name, or itself. Raises ValueError where there is none of that name."""
    if isinstance(scheme, str) and scheme in SCHEMES:
        return SCHEMES[scheme]
    if isinstance(scheme, str | type) or not isinstance(scheme, Scheme):
        raise ValueError(
            f"scheme must be one of {', '.join(SCHEMES)}, or an object with the members of "
            f"toolkit.detection.scheme.Scheme, got {scheme!r}"
        )
    return scheme
