"""`coview plan`: a deployment plan, judged on traffic that its search never saw, with a report."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

from tyro.conf import Positional

from coview.arguments import (
    Combine,
    Label,
    check_least,
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


def plan(
    site: Positional[str],
    /,
    *,
    out: Path = Path("out/plan"),
    budget: int | None = None,
    money: float | None = None,
    min_ap: float | None = None,
    max_kbit: float | None = None,
    capacity: float | None = None,
    classes: tuple[Label, ...] = ("vehicle",),
    class_weights: tuple[float, ...] | None = None,
    combine: Combine = "mean",
    small_iou: float = 0.5,
    scheme: str = "early",
    codec: str = "paper",
    iou: str = "0.7",
    failing: Literal[0, 1, 2] = 0,
    failures: Literal["worst", "mean"] = "worst",
    levels: Literal[1, 2, 3, 4] = 1,
    levels_by: Literal["worst", "mean"] = "worst",
    candidates: str = "pool",
    sensors: Path | None = None,
    keep_out: Path | None = None,
    detector: str | None = None,
    errors: tuple[str, ...] = ("paper",),
    errors_by: Literal["worst", "mean"] = "worst",
    frames: int | None = None,
    confidence: float = 0.95,
    seed: int = 0,
    cache: Path | None = Path("out/cache"),
    workers: int = 2,
    overwrite: bool = False,
    json: bool = False,
) -> int:
    """Plan which sensors to build, and write the report that says which, why, and what it cannot say.

    Example: coview plan tjunction --budget 4 --min-ap 0.9 --out out/plan

    Args:
        site: tjunction, roundabout, or a site file.
        out: Folder for the report: plan.json and what is made of it.
        budget: Most sensors; 4 where no --money is given either.
        money: Most that poles and sensors may cost together, in the catalogue's currency, or in ordinary poles.
        min_ap: AP that must be reached; the cheapest set that does is the answer.
        max_kbit: Most that a sensor may send per frame.
        capacity: Of the link of every pole (kbit per frame), in place of the poles' own.
        classes: Road users whose AP counts, if the detector knows them; of the others a share is stated that is seen.
        class_weights: Of each class in their mean; equal when left out.
        combine: AP of several classes: their mean, or that of the worst.
        small_iou: In place of --iou for cyclists and pedestrians.
        scheme: How measurements are fused: early, late, hybrid or foreground.
        codec: Of what is sent: paper counts 96 bits a point and 256 a box, range-images sends bytes in steps of 2 cm.
        iou: At which a detection counts; 0.5:0.95 for the mean AP over 0.5, 0.55 to 0.95, as in COCO.
        failing: Sensors that fail (0 to 2): sets are compared, and required to reach --min-ap, by what is left then.
        failures: What is left in the worst case, or in the mean over which fail.
        levels: Of traffic, by how many road users are there at once: sets are searched, compared, and required to reach
            --min-ap, by the AP of each level by itself.
        levels_by: The level of least AP counts, or the mean of their AP.
        candidates: pool, paper for the site's own sensors, or a GeoJSON file of poles.
        sensors: Catalogue of sensor models and their prices, TOML; the paper's camera at no price when left out.
        keep_out: GeoJSON file with areas where no sensor may stand.
        detector: As in coview evaluate, but for cluster; left out a shipped one.
        errors: Of the sensors, as in coview evaluate, when sets are compared and the answer is judged: one profile, or
            several, so that sets are compared, and required to reach --min-ap, by the AP over all of them.
        errors_by: Of several profiles: the one of least AP counts, or the mean of their AP.
        frames: Of each of the three parts of traffic, for search, comparison, judgement; 60, 60, 120 when left out.
        confidence: At which a comparison ends: that no set of as many sensors is better by more than 0.01.
        seed: Of traffic, searches and intervals.
        cache: Folder where what was seen and detected is kept, so that a stopped plan goes on; None for nowhere.
        workers: Processes.
        overwrite: Replace the plan of another run.
        json: Print the plan as JSON.
    """
    from placement_env.candidates.poles import load_keep_out
    from placement_env.candidates.sensor_catalogue import load_sensor_catalogue
    from placement_env.cases import Cases, iou_text
    from placement_env.report.planning.files import write_plan
    from placement_env.report.planning.planning import plan as make_plan
    from placement_env.report.planning.question import Question
    from toolkit.detection.link.range_images import find_codec
    from toolkit.sites.files import load_site

    for option, value, least in (
        ("--budget", budget, 0), ("--money", money, 0), ("--min-ap", min_ap, 0), ("--max-kbit", max_kbit, 0),
        ("--frames", frames, 1), ("--workers", workers, 1), ("--seed", seed, 0),
    ):  # fmt: skip
        check_least(option, value, least)
    check_share("--confidence", confidence)
    cases = Cases(
        iou=iou,
        failing=failing,
        failures=failures,
        levels=levels,
        levels_by=levels_by,
        errors=errors,
        errors_by=errors_by,
    )
    check_schemes([scheme])
    counted = counted_classes(classes, class_weights, combine, small_iou)
    inputs = [*site_file(site), *site_file(candidates), *(path for path in (sensors, keep_out) if path is not None)]
    check_folder(out, holds="plan.json", inputs=inputs, overwrite=overwrite)
    if cache is not None:
        check_writable(cache.resolve(), cache)
    place = load_site(site)
    own = None if detector is None else site_detector(detector, place)
    if own is not None and detector is not None and cache is not None:
        check_digest(detector, own, ": add one, or say --cache None")
    lengths = {} if frames is None else {"search_frames": frames, "judge_frames": frames, "final_frames": frames}
    question = Question(
        site=place,
        sensors=4 if budget is None and money is None else budget,
        money=money,
        min_ap=min_ap,
        max_kbit=max_kbit,
        capacity_kbit=capacity,
        classes=counted,
        scheme=scheme,
        codec=find_codec(codec),
        cases=cases,
        candidates=candidates,
        catalogue=None if sensors is None else load_sensor_catalogue(sensors),
        keep_out=() if keep_out is None else load_keep_out(keep_out, place),
        detector=own,
        seed=seed,
        confidence=confidence,
        **lengths,
    )
    with progress_bar("", hidden=json) as bar:
        planned = make_plan(question, cache=cache, workers=workers, progress=bar.stage)
        written = write_plan(planned, out)
    verdict, refused = planned.plan.verdict, planned.plan.verdict.met is False
    lines = [" ".join((verdict.sentence, *verdict.reasons)) if refused else verdict.sentence]
    lines += [f"  {s.name}: {s.pole}, {s.height:.1f} m, bearing {s.bearing_deg:.0f}" for s in planned.plan.sensors]
    if len(planned.plan.class_ap) > 1:
        lines += [
            f"  {row.label:<10} AP {row.judged.ap:.3f} ({row.judged.low:.3f} to {row.judged.high:.3f}) at IoU "
            f"{iou_text(row.iou)}, {row.judged.vehicles} to find"
            for row in planned.plan.class_ap
        ]
    lines += [
        f"  {row.name:<18} AP {row.judged.ap:.3f} ({row.judged.low:.3f} to {row.judged.high:.3f}), "
        f"{row.judged.vehicles} to find in {row.judged.frames} frames"
        for row in (*planned.plan.by_level, *planned.plan.by_errors)
        if row.judged is not None
    ]
    lines.append(f"written to {out}: {', '.join(path.name for path in written)}")
    print_result(planned.plan.as_dict(), "\n".join(lines), as_json=json)
    return NOT_MET if refused else OK
