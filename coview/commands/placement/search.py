"""`coview search`: which sensors to build."""

from __future__ import annotations

from dataclasses import asdict
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
    counted_classes,
    site_file,
)
from coview.detectors import check_digest, site_detector
from coview.exits import NOT_MET, OK
from coview.outputs import check_folder, check_writable
from coview.printing import print_result
from coview.progress_bar import progress_bar

Method = Literal[
    "exhaustive", "greedy", "lazy", "stochastic", "raced", "swap", "annealing", "cpsat", "nsga2", "cmaes", "ppo"
]  # fmt: skip


def search(
    site: Positional[str],
    /,
    *,
    method: Method = "greedy",
    budget: int = 4,
    scheme: str = "early",
    fidelity: Literal["coverage", "surrogate", "detector", "table"] = "surrogate",
    verify: Literal["detector"] | None = None,
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

    Example: coview search tjunction --method greedy --budget 4 --scheme early --fidelity surrogate --verify detector

    Args:
        site: tjunction, roundabout, or a site file.
        method: How to search; cpsat proves how much more could be covered, exhaustive needs 16 candidates or fewer,
            raced drops weak candidates after few frames and needs fidelity detector, cmaes turns and lifts the sensors
            that greedy found, ppo learns a policy first.
        budget: Most sensors.
        scheme: How their measurements are fused: early, late or hybrid.
        fidelity: How a set is scored while searching; table knows the built-in sites' own sensors only.
        verify: Score what was found, and its best neighbours, with the detector.
        candidates: pool, paper for the site's own sensors, or a GeoJSON file of poles.
        model: Sensor models, by name, that may be mounted at each pose; the paper's camera when left out.
        detector: Of fidelity and --verify detector: as in coview evaluate, but for cluster; a shipped network when
            left out.
        errors: Of the sensors, as in coview evaluate, for --fidelity detector or --verify detector.
        frames: Of simulated traffic.
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
    from placement_env.fidelity.preparation import check_fidelity_for
    from placement_env.objective import Objective, Weights
    from placement_env.report.planning.refusals import check_present, exclusions
    from placement_env.report.search_answer import ANSWER_FILES, check_georeference, write_answer
    from placement_env.search.description import described_empty, described_score, described_sensors
    from placement_env.search.methods import check_search, search_of
    from placement_env.search.verification import verified_best
    from toolkit.runtime.json_files import finite
    from toolkit.sites.files import load_site

    for option, value in (("--budget", budget), ("--frames", frames), ("--workers", workers)):
        check_least(option, value, 1)
    for option, limit in (("--seconds", seconds), ("--evaluations", evaluations)):
        check_positive(option, limit)
    for option, weight in (("--comm", comm), ("--price", price), ("--seed", seed)):
        check_least(option, weight, 0)
    check_ious([iou])
    check_schemes([scheme])
    check_errors(errors)
    if errors != "paper" and "detector" not in (fidelity, verify):
        raise ValueError("--errors is for --fidelity detector or --verify detector: say one of them")
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
    pool = chosen_candidates(place, candidates, _models(model))
    check_search(method, fidelity, pool)
    settings: dict[str, Any] = {"candidates": pool, "iou": iou, "seed": seed, "cache": cache, "workers": workers,
                                "ray": ray, "classes": counted}  # fmt: skip
    if detector is not None:
        if "detector" not in (fidelity, verify):
            raise ValueError("--detector is for --fidelity detector or --verify detector: say one of them")
        settings["detector"] = site_detector(detector, place)
        if cache is not None:
            check_digest(detector, settings["detector"], ": add one, or say --cache None")
    files: dict[str, Any] = {"surrogate": surrogate, "table": table}
    asked: dict[str, Any] = {"iou": iou, "classes": counted, "detector": settings.get("detector")}
    check_fidelity_for(place, pool, scheme, fidelity, **asked, **files)
    check_fidelity_for(place, pool, scheme, verify or "coverage", **asked)
    with progress_bar("", hidden=json) as bar:
        settings["progress"] = bar.stage
        drawn = errors if fidelity == "detector" else "paper"
        objective = Objective(place, frames, scheme, fidelity, Weights(comm, price), errors=drawn, **settings, **files)
        check_present(objective)
        if not objective.allowed([]).any():
            reasons = exclusions(objective)
            print_result({"sensors": [], "reasons": reasons}, f"none may be built: {' '.join(reasons)}", as_json=json)
            return NOT_MET
        result = search_of(method)(objective, budget, seed=seed, seconds=seconds, evaluations=evaluations)
        best, names, certificate = result.best, objective.names, result.certificate
        if verify is not None and best.subset:
            exact = Objective(place, frames, scheme, verify, Weights(comm, price), errors=errors, **settings)
            checked, sets = verified_best(objective, exact, result)
    sensors = described_sensors([names[c] for c in best.subset], result.sensors)
    summary = {**asdict(best), "sensors": sensors, "certificate": asdict(certificate),
               "evaluations": result.evaluations, "seconds": result.seconds,
               "provenance": objective.provenance}  # fmt: skip
    lines = [str(result), certificate.note, *(f"  {name}" for name in sensors), described_score(best)]
    lines += [f"front: {described_score(score)} {score.subset}" for score in result.front]
    if verify is not None and best.subset:
        there = [names[c] for c in checked.subset]
        summary["verified"] = {**asdict(checked), "sensors": there, "provenance": exact.provenance}
        lines += [f"by the {verify}, {'moved' if result.sensors else f'best of {sets} sets'}:"]
        lines += [*(f"  {name}" for name in there), described_score(checked)]
    if not best.subset:
        print_result(summary, f"no sensors: {described_empty(objective)}", as_json=json)
        return NOT_MET
    if out is not None:
        handed_over = best.subset if verify is None else checked.subset
        write_answer(out, objective, result, finite(summary), chosen=handed_over)
        lines.append(f"written to {out}: {', '.join(ANSWER_FILES)}")
    print_result(summary, "\n".join(line for line in lines if line), as_json=json)
    return OK


def _models(names: tuple[str, ...]) -> list[Any]:
    """Sensor models by name."""
    if not names:
        return []
    from toolkit.sensors.catalogue import model_named

    return [model_named(name) for name in names]
