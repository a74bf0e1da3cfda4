"""`coview search`: which sensors to build."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Literal

from tyro.conf import Positional

from coview.arguments import (
    Combine,
    Label,
    check_errors,
    check_ious,
    check_least,
    check_positive,
    check_ray,
    check_schemes,
    check_share,
    counted_classes,
    site_file,
)
from coview.detectors import check_digest, site_detector
from coview.exits import NOT_MET, OK
from coview.outputs import check_folder, check_writable
from coview.printing import print_result
from coview.progress_bar import progress_bar

Method = Literal[
    "portfolio", "exhaustive", "greedy", "lazy", "stochastic", "raced", "swap", "annealing", "cpsat", "nsga2", "cmaes",
    "ppo",
]  # fmt: skip


def search(
    site: Positional[str],
    /,
    *,
    method: Method | None = None,
    budget: int = 4,
    scheme: str = "early",
    fidelity: Literal["coverage", "surrogate", "detector", "table"] = "surrogate",
    verify: Literal["detector"] | None = None,
    judge: Literal["detector", "surrogate", "coverage"] | None = None,
    confidence: float = 0.95,
    candidates: str = "pool",
    model: tuple[str, ...] = (),
    detector: str | None = None,
    errors: str = "paper",
    frames: int = 200,
    iou: float = 0.7,
    classes: tuple[Label, ...] = ("vehicle",),
    class_weights: tuple[float, ...] | None = None,
    combine: Combine = "mean",
    small_iou: float = 0.5,
    surrogate: Path | None = None,
    table: Path | None = None,
    comm: float = 0.0,
    price: float = 0.0,
    seed: int = 0,
    seconds: float | None = None,
    evaluations: int | None = None,
    cache: Path | None = Path("out/cache"),
    workers: int = 1,
    ray: str | None = None,
    out: Path | None = None,
    overwrite: bool = False,
    json: bool = False,
) -> int:
    """Search the sensors to build: which poles, headings and tilts, at most a budget of them, one per pole.

    Example: coview search tjunction --budget 4 --scheme early --confidence 0.9 --out answer

    Args:
        site: tjunction, roundabout, or a site file.
        method: How to search. portfolio runs several searches, lets their answers race on fresh traffic and judges
            the winner on other fresh traffic; cpsat proves how much more could be covered, exhaustive needs 16
            candidates or fewer, raced drops weak candidates after few frames and needs fidelity detector, cmaes turns
            and lifts the sensors that greedy found, ppo learns a policy first. Left out: portfolio; exhaustive for
            fidelity table, greedy with --verify or fidelity detector.
        budget: Most sensors.
        scheme: How their measurements are fused: early, late or hybrid.
        fidelity: How a set is scored while searching; table knows the built-in sites' own sensors only.
        verify: Score what one method found, and its best neighbours, with the detector, in the same traffic.
        judge: Of a portfolio's race and answer; the detector when left out, the surrogate or coverage where there is
            none that knows these road users or sensors.
        confidence: At which the race ends: that no entrant is better by more than 0.01.
        candidates: pool, paper for the site's own sensors, or a GeoJSON file of poles.
        model: Sensor models, by name, that may be mounted at each pose; the paper's camera when left out.
        detector: That scores, verifies or judges: as in coview evaluate, but for cluster; a shipped network when left
            out.
        errors: Of the sensors, as in coview evaluate, where the detector scores, verifies or judges.
        frames: Of simulated traffic that is searched; portfolio has up to 96 more to race on and 120 to judge by.
        iou: At which a detection counts.
        classes: Road users that count.
        class_weights: Of each class in their mean; equal when left out.
        combine: AP of several classes: their mean, or that of the worst, so that none is bought at another's expense.
        small_iou: In place of --iou for cyclists and pedestrians.
        surrogate: File of coview surrogate, for fidelity surrogate in place of the shipped ones.
        table: File of coview table, for fidelity table in place of the shipped ones.
        comm: AP that a kbit per sensor and frame costs.
        price: AP that one ordinary mount costs.
        seed: Of traffic and search.
        seconds: Stop after so many.
        evaluations: Stop after so many sets.
        cache: Folder where what was rendered and detected is kept for the next search, None for nowhere.
        workers: Processes that render and detect.
        ray: Address of a Ray cluster that does it instead; local for this machine.
        out: Folder for what is handed over: the site with the sensors (coview simulate takes it), mounting schedule
            (CSV), map for GIS tools (GeoJSON), picture, and search.json, where it comes from.
        overwrite: Replace these files.
        json: Print as JSON.
    """
    from placement_env.candidates.choice import chosen_candidates
    from placement_env.objective import Weights
    from placement_env.report.search_answer import ANSWER_FILES, check_georeference
    from placement_env.report.searching import SearchOrder, answered
    from placement_env.search.methods import usual_method
    from toolkit.sites.files import load_site

    for option, value in (("--budget", budget), ("--frames", frames), ("--workers", workers)):
        check_least(option, value, 1)
    for option, limit in (("--seconds", seconds), ("--evaluations", evaluations)):
        check_positive(option, limit)
    for option, weight in (("--comm", comm), ("--price", price), ("--seed", seed)):
        check_least(option, weight, 0)
    check_share("--confidence", confidence)
    check_ious([iou])
    check_schemes([scheme])
    check_errors(errors)
    chosen: str = usual_method(fidelity, verify=verify is not None) if method is None else method
    if verify is not None and chosen == "portfolio":
        raise ValueError("--verify is for one method: portfolio is judged by --judge on fresh traffic anyway")
    judged_by = judge or "detector"
    detects = "detector" in (fidelity, verify) or (chosen == "portfolio" and judged_by == "detector")
    if judge is not None and chosen != "portfolio":
        raise ValueError(f"--judge is for --method portfolio, got {chosen}: leave it out, or say --verify detector")
    for option, given in (("--errors", errors != "paper"), ("--detector", detector is not None)):
        if given and not detects:
            raise ValueError(f"{option} is for --fidelity, --verify or --judge detector: say one of them")
    check_ray(ray)
    counted = counted_classes(classes, class_weights, combine, small_iou)
    if cache is not None:
        check_writable(cache.resolve(), cache)
    place = load_site(site)
    if out is not None:
        check_georeference(place)
        read = [*site_file(site), *([] if candidates in ("pool", "paper") else [Path(candidates)])]
        for name in ANSWER_FILES:
            check_folder(out, holds=name, inputs=read, overwrite=overwrite)
    if fidelity == "table" and candidates != "paper":
        raise ValueError("--fidelity table knows the built-in sites' own sensors only: say --candidates paper")
    if candidates == "paper" and not place.sensors:
        raise ValueError(f"site {place.name!r} has no sensors of its own: say --candidates pool")
    if candidates == "paper" and model:
        raise ValueError("--model is for --candidates pool or a file of poles: the site's own sensors have theirs")
    own = None if detector is None else site_detector(detector, place)
    if own is not None and detector is not None and cache is not None:
        check_digest(detector, own, ": add one, or say --cache None")
    order = SearchOrder(
        site=place,
        candidates=chosen_candidates(place, candidates, _models(model)),
        method=chosen,
        budget=budget,
        scheme=scheme,
        fidelity=fidelity,
        verify=verify,
        judge=judged_by,
        confidence=confidence,
        weights=Weights(comm, price),
        frames=frames,
        errors=errors,
        detector=own,
        surrogate=surrogate,
        table=table,
        limits={"seconds": seconds, "evaluations": evaluations},
        settings={"iou": iou, "seed": seed, "cache": cache, "workers": workers, "ray": ray, "classes": counted},
    )
    with progress_bar("", hidden=json) as bar:
        found = answered(order, out=out, progress=bar.stage)
    print_result(found.summary, "\n".join(found.lines), as_json=json)
    return OK if found.met else NOT_MET


def _models(names: tuple[str, ...]) -> list[Any]:
    """Sensor models by name."""
    if not names:
        return []
    from toolkit.sensors.catalogue import model_named

    return [model_named(name) for name in names]
