"""`Setting`: what is asked, whatever the way to compute it: site, candidates, fusion, cases,
fidelity and costs. With a `toolkit.runtime.run.Run` it makes what scores sets:
`placement_env.objective.Objective(setting, run)`."""

import math
from collections.abc import Callable, Iterable
from dataclasses import KW_ONLY, dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Literal, get_args

from placement_env.candidates.candidates import Candidates, choose_candidates
from placement_env.cases import USUAL_CASES, Cases
from placement_env.checks import check_choice
from placement_env.classes import VEHICLES, Classes, find_classes
from placement_env.links import LINK_SHARE, check_link_share
from placement_env.protocol import Fidelity, FidelityName
from toolkit.detection.codec import PAPER, Codec, check_codec
from toolkit.detection.scheme import Scheme
from toolkit.detection.schemes import find_scheme
from toolkit.objects import Detector
from toolkit.sites.files import load_site
from toolkit.sites.site import Site

Rendering = Literal["auto", "full", "panorama"]


@dataclass(frozen=True)
class Weights:
    """Penalties subtracted from the AP."""

    comm: float = 0.0
    """Penalty per kbit, sensor and frame, in AP."""
    price: float = 0.0
    """Penalty per ordinary pole, in AP."""

    def __post_init__(self) -> None:
        if not (0 <= self.comm < math.inf and 0 <= self.price < math.inf):
            raise ValueError(
                f"weights must be finite and not negative, got comm {self.comm} and price "
                f"{self.price}"
            )


AP_ONLY = Weights()


@dataclass(frozen=True, eq=False)
class Setting:
    """Question that sets of sensors are scored by.

    site: a site, its name or file, None only with candidates and a fidelity of one's own;
    candidates: None or "paper" for the site's own sensors, "pool" for its pool, a GeoJSON file of
    poles, the candidates, or a function that makes them from the site; scheme, codec: of fusion and
    of what is sent; classes: of road users that count; cases: IoU thresholds, failures, levels of
    traffic and errors; fidelity: name of what scores a set, or an object that does; detector: of
    fidelity "detector", None for the shipped network; surrogate, table: files for these fidelities,
    None for the shipped ones; rendering: "auto", or all rays ("full") or panoramas wherever they
    can be used; weights: costs in the reward; most_price: most that a set may cost; keep: names of
    poles that must carry a sensor; link_share: of the frames, in which a link must carry what is
    sent (`placement_env.links`). Raises ValueError where a field does not fit.

    >>> Setting("tjunction", scheme="late", cases=Cases(iou=(0.7, 0.8))).scheme.name
    'late'
    """

    site: Site | str | None = None
    _: KW_ONLY
    candidates: Candidates | Callable[[Site], Candidates] | str | Path | None = None
    scheme: Scheme | str = "early"
    codec: Codec = PAPER
    classes: Classes | Iterable[str] = VEHICLES
    cases: Cases = USUAL_CASES
    fidelity: FidelityName | Fidelity = "surrogate"
    detector: Detector | None = None
    surrogate: str | Path | None = None
    table: str | Path | None = None
    rendering: Rendering = "auto"
    weights: Weights = field(default=AP_ONLY)
    most_price: float = math.inf
    keep: tuple[str, ...] = ()
    link_share: float = LINK_SHARE

    def __post_init__(self) -> None:
        if isinstance(self.fidelity, str):
            check_choice("fidelity", self.fidelity, get_args(FidelityName))
        if not isinstance(self.weights, Weights):
            raise ValueError(
                f"weights must be Weights, got {self.weights!r}: pass Weights(comm=..., price=...)"
            )
        if not self.most_price >= 0:
            raise ValueError(
                f"most_price must be 0 or more, got {self.most_price}: leave it out for any price"
            )
        if isinstance(self.keep, str):
            raise ValueError(f"keep must be names of poles, got {self.keep!r}: put it in a tuple")
        check_link_share(self.link_share)
        check_choice("rendering", self.rendering, get_args(Rendering))
        if self.detector is not None and not callable(self.detector):
            raise ValueError(
                f"detector must be a function of a cloud's points, or None, got {self.detector!r}"
            )
        site = load_site(self.site) if isinstance(self.site, str) else self.site
        scheme = find_scheme(self.scheme)
        codec = check_codec(self.codec)
        classes = find_classes(self.classes)
        vars(self).update(
            site=site,
            scheme=scheme,
            codec=codec,
            classes=classes,
            most_price=float(self.most_price),
        )
        vars(self).update(keep=tuple(dict.fromkeys(self.keep)))

    @cached_property
    def place(self) -> Site:
        """The site. Raises ValueError without one."""
        if not isinstance(self.site, Site):
            raise ValueError("this needs a site: Setting('tjunction'), or a site's file")
        return self.site

    @cached_property
    def pool(self) -> Candidates:
        """The candidates. Raises ValueError and OSError where there are none, or no pole of a name
        to be kept."""
        asked = self.candidates
        if callable(asked):
            found = asked(self.place)
        elif isinstance(asked, Candidates):
            found = asked
        else:
            found = choose_candidates(self.place, "paper" if asked is None else asked)
        found.find_mounts(self.keep)
        return found

    @property
    def fusion(self) -> Scheme:
        """The scheme."""
        return find_scheme(self.scheme)

    @property
    def counted(self) -> Classes:
        """The classes that count."""
        return find_classes(self.classes)

    def check_budget(self, budget: int) -> None:
        """Raise ValueError where fewer sensors are allowed than poles must carry one."""
        if self.keep and budget < len(self.keep):
            said = f"{len(self.keep)} poles must carry a sensor and a budget of {budget} is allowed"
            raise ValueError(f"{said}: raise the budget, or keep fewer poles")

    def with_fidelity(self, fidelity: FidelityName) -> "Setting":
        """Same question for another fidelity, without files and errors that it does not know."""
        cases = (
            self.cases if fidelity == "detector" else replace(self.cases, errors=USUAL_CASES.errors)
        )
        surrogate, table = (
            getattr(self, name) if name == fidelity else None for name in ("surrogate", "table")
        )
        return replace(self, fidelity=fidelity, cases=cases, surrogate=surrogate, table=table)
