"""`HitModel`: the probability that a detector finds an object, given the points on it; a few
numbers, kept as JSON.

An object has heading ψ, N_i points from sensor i of a set, and distance d_i in metres. Its hit
probability is

    p = ceiling · (V / 16 m³) ^ -bulk · sigmoid(intercept + density · e) · min(1, r / floor)
    e = log(1 + Σ n_i ^ norm) / norm
    n_i = N_i · (d_i / 20 m) ^ reach · exp(-oblique · |sin 2ψ|)
    p = 0 without any point
    r = (Σ N_i ^ norm) ^ (1 / norm)

A point from farther away stands for more of the object: with reach 2, n is its visible share.
At 45° to the axes of the world, along which a network's anchors lie, an object needs exp(oblique)
times the points: a network that has seen few vehicles turn finds those less surely.

With norm 1 all points count together. With less, points from many sensors count more than as many
from one, which is the gain of spatial diversity: early fusion, where a set detects by its combined
density. The greater the norm, the more the best sensor alone decides: late fusion. Hybrid fusion
has one more sensor, which holds the far points of all.

Few points remain few, however dense they are for their distance: below `floor` points of the set a
hit becomes proportionally less likely; 0 means no such floor. A box of more than 16 m³ (V is its
volume, 16 m³ for a smaller one), a long van rather than a car, is found less surely whatever its
points.

The numbers are fitted to a detector's own hits and misses (`placement_env.fidelity.hit_fit`). This
makes the paper's analysis of density and spatial diversity predictive (its sections on sensor sets
and on diversity gain)."""

import json
import math
from collections.abc import Collection, Iterable
from dataclasses import asdict, dataclass, fields, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from placement_env.checks import check_choice
from toolkit.arrays import Float, Float32
from toolkit.detection.schemes import SCHEMES
from toolkit.frozen import set_fields
from toolkit.objects import LABELS, VEHICLE
from toolkit.runtime.text_values import read_json
from toolkit.runtime.writing import write_text

SURROGATE_FOLDER = Path(__file__).parent / "surrogates"
RANGES = {  # allowed values of the numbers of a `HitModel`, and bounds of a fit
    "iou": (0.0, 1.0),
    "intercept": (-30.0, 30.0),
    "density": (0.0, 20.0),
    "ceiling": (0.0, 1.0),
    "norm": (0.2, 6.0),
    "reach": (-1.0, 3.0),
    "oblique": (0.0, 5.0),
    "false_alarms": (0.0, 5.0),
    "floor": (0.0, 200.0),
    "bulk": (0.0, 5.0),
    "error": (0.0, 2.0),
}
NUMBERS = (  # fields of a `HitModel` that a row of `HitModel.resampled` holds, in this order
    "intercept",
    "density",
    "ceiling",
    "norm",
    "false_alarms",
    "reach",
    "oblique",
    "floor",
    "bulk",
)
BULKY_M3 = 16.0  # volume of a box (m³) above which a hit is less likely
MAX_OUTSIDE_SHARE = 0.05  # share of pairs with points that may exceed a range without a warning
RANGE_SLACK = 1.1  # factor on a range before it counts as exceeded
OPTIONAL_FIELDS = {
    "label",
    "floor",
    "bulk",
    "domain",
    "resampled",
    "error",
}  # older files lack these


