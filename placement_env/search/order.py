"""`SearchOrder`: specification of one search, checked before anything is rendered."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass, replace
from hashlib import sha256
from pathlib import Path
from typing import Any, Literal

from placement_env.fidelity.preparation import check_scorable
from placement_env.fidelity.table import hash_site
from placement_env.protocol import FidelityName
from placement_env.search.checkpoint import Checkpoint
from placement_env.search.checkpoint_folder import NOWHERE, find_unfinished, open_checkpoint
from placement_env.search.exact.cheapest import Demand
from placement_env.search.methods import METHODS, check_search
from placement_env.search.portfolio.curve import budget_curve
from placement_env.setting import Setting
from toolkit.detection.codec import PAPER
from toolkit.detection.provenance import detector_origin
from toolkit.runtime.run import Run

PORTFOLIO = "portfolio"
UNFINISHED_SUFFIX = ".parts"  # suffix of the folder that keeps the state of a search
DEFAULT_FRAMES = 200
Summary = dict[str, Any]  # JSON values


@dataclass(frozen=True, kw_only=True, eq=False)
class SearchOrder:
    """Specification of a search, checked before anything is rendered.

    Attributes:
        setting: The question, with the errors of the detecting fidelities.
        run: Frames, seed, cache and processes.
        method: Name of a search in `placement_env.search.methods`.
        budget: Largest number of sensors.
        verify: Fidelity that scores an answer and its neighbours.
        judge: Fidelity of a portfolio's race and assessment.
        confidence: Confidence at which a portfolio's race ends.
        contenders: Whether a portfolio also assesses the answer of each search.
        seconds: Time limit, None for no limit.
        evaluations: Largest number of scored sets, None for no limit.
        demand: Conditions for the cheapest set.
        curve: Whether to search a budget curve with a portfolio: one set for each number of
            sensors up to the budget, or for each amount if the price is limited.
        currency: Currency of prices, "" for prices of one ordinary pole.
        tell: Called with a line for each early answer.

    Raises ValueError or ImportError if the parts do not fit together.
    """

    setting: Setting
    run: Run = Run()
    method: str = PORTFOLIO
    budget: int = 4
    verify: Literal["detector"] | None = None
    judge: FidelityName = "detector"
    confidence: float = 0.95
    contenders: bool = False
    seconds: float | None = None
    evaluations: int | None = None
    demand: Demand | None = None
    curve: bool = False
    currency: str = ""
    tell: Callable[[str], None] | None = None

    def __post_init__(self) -> None:
        """Raise ValueError or ImportError if the fields do not fit together."""
        setting = self.setting
        if not 0 < self.confidence < 1:
            raise ValueError(
                f"confidence must lie between 0 and 1, got {self.confidence}: 0.95 is usual"
            )
        check_search(self.method, self.fidelity, candidates=setting.pool, cases=setting.cases)
        setting.check_budget(self.budget)
        if setting.keep and self.method == "ppo":
            raise ValueError(
                "method ppo does not know poles that must carry a sensor: pass --method portfolio "
                "or swap"
            )
        if self.fidelity == "table" and setting.codec != PAPER:
            raise ValueError(
                f"tables hold kbit of the paper's codec, got {setting.codec}: pass --codec paper"
            )
        for path, fidelity in ((setting.surrogate, "surrogate"), (setting.table, "table")):
            if path is not None and fidelity != self.fidelity:
                raise ValueError(
                    f"this file is for fidelity {fidelity}, got {self.fidelity!r}: leave one of "
                    "them out"
                )
        check_scorable(self.search_setting)
        if self.verify is not None:
            check_scorable(setting.with_fidelity(self.verify))
        if self.method == PORTFOLIO:
            check_scorable(setting.with_fidelity(self.judge))

    @property
    def fidelity(self) -> FidelityName:
        """Name of the fidelity that the search scores sets by.

        Raises ValueError for a setting with a fidelity of its user in place of a name."""
        if not isinstance(self.setting.fidelity, str):
            raise ValueError(
                f"a search is ordered by the name of a fidelity, got {self.setting.fidelity!r}"
            )
        return self.setting.fidelity

    @property
    def search_setting(self) -> Setting:
        """Setting with the searched fidelity; only detecting fidelities keep error profiles."""
        return self.setting.with_fidelity(self.fidelity)

    @property
    def detects(self) -> bool:
        """True if the detector scores anything in search, verification, race or assessment."""
        judge = self.judge if self.method == PORTFOLIO else None
        return "detector" in (self.fidelity, self.verify, judge)

    @property
    def question(self) -> Summary:
        """Everything the answer depends on, as JSON values; a search resumes only if they are
        equal."""
        setting = self.setting
        options = (
            "method",
            "budget",
            "verify",
            "judge",
            "confidence",
            "contenders",
            "seconds",
            "evaluations",
            "currency",
            "curve",
        )
        question: Summary = {name: getattr(self, name) for name in options}
        if self.demand is not None:
            question |= asdict(self.demand)
        files = {"surrogate": setting.surrogate, "table": setting.table}
        for name, path in files.items():
            question[name] = path and sha256(Path(path).read_bytes()).hexdigest()  # None stays None
        question |= {
            "fidelity": self.fidelity,
            "frames": self.run.frames_or(DEFAULT_FRAMES),
            "seed": self.run.seed,
            "site": hash_site(setting.place, setting.place.sensors),
            "candidates": setting.pool.digest(),
            "scheme": setting.fusion.digest,
            "codec": setting.codec.digest,
            "weights": asdict(setting.weights),
            "cases": setting.cases.origin,
            "errors": setting.cases.errors_origin,
            "detector": None if setting.detector is None else detector_origin(setting.detector),
            "classes": setting.counted.origin,
            "most_price": setting.most_price,
        }
        if setting.keep:
            question["keep"] = setting.keep
        return question

    def resumes(self, out: Path) -> bool:
        """True if a search with this question was interrupted and can resume.

        out: folder of the answer, next to which the state is kept."""
        state_folder = out.with_name(out.name + UNFINISHED_SUFFIX)
        unfinished = find_unfinished(state_folder, self.question)
        return unfinished.found == unfinished.plan  # question in the folder, and this question

    @contextmanager
    def keeping(
        self, out: Path | None, *, overwrite: bool = False
    ) -> "Iterator[tuple[SearchOrder, Checkpoint]]":
        """Yield the order, with a cache if it lacks one, and the checkpoint of its answer's folder.

        The block must search and write the answer. Until it ends normally, the state of the search
        is kept next to the folder of the answer, in a folder with the suffix `UNFINISHED_SUFFIX`,
        and the same question resumes there. The cache of an order without one is in that folder
        too.

        out: folder of the answer, None to keep no state; overwrite: whether the state of another
        search may be overwritten. Raises FileExistsError if another search is unfinished and may
        not be overwritten.
        """
        if out is None:
            yield self, NOWHERE
            return
        state_folder = out.with_name(out.name + UNFINISHED_SUFFIX)
        code = budget_curve.__module__ if self.curve else METHODS[self.method].module
        with open_checkpoint(
            state_folder, self.question, code=code, overwrite=overwrite
        ) as checkpoint:
            # a detector without a digest might find the detections of another one there
            is_cacheable = self.setting.detector is None or hasattr(self.setting.detector, "digest")
            cache = self.run.cache or (checkpoint.place("cache") if is_cacheable else None)
            yield replace(self, run=replace(self.run, cache=cache)), checkpoint
