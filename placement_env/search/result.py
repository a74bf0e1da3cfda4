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
from toolkit.runtime.text_values import read_json, replace_infinite
from toolkit.runtime.writing import write_text
from toolkit.sensors.models import make_model
from toolkit.sensors.sensor import Sensor

VERSION = 1  # version of result files
_Row = dict[str, Any]  # JSON values of a file
Measure = Literal["reward", "coverage", "price", "hits"]  # meaning of a certificate's figures


@dataclass(frozen=True, eq=False)
class History:
    """Best reward after each improvement, and at the end, one row each in the course of time.

    Attributes:
        evaluations: Sets scored by then.
        seconds: Time since the search began (s).
        reward: Best reward so far.
    """

    evaluations: Int64[np.ndarray, " n"]
    seconds: Float64[np.ndarray, " n"]
    reward: Float64[np.ndarray, " n"]

    def at(self, *, evaluations: float = np.inf, seconds: float = np.inf) -> float:
        """Best reward by the time that a number of sets was scored or some seconds had passed.

        The earlier of both counts. It is 0, as for the empty set, before the first entry."""
        is_reached = (self.evaluations <= evaluations) & (self.seconds <= seconds)
        return float(self.reward[is_reached][-1]) if is_reached.any() else 0.0


@dataclass(frozen=True)
class Certificate:
    """Evidence of how good an answer is.

    Attributes:
        kind: "optimal", no feasible set is better; "bound", no set is better than `bound`; "local
            optimum", none that differs in one sensor is better; "none", nothing is known.
        value: Figure of the answer, in `measure`.
        bound: Bound on all feasible sets, in `measure`.
        ratio: Share of the optimum that the method is sure to reach before it starts, 0 for none.
        note: Evidence in words, with the conditions.
        measure: Meaning of `value` and `bound`.
    """

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
        """Certificate "optimal" if the answer's figure equals its bound, otherwise "bound".

        value, bound: in `measure`; note: evidence in words."""
        is_optimal = value == bound
        return Certificate(
            kind="optimal" if is_optimal else "bound",
            value=value,
            bound=bound,
            ratio=1.0 if is_optimal else 0.0,
            note=note,
            measure=measure,
        )

    @property
    def gap(self) -> float:
        """Largest improvement the bound leaves open, in `measure`; 0 for an optimal answer.

        For prices it is the largest fall."""
        difference = self.bound - self.value
        return max(0.0, -difference if self.measure == "price" else difference)