@dataclass(frozen=True)
class HitDomain:
    """Range of the data that a hit model was fitted to.

    Raises ValueError for a number that is not positive or finite.

    Attributes:
        farthest: 99 % quantile of the distance from a sensor to an object that it has points on
            (m).
        most_points: 99 % quantile of a sensor's points on an object that it has points on.
        sensors: Names of the classes of sensor models.
        sites: Number of sites.
        objects: Number of objects at all sites, each counted in every frame.
        sets: Number of sensor sets at all sites."""

    farthest: float
    most_points: float
    sensors: tuple[str, ...]
    sites: int
    objects: int
    sets: int

    def __post_init__(self) -> None:
        """Raise ValueError for a number that is not above 0, and for names that are no texts."""
        for name in ("farthest", "most_points", "sites", "objects", "sets"):
            value = getattr(self, name)
            if (
                isinstance(value, bool)  # an int in Python
                or not isinstance(value, int | float)
                or not 0 < value < float("inf")
            ):
                raise ValueError(f"{name} must be a number above 0, got {value!r}")
        if isinstance(self.sensors, str) or not all(isinstance(name, str) for name in self.sensors):
            raise ValueError(f"sensors must be names of sensor models, got {self.sensors!r}")
        set_fields(self, sensors=tuple(self.sensors))

    def outside(
        self,
        points: Float32[np.ndarray, "candidates objects"],
        distance: Float32[np.ndarray, "candidates objects"],
        sensors: Iterable[str] = (),
    ) -> tuple[str, ...]:
        """Sentences on how candidates and objects exceed this range, empty if they do not.

        A range is exceeded if more than `MAX_OUTSIDE_SHARE` of the pairs with points are beyond it.

        Args:
            points: Points of each candidate on each object.
            distance: Horizontal distance of each candidate and object (m).
            sensors: Names of the classes of the candidates' sensor models."""
        sentences = []
        has_points = points > 0
        # values of each pair, their limit here, and words for values above it
        for values, limit, words in (
            (distance, self.farthest, "is beyond {:.0f} m, farther than"),
            (points, self.most_points, "has more than {:.0f} points, more than"),
        ):
            share = 0.0
            if has_points.any():
                share = float((values[has_points] > RANGE_SLACK * limit).mean())
            if share > MAX_OUTSIDE_SHARE:
                beyond = words.format(limit)
                sentences.append(
                    f"{share:.0%} of what the candidates see {beyond} what the surrogate was "
                    "fitted to"
                )
        unlike = sorted(set(sensors) - set(self.sensors))
        if unlike:
            sentences.append(
                f"the surrogate was fitted to {', '.join(self.sensors)}, not to {', '.join(unlike)}"
            )
        return tuple(sentences)


