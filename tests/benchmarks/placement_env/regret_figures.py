"""What the rows of `bench_regret.py` say: regret, errors of prediction, winner's curse, rank
correlations.

Intervals are 95 % percentiles: over sites drawn with replacement for regret and error, over sites
and, within each, the resamples of blocks of frames for correlations. Regret is against the best
judged of all answers and other sets, so it is too large by what the best of many noisy figures is
too large; `unbiased` is regret less that, by the bootstrap. `predicted` is the AP by the surrogate,
`expected` and `after` what surrogate and race together make likeliest.
"""

from collections.abc import Callable, Iterable, Sequence
from typing import Any

import numpy as np
from bench_surrogate import spearman

Row = dict[str, Any]
FAST = ("surrogate@0.7", "coverage", "perception entropy", "information gain", "point count")
# groups of sets, number of the IoU
WAYS = ((("site",), 0), (("site", "k"), 0), (("site",), 2), (("site", "k"), 2))
BOOTSTRAPS = 1000
LEAST = 4  # sets that a correlation needs


def figures(rows: Sequence[Row]) -> list[str]:
    lines: list[str] = []
    for scheme in ("early", "late"):
        of_scheme = [row for row in rows if row["scheme"] == scheme]
        if any(row["kind"] == "portfolio" for row in of_scheme):
            lines += [f"{scheme} fusion", *_portfolios(of_scheme), "", *_curses(of_scheme), ""]
        sets = [row for row in of_scheme if row["kind"] == "set"]
        if sets:
            lines += [*_correlations(sets, scheme), ""]
    return lines


def _portfolios(rows: Sequence[Row]) -> list[str]:
    head = (
        f"{'site':15s} k  {'AP':>6s} {'best':>6s} {'regret':>7s} {'unbiased':>8s} {'error':>7s} "
        f"{'after':>7s} {'sure':>5s} {'raced':>5s} {'s':>5s}  best by"
    )
    lines, found = [head], []
    for row in sorted(
        (row for row in rows if row["kind"] == "portfolio"), key=lambda r: (r["site"], r["k"])
    ):
        judged = _judged(rows, row["site"], row["k"])
        own = judged.get(tuple(row["subset"]))
        if own is None:
            continue
        best = max(judged, key=lambda subset: judged[subset]["ap"][0])
        regret, less = judged[best]["ap"][0] - own["ap"][0], _unbiased(judged, tuple(row["subset"]))
        error = row["predicted"] - own["ap"][0]
        after = row.get("expected", np.nan) - own["ap"][0]
        names = [
            each["method"]
            for each in rows
            if each["kind"] == "search" and (each["site"], each["k"]) == (row["site"], row["k"])
            if tuple(each["subset"]) == best
        ]
        by = (
            "portfolio"
            if best == tuple(row["subset"])
            else ", ".join(names) or "none of the searches"
        )
        lines.append(
            f"{row['site']:15s} {row['k']}  {own['ap'][0]:6.3f} {judged[best]['ap'][0]:6.3f} "
            f"{regret:7.3f} {less:8.3f} {error:7.3f} {after:7.3f} {row['confidence']:5.2f} "
            f"{row['raced']:5d} {row['seconds']:5.0f}  {by}"
        )
        found.append((row["site"], regret, less, abs(error), abs(after)))
    sites = [site for site, *_ in found]
    for place, name in enumerate(
        ("regret", "unbiased", "|predicted - judged|", "|expected - judged|"), 1
    ):
        values = np.array([each[place] for each in found], np.float64)
        low, high = _over_sites(values, sites)
        lines.append(
            f"{name}: mean {values.mean():.4f} ({low:.4f} … {high:.4f}), worst {values.max():.4f}, "
            f"{len(values)} answers at {len(set(sites))} sites"
        )
    return lines


def _judged(rows: Sequence[Row], site: str, k: int) -> dict[tuple[int, ...], Row]:
    there = (row for row in rows if row["kind"] == "set" and row["site"] == site)
    return {tuple(row["subset"]): row for row in there if len(row["subset"]) <= k}


def _unbiased(judged: dict[tuple[int, ...], Row], own: tuple[int, ...]) -> float:
    """Twice the regret, less its mean over the resamples (Efron and Tibshirani 1993, chapter
    10)."""
    mine = list(judged).index(own)
    figure = np.array([row["ap"][0] for row in judged.values()])
    draws = np.array([row["draws"][0] for row in judged.values()])
    return float(2 * (figure.max() - figure[mine]) - (draws.max(axis=0) - draws[mine]).mean())


