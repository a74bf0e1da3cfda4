"""`Result` of a search: the best set, its history, and evidence of how good it is."""

import json
import math
import operator
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass, field, fields
from pathlib import Path
from typing import Any, Literal

import numpy as np

from placement_env.objective import Score
from toolkit.arrays import Float64, Int64
from toolkit.display import Card, Displayed, Table, format_share
from toolkit.runtime.files import read_json, replace_infinite, write_text
from toolkit.sensors.models import make_model
from toolkit.sensors.sensor import Sensor

VERSION = 1  # of result files
_Row = dict[str, Any]  # JSON values of a file
Measure = Literal["reward", "coverage", "price", "hits"]  # what a certificate's figures are of


@dataclass(frozen=True, eq=False)
class History:
    """Best reward after each improvement, and at the end. evaluations: sets scored; seconds: since
    the search began."""

    evaluations: Int64[np.ndarray, " n"]
    seconds: Float64[np.ndarray, " n"]
    reward: Float64[np.ndarray, " n"]

    def at(self, *, evaluations: float = np.inf, seconds: float = np.inf) -> float:
        """Best reward at a number of sets or seconds. Before the first entry it is 0, the empty
        set's."""
        known = (self.evaluations <= evaluations) & (self.seconds <= seconds)
        return float(self.reward[known][-1]) if known.any() else 0.0


@dataclass(frozen=True)
class Certificate:
    """Evidence of how good an answer is.

    kind: "optimal", no feasible set is better; "bound", none is better than `bound`; "local
    optimum", none that differs in one sensor is better; "none", nothing is known; value, bound: of
    the answer and of all feasible sets, in `measure`; ratio: share of the optimum that the method
    is sure to reach before it starts, 0 where none; note: in words, with the conditions."""

    kind: Literal["optimal", "bound", "local optimum", "none"]
    value: float
    bound: float = np.inf
    ratio: float = 0.0
    note: str = ""
    measure: Measure = "reward"

    @staticmethod
    def from_bound(
        value: float, bound: float, note: str, measure: Measure = "reward"
    ) -> "Certificate":
        """Certificate of an answer that is optimal where it equals its bound."""
        return Certificate(
            "optimal" if value == bound else "bound",
            value,
            bound,
            float(value == bound),
            note,
            measure,
        )

    @property
    def gap(self) -> float:
        """Most by which the optimum may be better, in `measure`; 0 where the answer is optimal.
        Prices fall."""
        return max(
            0.0, self.value - self.bound if self.measure == "price" else self.bound - self.value
        )


@dataclass(frozen=True)
class Contender:
    """Answer of some searches of a portfolio, or its winner. searches: empty where it is a
    neighbour. predicted: AP by the searched objective; ap, low, high: by the judge on traffic that
    neither searches nor race saw."""

    searches: tuple[str, ...]
    subset: tuple[int, ...]
    predicted: float
    ap: float
    low: float
    high: float

    @property
    def curse(self) -> float:
        """The winner's curse: the search's overestimate, in AP."""
        return self.predicted - self.ap


@dataclass(frozen=True)
class ProfileAP:
    """AP of an answer at one named error profile, with its interval."""

    name: str
    ap: float
    low: float
    high: float


@dataclass(frozen=True)
class Assessment:
    """Judgement of a portfolio's answer on traffic that neither searches nor race saw.

    by: fidelity of race and judgement; ap, low, high: of the answer, with its 95 % interval; kbit:
    of the whole set; objects, frames: used to judge it; predicted: AP by the searched objective;
    confidence: that no entrant is better by more than `tolerance`, NaN from too few frames or
    objects; `asked` is the level to reach; entrants: sets that raced; raced: frames that the winner
    was raced on; contenders: judged answers of searches; by_errors: AP at each of several error
    profiles, from which `ap` is the "worst" or the "mean", as `errors_by` says."""

    by: str
    ap: float
    low: float
    high: float
    kbit: float
    objects: int
    frames: int
    predicted: float
    confidence: float
    asked: float
    tolerance: float
    entrants: int
    raced: int
    contenders: tuple[Contender, ...]
    expected: float = math.nan
    by_errors: tuple[ProfileAP, ...] = ()
    errors_by: str = ""

    @property
    def curse(self) -> float:
        """AP by which the objective overrates the answer."""
        return self.predicted - self.ap