@dataclass(frozen=True)
class HitModel:
    """Numbers of this module's formula of the hit probability.

    They hold for one fusion scheme, IoU threshold and class of objects. Fields that are not listed
    are numbers of the formula.

    Attributes:
        scheme: Name of the fusion scheme.
        iou: IoU from which a detection is a hit.
        label: Name of the class of objects.
        false_alarms: Number of false alarms that outrank a hit, for each object that is less surely
            found and not hit.
        source: The fitted data in words.
        domain: The fitted data in figures, None if unknown.
        resampled: `NUMBERS` of fits to resamples of the same data, which show the uncertainty of
            the fit.
        error: Root mean square of the error of APs predicted by these fits at sites that they were
            made without, per √(AP (1 - AP)); 0 if unknown.

    Raises ValueError if a number is out of range."""

    scheme: str
    iou: float
    intercept: float
    density: float
    ceiling: float
    norm: float
    false_alarms: float
    source: str
    reach: float = 0.0
    oblique: float = 0.0
    label: str = LABELS[VEHICLE]
    floor: float = 0.0
    bulk: float = 0.0
    domain: HitDomain | None = None
    resampled: tuple[tuple[float, ...], ...] = ()
    error: float = 0.0

    def __post_init__(self) -> None:
        """Raise ValueError for a number out of its range, an unknown class and a wrong field."""
        for name, (lowest, highest) in RANGES.items():
            value = getattr(self, name)
            if (
                isinstance(value, bool)  # an int in Python
                or not isinstance(value, int | float)
                or not lowest <= value <= highest
            ):
                raise ValueError(f"{name} must lie in {lowest:g}..{highest:g}, got {value!r}")
        check_choice("label", self.label, LABELS)
        if not self.scheme or not isinstance(self.scheme, str):
            raise ValueError(f"scheme must be the name of a fusion scheme, got {self.scheme!r}")
        if any(len(row) != len(NUMBERS) for row in self.resampled):
            raise ValueError(f"a resample must have {len(NUMBERS)} numbers: {', '.join(NUMBERS)}")

    @cached_property
    def resamples(self) -> "tuple[HitModel, ...]":
        """A model for each row of `resampled`, with all other fields as here."""
        rows: list[dict[str, Any]] = [
            dict(zip(NUMBERS, row, strict=True)) for row in self.resampled
        ]
        return tuple(replace(self, resampled=(), **row) for row in rows)

    def probability(
        self, powers: Float[np.ndarray, "*shape"], raw: Float[np.ndarray, "*shape"] | None = None
    ) -> Float[np.ndarray, "*shape"]:
        """Hit probability p of objects up to `BULKY_M3`; larger ones need the factor `of_size` too.

        It is ceiling · sigmoid(intercept + density · log(1 + Σ n_i ^ norm) / norm) · min(1, r /
        floor), with r = (Σ N_i ^ norm) ^ (1 / norm). N_i are the points of sensor i on the object,
        and n_i the same weighted by distance and heading.

        Args:
            powers: Σ n_i ^ norm of the set's sensors for each object; p grows with it, from 0.
            raw: Σ N_i ^ norm of the same shape, which lowers p below the floor; None if all objects
                have enough points to meet it."""
        # one array, changed in place to spare memory: z is minus the argument of the sigmoid, then
        # its exponential, then p
        z = np.log1p(powers)
        z *= -self.density / self.norm
        z -= self.intercept
        np.exp(np.minimum(z, 80.0, out=z), out=z)  # exp(80) still fits float32
        z += 1.0
        np.divide(self.ceiling, z, out=z)
        z *= powers > 0  # 0 without any point
        if raw is not None and self.floor > 0:
            # r / floor, in which raw is r ^ norm
            z *= np.minimum(1, (raw / self.floor**self.norm) ** (1 / self.norm))
        return z

    def of_size(self, boxes: Float[np.ndarray, "objects 7"]) -> Float[np.ndarray, " objects"]:
        """Factor of each object's volume on `probability`: 1 up to `BULKY_M3`, less above.

        boxes: x, y, z, length, width, height (m), yaw (rad)."""
        if not self.bulk:
            return np.ones(len(boxes))
        sizes = boxes[:, 3:6]  # length, width, height
        volume = sizes.astype(np.float64).prod(axis=1)
        return np.asarray((np.maximum(volume, BULKY_M3) / BULKY_M3) ** -self.bulk)


def load_models(
    path: str | Path, *, schemes: Collection[str] = tuple(SCHEMES)
) -> tuple[HitModel, ...]:
    """Load the hit models in a JSON file that `save_models` wrote.

    schemes: Names of fusion schemes that the models may be for.

    Raises FileNotFoundError for a missing file, ValueError for another kind of file or another
    scheme."""
    path = Path(path)
    if not path.is_file():
        raise FileNotFoundError(f"no surrogate {path}: fit one with coview surrogate")
    rows = read_json(path)
    try:
        if not isinstance(rows, list):
            raise ValueError(f"needs a list of models, got {type(rows).__name__}")
        return tuple(_parse_model(row, schemes) for row in rows)
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from None


def save_models(models: tuple[HitModel, ...], path: str | Path) -> None:
    """Write models to a JSON file, which is replaced whole or not at all."""
    write_text(
        path, json.dumps([asdict(model) for model in models], indent=1, allow_nan=False) + "\n"
    )


def shipped_model(
    scheme: str, iou: float = 0.7, detector: str = "general", *, label: str = LABELS[VEHICLE]
) -> HitModel:
    """Hit model that comes with coview.

    Args:
        scheme: Name of the fusion scheme.
        iou: IoU threshold of a hit.
        detector: Name of a shipped detector; without models under this name the general ones are
            taken.
        label: Name of the class of objects.

    Raises ValueError, with the choices, if no model fits."""
    path = SURROGATE_FOLDER / f"{detector}.json"
    models = load_models(path if path.is_file() else SURROGATE_FOLDER / "general.json")
    return find_hit_model(models, scheme, iou, label, source=detector)