@dataclass(frozen=True)
class Contender:
    """Answer of some searches of a portfolio, or its winner.

    Attributes:
        searches: Names of the searches, empty for a neighbour of their answers.
        subset: Indices of the candidates.
        predicted: AP by the searched objective.
        ap: AP by the judge on traffic that neither searches nor race used.
        low: Lower end of the 95 % interval.
        high: Upper end of the 95 % interval.
    """

    searches: tuple[str, ...]
    subset: tuple[int, ...]
    predicted: float
    ap: float
    low: float
    high: float

    @property
    def curse(self) -> float:
        """Overestimate of the search in AP (the winner's curse)."""
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
    """Assessment of a portfolio's answer on traffic that neither searches nor race used.

    Attributes:
        by: Fidelity of race and assessment.
        ap: AP of the answer.
        low: Lower end of its 95 % interval.
        high: Upper end of its 95 % interval.
        kbit: Data of the whole set per frame.
        objects: Number of objects in these frames.
        frames: Number of frames.
        predicted: AP by the searched objective.
        confidence: Confidence that no entrant is better by more than `tolerance`, NaN if there are
            too few frames or objects.
        asked: Level of confidence to reach.
        tolerance: AP difference that is ignored.
        entrants: Number of sets that raced.
        raced: Frames that the winner was raced on.
        contenders: Assessed answers of searches.
        expected: AP expected after the race.
        by_errors: AP at each of several error profiles.
        errors_by: "worst" or "mean", which gives `ap` from `by_errors`.
    """

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
    """Answer of a search.

    Attributes:
        method: Name of the search.
        best: Best set and its score.
        history: Best reward over time.
        certificate: Evidence of how good the answer is.
        evaluations: Number of scored sets, repeated ones too.
        seconds: Duration of the search.
        front: Scored sets that no other beats in AP, kbit and price together, by price and kbit
            (exhaustive only).
        by_size: Best set of 1, 2, ... sensors (exhaustive only).
        sensors: Sensors in continuous poses.
        assessment: Assessment on fresh traffic (portfolio only).
        origin: Site, frames and seed of the traffic, version, and names of the best set's sensors
            (`Objective.describe_origin`).
    """

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
        """Write the result as JSON, completely or not at all; null means a non-finite value.

        Raises FileExistsError for a file that may not be overwritten.
        """
        if Path(path).exists() and not overwrite:
            raise FileExistsError(f"{path} exists: save to another file, or pass overwrite=True")
        content = {"coview_result": VERSION} | asdict(self)
        content["history"] = {name: column.tolist() for name, column in vars(self.history).items()}
        content["sensors"] = [_describe_sensor(sensor) for sensor in self.sensors]
        write_text(path, json.dumps(replace_infinite(content), indent=1, allow_nan=False) + "\n")

    @staticmethod
    def load(path: str | Path) -> "Result":
        """Read a file that `save` wrote.

        Raises OSError, or ValueError in one line for a damaged or foreign file.
        """
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
            problem = str(error).partition("\n")[0][:120]
            raise ValueError(
                f"{path} is no result of a search ({problem}): restore the file"
            ) from None

    def _card(self) -> Card:
        """Card by which notebooks show the result: a title, facts, tables and a picture.

        Tables are functions that return columns by name; the picture is named by its function."""
        method, _, summary = str(self).partition(": ")
        tables = {"history": lambda: vars(self.history), "front": lambda: _tabulate(self.front)}
        if self.assessment is not None:
            contenders = self.assessment.contenders
            tables = {"contenders": lambda: _tabulate(contenders)} | tables  # the first table
        facts = [summary]
        names = self.origin.get("sensors") or [sensor.name for sensor in self.sensors]
        if names:
            facts.append(f"sensors {', '.join(names)}")
        picture = "placement_env.report.charts:draw_history"
        return Card(f"Result of {method}", facts=tuple(facts), tables=tables, drawing=picture)

    def __str__(self) -> str:
        """One line: search, members of the best set, AP or reward, effort and certificate."""
        certificate = self.certificate
        assessment = self.assessment
        bound_word = "least" if certificate.measure == "price" else "most"
        bound = ""
        if np.isfinite(certificate.bound):
            bound = f", at {bound_word} {certificate.bound:.4f} {certificate.measure}"
        figure = f"reward {self.best.reward:.4f}"
        if assessment is not None:
            ap = format_share(assessment.ap, assessment.objects)
            figure = f"AP {ap} by the {assessment.by}"
        kind = "nothing is proven" if certificate.kind == "none" else certificate.kind
        return (
            f"{self.method}: {{{', '.join(map(str, self.best.subset))}}} {figure} after "
            f"{self.evaluations} sets and {self.seconds:.1f} s ({kind}{bound})"
        )


def _tabulate(rows: Sequence[Score | Contender]) -> Table:
    """Columns of values by field name, one row for each score or contender.

    The dictionaries of a score, terms of the reward and AP by class, are left out."""
    if not rows:
        return {}
    names = [column.name for column in fields(rows[0]) if column.name not in ("terms", "class_ap")]
    table: dict[str, list[object]] = {}
    for name in names:
        table[name] = [getattr(row, name) for row in rows]
    return table


def _describe_sensor(sensor: Sensor) -> _Row:
    """JSON values from which `_build_sensor` makes the sensor again."""
    model_values = {}
    for name in [column.name for column in fields(sensor.model)]:
        value = getattr(sensor.model, name)
        model_values[name] = value.tolist() if isinstance(value, np.ndarray) else value
    return {
        "name": sensor.name,
        "model": type(sensor.model).__name__,
        "values": model_values,
        "pose": sensor.pose.tolist(),
    }