@dataclass(frozen=True, eq=False)
class Result(Displayed):
    """Answer of a search. evaluations: sets scored, repeated ones too; sensors: in continuous
    poses.

    front: scored sets that no other beats in AP, kbit and price at once, by price and kbit, and
    by_size: the best set of 1, 2, ... sensors (exhaustive only); assessment: on fresh traffic
    (portfolio only); origin: site, frames and seed of the traffic, version, and the best set's
    sensors by name, see `Objective.describe_origin`."""

    method: str
    best: Score
    history: History
    certificate: Certificate
    evaluations: int
    seconds: float
    front: tuple[Score, ...] = ()
    by_size: tuple[Score, ...] = ()
    sensors: tuple[Sensor, ...] = ()
    assessment: Assessment | None = None
    origin: dict[str, Any] = field(default_factory=dict)

    def save(self, path: str | Path, *, overwrite: bool = False) -> None:
        """Write the result as JSON, completely or not. `load` reads it; null stands for non-finite
        values. Raises FileExistsError for a file that may not be overwritten."""
        if Path(path).exists() and not overwrite:
            raise FileExistsError(f"{path} exists: save to another file, or pass overwrite=True")
        content = {"coview_result": VERSION} | asdict(self)
        content["history"] = {name: column.tolist() for name, column in vars(self.history).items()}
        content["sensors"] = [_describe_sensor(sensor) for sensor in self.sensors]
        write_text(path, json.dumps(replace_infinite(content), indent=1, allow_nan=False) + "\n")

    @staticmethod
    def load(path: str | Path) -> "Result":
        """Read a file that `save` wrote. Raises OSError, or ValueError in one line for a damaged or
        foreign file."""
        content = read_json(path)
        if not isinstance(content, dict) or content.get("coview_result") != VERSION:
            raise ValueError(
                f"{path} is no result of a search, version {VERSION}: write one with Result.save"
            )
        try:
            return _build_result(
                {name: value for name, value in content.items() if name != "coview_result"}
            )
        except (AttributeError, KeyError, OverflowError, TypeError, ValueError) as error:
            said = str(error).partition("\n")[0][:120]
            raise ValueError(
                f"{path} is no result of a search ({said}): restore the file"
            ) from None

    def _card(self) -> Card:
        title, _, fact = str(self).partition(": ")
        tables = {"history": lambda: vars(self.history), "front": lambda: _tabulate(self.front)}
        if self.assessment is not None:
            contenders = self.assessment.contenders
            tables = {"contenders": lambda: _tabulate(contenders)} | tables
        named = self.origin.get("sensors") or [sensor.name for sensor in self.sensors]
        facts = fact, *([f"sensors {', '.join(named)}"] if named else [])
        return Card(f"Result of {title}", facts, tables, "placement_env.report.charts:draw_history")

    def __str__(self) -> str:
        known = self.certificate
        judged = self.assessment
        end = "least" if known.measure == "price" else "most"
        bound = f", at {end} {known.bound:.4f} {known.measure}" if np.isfinite(known.bound) else ""
        figure = f"reward {self.best.reward:.4f}"
        if judged is not None:
            figure = f"AP {format_share(judged.ap, judged.objects)} by the {judged.by}"
        kind = "nothing is proven" if known.kind == "none" else known.kind
        return (
            f"{self.method}: {{{', '.join(map(str, self.best.subset))}}} {figure} after "
            f"{self.evaluations} sets and {self.seconds:.1f} s ({kind}{bound})"
        )


