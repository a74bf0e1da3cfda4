"""`Setting`: the question, independent of how it is computed: site, candidates, fusion, cases,
fidelity and costs. With a `toolkit.runtime.run.Run` it makes the scorer of sets:
`placement_env.objective.Objective(setting, run)`.
"""

import math
from collections.abc import Callable, Iterable
from copy import copy
from dataclasses import KW_ONLY, dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Literal, cast, get_args

from placement_env.candidates.candidates import Candidates, choose_candidates
from placement_env.cases import Cases
from placement_env.checks import check_choice
from placement_env.classes import Classes, find_classes
from placement_env.defaults import USUAL_CASES, VEHICLES
from placement_env.links import LINK_SHARE, check_link_share
from placement_env.protocol import Fidelity, FidelityName
from toolkit.detection.codec import PAPER, Codec, check_codec
from toolkit.detection.scheme import Scheme
from toolkit.detection.schemes import find_scheme
from toolkit.frozen import set_cached, set_fields
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
        """Raise ValueError for a penalty that is negative or not finite."""
        if not (0 <= self.comm < math.inf and 0 <= self.price < math.inf):
            raise ValueError(
                f"weights must be finite and not negative, got comm {self.comm} and price "
                f"{self.price}"
            )


@dataclass(frozen=True, eq=False)
class Setting:
    """Question that sets of sensors are scored by, all that scores depend on but seed and frames.

    Raises ValueError if a field does not fit.

    Attributes:
        site: Site, its name or file; None only with candidates and a custom fidelity.
        candidates: None or "paper" for the site's sensors, "pool" for its pool, a GeoJSON file of
            poles, the candidates, or a function that makes them from the site.
        scheme: Fusion scheme.
        codec: Codec of the sent data.
        classes: Classes of road users that count.
        cases: IoU thresholds, failures, levels of traffic and errors.
        fidelity: Name of a way to score sets, or an object that scores them.
        detector: Detector of fidelity "detector", None for the shipped network.
        surrogate: File of fitted figures for fidelity "surrogate", None for the shipped one.
        table: File of scored sets for fidelity "table", None for the shipped one.
        rendering: "full" casts all rays, "panorama" takes depth panoramas of each place wherever
            they can be used, "auto" chooses between them.
        weights: Costs in the reward.
        most_price: Largest price of a set, inf for any.
        keep: Names of poles that must carry a sensor.
        link_share: Share of the frames (0 to 1) in which a link must carry all data
            (`placement_env.links`).

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
    weights: Weights = Weights()
    most_price: float = math.inf
    keep: tuple[str, ...] = ()
    link_share: float = LINK_SHARE

    def __post_init__(self) -> None:
        """Check the fields, and replace names of site, scheme, codec and classes by objects."""
        if isinstance(self.fidelity, str):
            check_choice("fidelity", self.fidelity, get_args(FidelityName))
        if not isinstance(self.weights, Weights):
            raise ValueError(
                f"weights must be Weights, got {self.weights!r}: pass Weights(comm=..., price=...)"
            )
        # NaN too is refused
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
        set_fields(
            self,
            site=load_site(self.site) if isinstance(self.site, str) else self.site,
            scheme=find_scheme(self.scheme),
            codec=check_codec(self.codec),
            classes=find_classes(self.classes),
            most_price=float(self.most_price),
            keep=tuple(dict.fromkeys(self.keep)),
        )

    @cached_property
    def place(self) -> Site:
        """Site of the question. Raises ValueError if there is none, only candidates."""
        if not isinstance(self.site, Site):
            raise ValueError("this needs a site: Setting('tjunction'), or a site's file")
        return self.site

    @cached_property
    def pool(self) -> Candidates:
        """Candidate sensors, made from the site or read from a file if needed, and then kept.

        Raises ValueError and OSError without candidates, ValueError for an unknown pole to keep."""
        source = self.candidates
        if callable(source):
            candidates = source(self.place)
        elif isinstance(source, Candidates):
            candidates = source
        else:
            candidates = choose_candidates(self.place, "paper" if source is None else source)
        candidates.find_mounts(self.keep)  # raises ValueError for an unknown pole
        return candidates

    @cached_property
    def fusion(self) -> Scheme:
        """Fusion scheme, which `__post_init__` found if a name was given."""
        return cast(Scheme, self.scheme)

    @cached_property
    def counted(self) -> Classes:
        """Classes of road users that count, which `__post_init__` made if names were given."""
        return cast(Classes, self.classes)

    def check_budget(self, budget: int) -> None:
        """Raise ValueError if fewer sensors are allowed than poles that must carry one.

        budget: largest number of sensors."""
        if self.keep and budget < len(self.keep):
            problem = (
                f"{len(self.keep)} poles must carry a sensor and a budget of {budget} is allowed"
            )
            raise ValueError(f"{problem}: raise the budget, or keep fewer poles")

    def with_candidates(
        self,
        candidates: Candidates,
        *,
        fidelity: FidelityName | Fidelity | None = None,
        weights: Weights | None = None,
    ) -> "Setting":
        """Setting of other candidates at the same site, copied without parsing again.

        fidelity, weights: None to keep them. Raises ValueError for an unknown pole to keep."""
        if self.keep:
            candidates.find_mounts(self.keep)  # raises the error
        setting = copy(self)
        set_fields(
            setting,
            candidates=candidates,
            fidelity=self.fidelity if fidelity is None else fidelity,
            weights=self.weights if weights is None else weights,
        )
        set_cached(setting, pool=candidates)  # or the copy would keep the pool of this setting
        return setting

    def with_costs(self, weights: Weights, most_price: float) -> "Setting":
        """Setting with the same candidates, other weights and `most_price` as its price limit."""
        setting = replace(self, weights=weights, most_price=most_price)
        if "pool" in vars(self):  # candidates that were made already are not made again
            set_cached(setting, pool=self.pool)
        return setting

    def with_fidelity(self, fidelity: FidelityName) -> "Setting":
        """Setting of another fidelity, otherwise like this one.

        Error profiles of the sensors become the usual ones unless the fidelity is the detector, and
        the file of another fidelity (surrogate, table) is left out."""
        cases = self.cases
        if fidelity != "detector":
            cases = replace(cases, errors=USUAL_CASES.errors)
        return replace(
            self,
            fidelity=fidelity,
            cases=cases,
            surrogate=self.surrogate if fidelity == "surrogate" else None,
            table=self.table if fidelity == "table" else None,
        )
