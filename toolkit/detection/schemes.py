"""The fusion schemes that go by a name: the one place where they are looked up."""

from __future__ import annotations

from toolkit.detection.early import Early
from toolkit.detection.hybrid import Hybrid
from toolkit.detection.late import Late
from toolkit.detection.link.foreground import Foreground
from toolkit.detection.scheme import Scheme

PAPER_SCHEMES = ("early", "late", "hybrid")  # what tables of sensor sets and observations hold, in this order
SCHEMES: dict[str, Scheme] = {"early": Early(), "late": Late(), "hybrid": Hybrid(), "foreground": Foreground()}


def schemes_in_steps(step: float) -> dict[str, Scheme]:
    """The same, those that send numbers in steps doing so in these (m)."""
    return SCHEMES | {"foreground": Foreground(step)}


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