def _tabulate(rows: Sequence[Score | Contender]) -> Table:
    """Columns of plain values."""
    names = (
        [each.name for each in fields(rows[0]) if each.name not in ("terms", "class_ap")]
        if rows
        else []
    )
    return {name: [getattr(row, name) for row in rows] for name in names}


def _describe_sensor(sensor: Sensor) -> _Row:
    values = {field.name: getattr(sensor.model, field.name) for field in fields(sensor.model)}
    plain = {
        name: value.tolist() if isinstance(value, np.ndarray) else value
        for name, value in values.items()
    }
    return {
        "name": sensor.name,
        "model": type(sensor.model).__name__,
        "values": plain,
        "pose": sensor.pose.tolist(),
    }


def _build_result(content: _Row) -> Result:
    history = content["history"]
    certificate = content["certificate"]
    assessment = content["assessment"]
    rows = {
        "best": load_score(content["best"]),
        "history": History(
            np.array(history["evaluations"], np.int64),
            *(np.array(history[name], np.float64) for name in ("seconds", "reward")),
        ),
        "certificate": Certificate(
            **certificate | {"bound": _number(certificate["bound"], math.inf)}
        ),
        "front": tuple(map(load_score, content["front"])),
        "by_size": tuple(map(load_score, content["by_size"])),
        "sensors": tuple(
            Sensor(
                row["name"],
                make_model(row["model"], row["values"]),
                np.array(row["pose"], np.float64),
            )
            for row in content["sensors"]
        ),
    }
    if assessment is not None:
        for each in (assessment, *assessment["contenders"], *assessment.get("by_errors", ())):
            each |= {name: _number(each[name], math.nan) for name in ("low", "high")}
        for each in assessment["contenders"]:
            each |= {name: tuple(each[name]) for name in ("searches", "subset")}
        judged = {
            "expected": _number(assessment.get("expected"), math.nan),
            "confidence": _number(assessment["confidence"], math.nan),
            "contenders": tuple(Contender(**each) for each in assessment["contenders"]),
            "by_errors": tuple(ProfileAP(**each) for each in assessment.get("by_errors", ())),
        }
        rows["assessment"] = known = Assessment(**assessment | judged)
        judged_sets: tuple[Assessment | Contender | ProfileAP, ...] = (
            known,
            *known.contenders,
            *known.by_errors,
        )
        figures = [each for some in judged_sets for each in (some.ap, some.low, some.high)]
        _check_figures((*figures, known.confidence), (known.kbit, known.objects, known.frames))
    result = Result(**content | rows)
    _check_figures(
        (),
        (result.evaluations, result.seconds, *result.history.evaluations, *result.history.seconds),
    )
    return result


def load_score(row: _Row) -> Score:
    """Score from the values of a file."""
    by_class = {name: _number(ap, math.nan) for name, ap in row["class_ap"].items()}
    score = Score(
        **row | {"subset": tuple(map(operator.index, row["subset"])), "class_ap": by_class}
    )
    _check_figures(
        (score.ap, score.recall, *by_class.values()),
        (score.kbit, score.kbit_per_sensor, score.price),
    )
    return score


def _check_figures(shares: Iterable[float], amounts: Iterable[float]) -> None:
    """Raise ValueError for a share outside 0..1, such as an AP, or an amount below 0."""
    if wrong := [each for each in shares if not 0 <= each <= 1 and each == each]:
        raise ValueError(f"AP, recall and confidence must lie in 0..1, got {wrong[0]}")
    if wrong := [each for each in amounts if not each >= 0]:
        raise ValueError(f"kbit, prices, counts and times must be at least 0, got {wrong[0]}")


def _number(value: float | None, absent: float) -> float:
    """Number from a file; null means not finite. JSON has no non-finite numbers."""
    return absent if value is None else float(value)