def find_hit_model(
    models: Iterable[HitModel], scheme: str, iou: float, label: str, *, source: str
) -> HitModel:
    """Find the first model for a fusion scheme, an IoU threshold and a class of objects.

    Args:
        models: Models to search.
        scheme: Name of the fusion scheme.
        iou: IoU threshold of a hit.
        label: Name of the class.
        source: Name of the models' file for the error.

    Raises ValueError, with the choices, if no model fits."""
    models = list(models)
    for model in models:
        if (model.scheme, model.label) == (scheme, label) and math.isclose(model.iou, iou):
            return model
    class_words = {name: "" if name == LABELS[VEHICLE] else f" of {name}" for name in LABELS}
    choices = ", ".join(
        f"{model.scheme} at {model.iou:g}{class_words[model.label]}" for model in models
    )
    problem = (
        f"no surrogate of {source} for {scheme} at IoU {iou:g}{class_words[label]}: choose among "
        f"{choices}"
    )
    raise ValueError(
        f"{problem}; fidelity detector or coverage takes any, and coview surrogate fits one to a "
        "detector"
    )


def _parse_model(document: object, schemes: Collection[str]) -> HitModel:
    """Model from an entry of a JSON file, whose keys are the fields of `HitModel`.

    schemes: Names of fusion schemes that it may be for. Raises ValueError for any other entry."""
    names = {field.name for field in fields(HitModel)}
    if not isinstance(document, dict) or set(document) | OPTIONAL_FIELDS != names:
        raise ValueError(f"a model needs exactly {', '.join(sorted(names))}, got {document!s:.80}")
    if document["scheme"] not in schemes or not isinstance(document["source"], str):
        raise ValueError(
            f"scheme must be one of {', '.join(schemes)} and source a text, got "
            f"{document['scheme']!r} and {document['source']!r}: for a scheme of your own, pass "
            "schemes="
        )
    try:
        rows = [tuple(map(float, row)) for row in document.get("resampled", [])]
        domain = None if document.get("domain") is None else HitDomain(**document["domain"])
    except TypeError as error:
        raise ValueError(
            f"resampled must be lists of numbers and domain a table of numbers, got {error}"
        ) from None
    # files from before `bulk` have rows without it at the end
    rows = [(*row, 0.0) if len(row) == len(NUMBERS) - 1 else row for row in rows]
    model = HitModel(**document | {"domain": domain, "resampled": tuple(rows)})
    _ = model.resamples  # raises ValueError if a number of a resample is out of range
    return model


def build_domain(
    points: list[Float[np.ndarray, "_ _"]],
    distance: list[Float[np.ndarray, "_ _"]],
    sensors: Iterable[str],
    sets: int,
) -> HitDomain:
    """Range of the data that sensors at several sites saw.

    Args:
        points: At each site the points of its candidates (rows) on its objects (columns).
        distance: At each site the horizontal distance of candidates and objects (m).
        sensors: Names of the classes of sensor models, in any order and with repetitions.
        sets: Number of sensor sets at all sites.

    Raises ValueError if no sensor has a point on an object."""
    # points and distance of every candidate and object with a point
    point_counts = np.concatenate([site_points[site_points > 0].ravel() for site_points in points])
    distances = np.concatenate(
        [
            site_distance[site_points > 0].ravel()
            for site_points, site_distance in zip(points, distance, strict=True)
        ]
    )
    if not len(point_counts):
        raise ValueError(
            "no sensor has a point on any object, so there is nothing to fit: take more frames "
            "or poses"
        )
    # a hundredth may be beyond the range
    most_points = float(np.quantile(point_counts, 0.99))
    farthest = float(np.quantile(distances, 0.99))
    objects = sum(site_points.shape[1] for site_points in points)
    return HitDomain(
        farthest=round(farthest, 1),
        most_points=round(most_points, 1),
        sensors=tuple(sorted(set(sensors))),
        sites=len(points),
        objects=objects,
        sets=sets,
    )
