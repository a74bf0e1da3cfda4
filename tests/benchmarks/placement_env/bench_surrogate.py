"""Leaderboard of surrogates: Spearman correlation with a detector's AP over many sensor sets, and
their speed.

    python tests/benchmarks/placement_env/bench_surrogate.py TABLE RECORDING [--scheme early] [--iou
        0.7] [--model MODELS.json]

TABLE: a .npz of `placement_env.fidelity.table` or a built-in site's name; RECORDING: the HDF5 file
it was measured in. Intervals are 95 % of 2000 bootstraps over sets; ms per evaluation is one
process's, sets a thousand at a time.
"""

import argparse
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING

import numpy as np

sys.path[:0] = [str(Path(__file__).parents[3]), str(Path(__file__).parent)]

if TYPE_CHECKING:
    from placement_env.fidelity.hit_model import HitModel
    from placement_env.fidelity.visibility import Visibility

BOOTSTRAPS = 2000


def spearman(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Spearman correlation along the last axis; 0 where one of them is constant."""
    from scipy.stats import rankdata

    a, b = (rankdata(each, axis=-1) for each in (a, b))
    a, b = (each - each.mean(axis=-1, keepdims=True) for each in (a, b))
    scale = np.sqrt((a**2).sum(axis=-1) * (b**2).sum(axis=-1))
    return np.where(scale > 0, (a * b).sum(axis=-1) / np.maximum(scale, 1e-12), 0.0)


def interval(score: np.ndarray, ap: np.ndarray, seed: int = 0) -> tuple[float, float, float]:
    """Spearman correlation of a surrogate's score with AP, and its 95 % bootstrap interval over the
    sets."""
    drawn = np.random.default_rng(seed).integers(len(ap), size=(BOOTSTRAPS, len(ap)))
    low, high = np.quantile(spearman(score[drawn], ap[drawn]), [0.025, 0.975])
    return float(spearman(score, ap)), float(low), float(high)


def ms_each(fidelity: Callable[[np.ndarray], object], sets: np.ndarray) -> float:
    """Milliseconds per set, the best of three rounds of a thousand or more."""
    many = np.tile(sets, (-(-1000 // len(sets)), 1))
    best = np.inf
    for _ in range(3):
        start = perf_counter()
        fidelity(many)
        best = min(best, perf_counter() - start)
    return best / len(many) * 1e3


def leaderboard(
    visibility: "Visibility",
    scheme: str,
    iou: float,
    sets: np.ndarray,
    ap: np.ndarray,
    model: "HitModel | None" = None,
) -> None:
    from information_gain import InformationGain

    from placement_env.fidelity.coverage import Coverage
    from placement_env.fidelity.perception_entropy import PerceptionEntropy
    from placement_env.fidelity.surrogate import Surrogate

    entries: dict[str, Callable[[np.ndarray], Sequence[np.ndarray]]] = {
        "surrogate (ours)": Surrogate(visibility, scheme, model, iou=iou),
        "coverage, 20 points": Coverage(visibility, scheme),
        "coverage, 20 points twice": Coverage(visibility, scheme, views=2),
        "point count": lambda subsets: (subsets @ np.log1p(visibility.points).sum(axis=1),),
        "perception entropy (Ma 2021)": PerceptionEntropy(visibility, scheme),
        "information gain, turned (Hu)": InformationGain(visibility, scheme),
        "number of sensors": lambda subsets: (subsets.sum(axis=1).astype(float),),
    }
    print(
        f"{len(sets)} sets, {visibility.points.shape[1]} objects in {visibility.frames} frames, "
        f"{scheme}, IoU {iou:g}"
    )
    print(f"{'':30s} {'Spearman':>8s}  {'95 % interval':>16s} {'|AP error|':>10s} {'ms each':>8s}")
    lines = []
    for name, fidelity in entries.items():
        score = fidelity(sets)[0]
        rho, low, high = interval(score, ap)
        error = f"{np.abs(score - ap).mean():10.4f}" if score.max() <= 1 else f"{'':10s}"
        lines.append(
            (
                rho,
                (
                    f"{name:30s} {rho:8.3f}  {low:7.3f} … {high:6.3f} {error} "
                    f"{ms_each(fidelity, sets):8.4f}"
                ),
            )
        )
    for _, line in sorted(lines, reverse=True):
        print(line)


def of_table(asked: argparse.Namespace) -> tuple:
    """Visibility, sets and AP of a table and its recording."""
    from placement_env.fidelity.table import TableFidelity, load_table
    from placement_env.fidelity.visibility import Visibility
    from toolkit.datasets.dataset import CoopDataset

    table = load_table(asked.table)
    sets = table.subsets[1:]
    with CoopDataset(asked.recording) as recording:
        visibility = Visibility.from_recording(recording, table.origin.frames)
    return visibility, sets, TableFidelity(table, asked.scheme, asked.iou)(sets).ap


def main() -> None:
    arguments = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    arguments.add_argument("table")
    arguments.add_argument("recording")
    arguments.add_argument("--scheme", choices=("early", "late", "hybrid"), default="early")
    arguments.add_argument("--iou", type=float, default=0.7)
    arguments.add_argument("--model", type=Path)
    asked = arguments.parse_args()

    from placement_env.fidelity.hit_model import load_models

    visibility, sets, ap = of_table(asked)
    models = load_models(asked.model) if asked.model else ()
    wanted = [model for model in models if (model.scheme, model.iou) == (asked.scheme, asked.iou)]
    leaderboard(visibility, asked.scheme, asked.iou, sets, ap, wanted[0] if wanted else None)


if __name__ == "__main__":
    main()
