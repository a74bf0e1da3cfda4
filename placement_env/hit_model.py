"""`HitModel`: how likely a detector finds an object with given points on it, in a few numbers kept as JSON.

Of an object with N_i points from sensor i of a set, a hit has the probability

    p = ceiling · sigmoid(intercept + density · e),    e = log(1 + Σ N_i ^ norm) / norm,    0 without any point

With norm 1 all points count together: early fusion, where a set detects by the density that it gathers. The greater the
norm, the more the best sensor alone decides: late fusion. Hybrid fusion has one sensor more, which holds the far points
of all. The numbers are fitted to a detector's own hits and misses, which is the paper's analysis of density and spatial
diversity (sections IV-C and IV-D) made predictive.
"""

from __future__ import annotations

import json
import math
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any, get_args

import numpy as np

from toolkit.arrays import Float32
from toolkit.evaluation import Scheme

FOLDER = Path(__file__).parent / "surrogates"
LARGEST_NORM = 8.0  # up to which 10,000 points to its power fit float32


@dataclass(frozen=True)
class HitModel:
    """The numbers above, for one scheme and IoU threshold. false_alarms: how many false alarms outrank a hit, for each
    object found less surely and not hit; source: what they were fitted to. Raises ValueError where one is out of range.
    """

    scheme: Scheme
    iou: float
    intercept: float
    density: float
    ceiling: float
    norm: float
    false_alarms: float
    source: str

    def __post_init__(self) -> None:
        ranges = {
            "iou": (0.0, 1.0),
            "intercept": (-50.0, 50.0),
            "density": (0.0, 50.0),
            "ceiling": (0.0, 1.0),
            "norm": (1.0, LARGEST_NORM),
            "false_alarms": (0.0, 50.0),
        }
        for name, (lowest, highest) in ranges.items():
            value = getattr(self, name)
            if isinstance(value, bool) or not isinstance(value, int | float) or not lowest <= value <= highest:
                raise ValueError(f"{name} must be a number in {lowest:g}..{highest:g}, got {value!r}")
        if self.scheme not in get_args(Scheme):
            raise ValueError(f"scheme must be one of {', '.join(get_args(Scheme))}, got {self.scheme!r}")
        if not isinstance(self.source, str):
            raise ValueError(f"source must be a text, got {self.source!r}")

    def evidence(self, powers: Float32[np.ndarray, "*shape"]) -> Float32[np.ndarray, "*shape"]:
        """e, from Σ N_i ^ norm."""
        return np.log1p(powers) / np.float32(self.norm)

    def probability(self, powers: Float32[np.ndarray, "*shape"]) -> Float32[np.ndarray, "*shape"]:
        """p, from Σ N_i ^ norm."""
        z = self.evidence(powers)
        z *= np.float32(-self.density)
        z -= np.float32(self.intercept)
        np.exp(np.minimum(z, 80, out=z), out=z)
        z += 1
        np.divide(np.float32(self.ceiling), z, out=z)
        z *= powers > 0
        return z


def load_models(path: str | Path) -> tuple[HitModel, ...]:
    """The models of a file. Raises FileNotFoundError; ValueError, in one line, where it is no file of models."""
    path = Path(path)
    if not path.is_file():
        raise FileNotFoundError(f"no surrogate {path}: fit one with placement_env.hit_fit.fit and save_models")
    try:
        rows = json.loads(path.read_text(encoding="utf-8"))
        if not isinstance(rows, list):
            raise ValueError(f"needs a list of models, got {type(rows).__name__}")
        return tuple(_model(row) for row in rows)
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from None


def save_models(models: tuple[HitModel, ...], path: str | Path) -> None:
    """Write models as JSON; the file appears whole or not at all."""
    path = Path(path)
    partial = path.with_name(path.name + ".partial")
    partial.write_text(
        json.dumps([asdict(model) for model in models], indent=1, allow_nan=False) + "\n", encoding="utf-8"
    )
    partial.replace(path)


def shipped_model(scheme: Scheme, iou: float = 0.7, detector: str = "tjunction") -> HitModel:
    """The model that comes with coview. Raises ValueError that lists what there is where there is none."""
    models = load_models(FOLDER / f"{detector}.json")
    for model in models:
        if model.scheme == scheme and math.isclose(model.iou, iou):
            return model
    there = ", ".join(f"{model.scheme} at {model.iou:g}" for model in models)
    raise ValueError(f"no surrogate of {detector} for {scheme} at IoU {iou:g}: choose among {there}")


def _model(row: Any) -> HitModel:
    names = {field.name for field in fields(HitModel)}
    if not isinstance(row, dict) or set(row) != names:
        raise ValueError(f"a model needs exactly {', '.join(sorted(names))}, got {row!s:.80}")
    return HitModel(**row)
