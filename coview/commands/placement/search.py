"""`coview search`: which sensors to build."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Literal

from tyro.conf import Positional

from coview.arguments import (
    Combine,
    Label,
    check_least,
    check_positive,
    check_ray,
    check_schemes,
    check_share,
    counted_classes,
    sensor_errors,
    site_file,
)
from coview.detectors import check_digest, site_detector
from coview.exits import NOT_MET, OK
from coview.outputs import check_folder, check_writable
from coview.pools import asked_pool
from coview.printing import print_result
from coview.progress_bar import progress_bar

Method = Literal["portfolio", "exhaustive", "greedy", "raced", "swap", "cpsat", "hits", "cheapest", "cmaes", "ppo"]


def search(
    site: Positional[str],
    /,
    *,
    method: Method | None = None,
    budget: int = 4,
    scheme: str = "early",
    codec: str = "paper",
    fidelity: Literal["coverage", "surrogate", "detector", "table"] = "surrogate",
    verify: Literal["detector"] | None = None,
    judge: Literal["detector", "surrogate", "coverage"] | None = None,
    confidence: float = 0.95,
    candidates: str = "pool",
    model: tuple[str, ...] = (),
    sensors: Path | None = None,
    money: float | None = None,
    curve: bool = False,
    at_least: float | None = None,
    failing: Literal[0, 1, 2] = 0,
    failures: Literal["worst", "mean"] = "worst",
    parts: int = 1,
    levels: Literal[1, 2, 3, 4] = 1,
    levels_by: Literal["worst", "mean"] = "worst",
    detector: str | None = None,
    errors: tuple[str, ...] = ("paper",),
    errors_by: Literal["worst", "mean"] = "worst",
    frames: int = 200,
    iou: str = "0.7",
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
    """Search the sensors to build: which poles, headings and tilts, at most a budget of them.

    Example: coview search tjunction --budget 4 --scheme early --confidence 0.9 --out answer

    Args:
        site: tjunction, roundabout, or a site file.
        method: How to search. portfolio runs several searches, lets their answers race on fresh traffic and judges
            the winner on other; cpsat proves how much more could be covered, hits how much more be hit, exhaustive
            needs 16 candidates or fewer, raced needs fidelity detector, cmaes turns and lifts what greedy found,
            ppo learns a policy first. Left out: portfolio; exhaustive for fidelity table, greedy with --verify.
        budget: Most sensors.
        scheme: How their measurements are fused: early, late, hybrid or foreground.
        codec: Of what is sent: paper counts 96 bits a point and 256 a box, range-images sends bytes in steps of 2 cm.
        fidelity: How a set is scored while searching; table knows the built-in sites' own sensors only.
        verify: Score what one method found, and its best neighbours, with the detector.
        judge: Of a portfolio's race and answer: the detector when left out, another where none knows these classes.
        confidence: At which the race ends: that no entrant is better by more than 0.01.
        candidates: pool, paper for the site's own sensors, or a GeoJSON file of poles.
        model: Sensor models, by name, that may be mounted; the paper's camera when left out.
        sensors: Catalogue of sensor models and their prices instead, TOML, as for coview plan.
        money: Most that a set may cost, in the catalogue's currency, or in ordinary poles.
        curve: Print the best AP of every number of sensors up to the budget, or for every amount of --money up to that.
        at_least: AP, or share covered, to be reached: the answer is the cheapest set that does, and a proven bound.
        failing: Sensors that fail (0 to 2): what is left of a set counts; with --at-least up to 1, whichever it is.
        failures: What is left in the worst case, or in the mean over which fail.
        levels: Of traffic, by how many road users are there: AP of each by itself, raced too; at each with --at-least.
        levels_by: The level of least AP counts, or the mean of their AP.
        parts: With --at-least: in each of so many consecutive parts of the traffic.
        detector: That scores, verifies or judges, as in coview evaluate, but for cluster; left out a shipped one.
        errors: Of the sensors, as in coview evaluate, one profile or several, where the detector scores or judges.
        errors_by: Of several profiles: the one of least AP counts, or the mean of their AP.
        frames: Of simulated traffic that is searched; portfolio has up to 96 more to race on and 120 to judge by.
        iou: At which a detection counts; 0.5:0.95 for the mean AP over 0.5, 0.55 to 0.95, as in COCO.
        classes: Road users that count.
        class_weights: Of each class in their mean; equal when left out.
        combine: AP of several classes: their mean, or that of the worst, so that none is bought at another's expense.
        small_iou: In place of --iou for cyclists and pedestrians.
        surrogate: File of coview surrogate, for fidelity surrogate in place of the shipped ones.
        table: File of coview table, for fidelity table in place of the shipped ones.
        comm: AP that a kbit per sensor and frame costs.
        price: AP that one ordinary mount costs.
        seed: Of traffic and search.
        seconds: Stop so many after the candidates are rendered; a portfolio races and judges within that time too.
        evaluations: Stop after so many sets.
        cache: Folder where what was rendered and detected is kept for the next search, None for nowhere.
        workers: Processes that render and detect.
        ray: Address of a Ray cluster instead; local for this machine.
        out: Folder for the site with its sensors, schedule, map, picture, origin; killed and asked again, it goes on.
            With --curve for its table, picture, origin, and the site with each set.
        overwrite: Replace these files.
        json: Print as JSON.
    """
    from placement_env.fidelity.combined.mean_iou import iou_range
    from placement_env.fidelity.combined.robust import Failing
    from placement_env.fidelity.combined.traffic_levels import TrafficLevels
    from placement_env.report.curve_answer import curve_files
    from placement_env.report.search_answer import ANSWER_FILES, check_georeference
    from placement_env.report.searching import SearchOrder, answered
    from placement_env.search.methods import usual_method
    from placement_env.setting import Weights
    from toolkit.detection.link.range_images import find_codec
    from toolkit.sites.files import load_site

    for option, value in (("--budget", budget), ("--frames", frames), ("--workers", workers), ("--parts", parts)):
        check_least(option, value, 1)
    check_positive("--seconds", seconds)
    check_positive("--evaluations", evaluations)
    for name, weight in (("--comm", comm), ("--price", price), ("--seed", seed), ("--money", money)):
        check_least(name, weight, 0)
    check_share("--confidence", confidence)
    thresholds = iou_range(iou)
    check_schemes([scheme])
    profiles = sensor_errors(errors, errors_by)
    chosen: str = method or usual_method(fidelity, verify=verify is not None, at_least=at_least is not None)
    if (chosen == "cheapest") != (at_least is not None) or (at_least is None and parts > 1):
        raise ValueError("--method cheapest and --parts go with --at-least 0.9, and no other method does")
    if at_least is not None and "mean" in (failures, levels_by):
        raise ValueError("--at-least asks for the worst case: leave --failures mean and --levels-by mean out")
    if verify is not None and chosen == "portfolio":
        raise ValueError("--verify is for one method: portfolio is judged by --judge on fresh traffic anyway")
    detects = "detector" in (fidelity, verify) or (chosen == "portfolio" and judge in (None, "detector"))
    for option, said in (("--judge", judge), ("--curve", curve or None)):
        if said is not None and chosen != "portfolio":
            raise ValueError(f"{option} is for --method portfolio, got {chosen}: leave one of them out")
    for option, given in (("--errors", errors != ("paper",)), ("--detector", detector is not None)):
        if given and not detects:
            raise ValueError(f"{option} is for --fidelity, --verify or --judge detector: say one of them")
    check_ray(ray)
    counted = counted_classes(classes, class_weights, combine, small_iou)
    if cache is not None:
        check_writable(cache.resolve(), cache)
    place = load_site(site)
    if out is not None:
        check_georeference(place)
        for name in curve_files(budget, by_money=money is not None) if curve else ANSWER_FILES:
            check_folder(out, holds=name, inputs=[*site_file(site), *site_file(candidates)], overwrite=overwrite)
    if fidelity == "table" and candidates != "paper":
        raise ValueError("--fidelity table knows the built-in sites' own sensors only: say --candidates paper")
    own = None if detector is None else site_detector(detector, place)
    if own is not None and detector is not None and cache is not None:
        check_digest(detector, own, ": add one, or say --cache None")
    demand = {} if at_least is None else {"at_least": at_least, "failing": failing, "parts": parts, "levels": levels}
    pool, currency = asked_pool(place, candidates, model, sensors)
    order = SearchOrder(
        site=place, candidates=pool, method=chosen, budget=budget, scheme=scheme, fidelity=fidelity, verify=verify,
        judge=judge or "detector", confidence=confidence, weights=Weights(comm, price), frames=frames, errors=profiles,
        detector=own, surrogate=surrogate, table=table, demand=demand, currency=currency, curve=curve,
        limits={"seconds": seconds, "evaluations": evaluations},
        settings={
            "most_price": math.inf if money is None else money, "iou": thresholds, "seed": seed, "cache": cache,
            "failing": Failing(0 if demand else failing, failures), "workers": workers, "ray": ray, "classes": counted,
            "levels": TrafficLevels(1 if demand else levels, levels_by), "codec": find_codec(codec),
        },
    )  # fmt: skip
    with progress_bar("", hidden=json) as bar:
        found = answered(order, out=out, overwrite=overwrite, progress=bar.stage)
    print_result(found.summary, "\n".join(found.lines), as_json=json)
    return OK if found.met else NOT_MET