def _build_result(content: _Row) -> Result:
    """Result from the JSON values of a file, by field name.

    Raises KeyError, TypeError, ValueError and others for damaged values. The values of an
    assessment are changed in place."""
    history = content["history"]
    certificate = content["certificate"]
    values = {  # fields that are no plain JSON values
        "best": load_score(content["best"]),
        "history": History(
            evaluations=np.array(history["evaluations"], np.int64),
            seconds=np.array(history["seconds"], np.float64),
            reward=np.array(history["reward"], np.float64),
        ),
        "certificate": Certificate(
            **certificate | {"bound": _fill_null(certificate["bound"], math.inf)}
        ),
        "front": tuple(map(load_score, content["front"])),
        "by_size": tuple(map(load_score, content["by_size"])),
        "sensors": tuple(map(_build_sensor, content["sensors"])),
    }
    if content["assessment"] is not None:
        values["assessment"] = _build_assessment(content["assessment"])
    result = Result(**content | values)
    amounts = [result.evaluations, result.seconds]
    amounts += [*result.history.evaluations, *result.history.seconds]
    _check_figures(shares=(), amounts=amounts)
    return result


def _build_sensor(row: _Row) -> Sensor:
    """Sensor from its JSON values: name, model with its values, and pose (4 by 4)."""
    return Sensor(
        row["name"], make_model(row["model"], row["values"]), np.array(row["pose"], np.float64)
    )


def _build_assessment(row: _Row) -> Assessment:
    """Assessment from its JSON values by field name, checked.

    `row` is changed in place: null becomes NaN, and lists become tuples."""
    contender_rows = row["contenders"]
    profile_rows = row.get("by_errors", ())
    for figures in (row, *contender_rows, *profile_rows):
        figures |= {name: _fill_null(figures[name], math.nan) for name in ("low", "high")}
    for contender in contender_rows:
        contender |= {name: tuple(contender[name]) for name in ("searches", "subset")}
    values = {
        "expected": _fill_null(row.get("expected"), math.nan),
        "confidence": _fill_null(row["confidence"], math.nan),
        "contenders": tuple(Contender(**contender) for contender in contender_rows),
        "by_errors": tuple(ProfileAP(**profile) for profile in profile_rows),
    }
    assessment = Assessment(**row | values)
    shares = [assessment.ap, assessment.low, assessment.high]
    judged_sets: list[Contender | ProfileAP] = [*assessment.contenders, *assessment.by_errors]
    for judged_set in judged_sets:
        shares += [judged_set.ap, judged_set.low, judged_set.high]
    amounts = (assessment.kbit, assessment.objects, assessment.frames)
    _check_figures(shares=[*shares, assessment.confidence], amounts=amounts)
    return assessment


def load_score(row: _Row) -> Score:
    """Score from the JSON values of a file, by field name.

    Raises ValueError for figures out of range, TypeError for a member that is no whole number."""
    by_class = {name: _fill_null(ap, math.nan) for name, ap in row["class_ap"].items()}
    subset = tuple(map(operator.index, row["subset"]))  # `index` refuses floats
    score = Score(**row | {"subset": subset, "class_ap": by_class})
    _check_figures(
        shares=(score.ap, score.recall, *by_class.values()),
        amounts=(score.kbit, score.kbit_per_sensor, score.price),
    )
    return score


def _check_figures(shares: Iterable[float], amounts: Iterable[float]) -> None:
    """Raise ValueError for a share outside 0..1, such as an AP, or an amount below 0.

    A share may be NaN, an amount may not."""
    for share in shares:
        if not 0 <= share <= 1 and share == share:  # NaN does not equal itself
            raise ValueError(f"AP, recall and confidence must lie in 0..1, got {share}")
    for amount in amounts:
        if not amount >= 0:  # also for NaN
            raise ValueError(f"kbit, prices, counts and times must be at least 0, got {amount}")


def _fill_null(value: float | None, absent: float) -> float:
    """Number from a file; null means not finite, since JSON has no non-finite numbers.

    absent: the number that null was, infinity or NaN."""
    return absent if value is None else float(value)