def _curses(rows: Sequence[Row]) -> list[str]:
    """Of each search: predicted minus judged, how far from the best, and its time."""
    lines = [
        (
            f"{'search':18s} {'curse':>7s} {'worst':>7s} {'regret':>7s} {'worst':>7s} {'s':>6s}  "
            "answers"
        )
    ]
    kinds = [row for row in rows if row["kind"] in ("search", "portfolio")]
    for method in dict.fromkeys(row.get("method", "portfolio") for row in kinds):
        curse, regret, seconds = [], [], []
        for row in (row for row in kinds if row.get("method", "portfolio") == method):
            judged = _judged(rows, row["site"], row["k"])
            own = judged.get(tuple(row["subset"]))
            if own is not None:
                curse.append(row["predicted"] - own["ap"][0])
                regret.append(max(each["ap"][0] for each in judged.values()) - own["ap"][0])
                seconds.append(row["seconds"])
        if curse:
            lines.append(
                f"{method:18s} {np.mean(curse):7.3f} {np.max(curse):7.3f} {np.mean(regret):7.3f} "
                f"{np.max(regret):7.3f} {np.mean(seconds):6.1f}  {len(curse)}"
            )
    return lines


def _correlations(rows: Sequence[Row], scheme: str) -> list[str]:
    """Of each fast score: rank correlation over the sets of a site and over those of one size, mean
    over sites."""
    lines = [
        f"{scheme} fusion, {len(rows)} sets at {len({row['site'] for row in rows})} sites",
        f"{'score':22s} {'at 0.7, of a site':>24s} {'of one size':>24s} {'at 0.9, of a site':>24s} "
        f"{'of one size':>24s} {'|error|':>8s}",
    ]
    scored: list[tuple[float, str]] = []
    names: list[tuple[str, Callable[[Row], float]]] = [
        ("surrogate, searched", lambda row: row["predicted"]),
        *((name, lambda row, name=name: row["same"][name]) for name in FAST),
        ("surrogate@0.9", lambda row: row["same"]["surrogate@0.9"]),
    ]
    for name, score in names:
        found = [_within(rows, score, by, at) for by, at in WAYS]
        at = 2 if name.endswith("0.9") else 0
        error = np.mean([abs(score(row) - row["ap"][at]) for row in rows])
        said = "" if name in FAST[2:] else f"{error:8.3f}"
        scored.append((found[0][0], f"{name:22s} {' '.join(map(_written, found))} {said}"))
    return [*lines, *(line for _, line in sorted(scored, reverse=True))]


def _within(
    rows: Sequence[Row], score: Callable[[Row], float], by: tuple[str, ...], at: int
) -> tuple[float, float, float]:
    """Mean over groups of sets of the rank correlation with the detector, and its interval."""
    chosen = _grouped(rows, by)
    if not chosen:
        return (np.nan, np.nan, np.nan)
    whole, drawn = {}, {}
    for key, group in chosen.items():
        fast = np.array([score(row) for row in group])
        whole[key] = float(spearman(fast, np.array([row["ap"][at] for row in group])))
        draws = np.array([row["draws"][at // 2] for row in group]).T
        drawn[key] = spearman(np.broadcast_to(fast, draws.shape), draws)
    keys, rng, means = list(chosen), np.random.default_rng(0), []
    for _ in range(BOOTSTRAPS):
        some = rng.integers(len(keys), size=len(keys))
        means.append(np.mean([drawn[keys[i]][rng.integers(len(drawn[keys[i]]))] for i in some]))
    low, high = np.quantile(means, [0.025, 0.975])
    return float(np.mean(list(whole.values()))), float(low), float(high)


def _grouped(rows: Sequence[Row], by: tuple[str, ...]) -> dict[tuple[Any, ...], list[Row]]:
    groups: dict[tuple[Any, ...], list[Row]] = {}
    for row in rows:
        if "k" not in by or len(row["subset"]) == row["k"]:
            groups.setdefault(tuple(row[name] for name in by), []).append(row)
    return {key: group for key, group in groups.items() if len(group) >= LEAST}


def _over_sites(values: np.ndarray, sites: Sequence[str]) -> tuple[float, float]:
    different, rng = sorted(set(sites)), np.random.default_rng(0)
    of_site = {name: values[[site == name for site in sites]] for name in different}
    means = [
        np.concatenate(
            [of_site[different[i]] for i in rng.integers(len(different), size=len(different))]
        ).mean()
        for _ in range(BOOTSTRAPS)
    ]
    low, high = np.quantile(means, [0.025, 0.975])
    return float(low), float(high)


def _written(found: Iterable[float]) -> str:
    value, low, high = found
    return f"{value:8.3f} ({low:.3f} … {high:.3f})".rjust(24)
