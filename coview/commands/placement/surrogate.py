"""`coview surrogate`: fit to a detector what predicts its AP from how many points sensors have on each object."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path

from tyro.conf import Positional

from coview.arguments import Label, check_least, check_schemes, counted_classes, site_file
from coview.detectors import check_digest, site_detector
from coview.exits import OK
from coview.outputs import check_file, check_writable
from coview.printing import print_result
from coview.progress_bar import progress_bar


def surrogate(
    sites: Positional[tuple[str, ...]],
    /,
    *,
    out: Path,
    detector: str = "voxelnet",
    classes: tuple[Label, ...] = ("vehicle",),
    iou: tuple[float, ...] = (0.7, 0.8, 0.9),
    small_iou: float = 0.5,
    schemes: tuple[str, ...] = ("early", "late", "hybrid"),
    frames: int = 100,
    poses: int = 60,
    sets: int = 60,
    model: tuple[str, ...] = (),
    random_sites: int = 0,
    resamples: int = 20,
    seed: int = 1000,
    cache: Path | None = Path("out/cache"),
    workers: int = 1,
    overwrite: bool = False,
    json: bool = False,
) -> int:
    """Fit a surrogate of a detector at some sites, a model for each scheme, class and IoU threshold.

    Example: coview surrogate tjunction --detector tjunction --classes vehicle pedestrian --out people.json
    Example: coview surrogate mine.json --random-sites 8 --detector general --frames 8 --out general.json

    Args:
        sites: tjunction, roundabout, or site files; none where random ones are enough.
        out: File of models to write (.json): coview search --surrogate takes it.
        detector: As in coview evaluate, but for cluster.
        classes: Of road users, with a model for each.
        iou: At which vehicles are fitted: a search at others, or by their mean, needs those too.
        small_iou: IoU of cyclists and pedestrians.
        schemes: Which of early, late and hybrid fusion.
        frames: Of simulated traffic.
        poses: Of the site's pool, drawn at random, beside its own sensors.
        sets: Of 1 to 8 sensors, drawn at random, that the detector scores.
        model: Sensor models, by name, of the poses; the paper's camera when left out.
        random_sites: How many drawn junctions to fit to beside the sites: a fit to one site knows its distances only.
        resamples: How often it is fitted again, to what is drawn with replacement, to say how sure it is.
        seed: Of random sites, traffic, poses and sets: another than that of what the surrogate will be judged by.
        cache: Folder where what was seen and detected is kept, so that it goes on when stopped; None for nowhere.
        workers: Processes.
        overwrite: Replace a file that is there.
        json: Print models and errors as JSON.
    """
    from placement_env.checks import check_iou
    from placement_env.fidelity.hits.hit_fit import fit_sites
    from placement_env.fidelity.hits.hit_model import save_models
    from toolkit.runtime.cache import Cache
    from toolkit.sensors.models import find_model
    from toolkit.sites.files import load_site
    from toolkit.sites.random import random_site

    for option, value, least in (
        ("--frames", frames, 1), ("--poses", poses, 0), ("--sets", sets, 1), ("--workers", workers, 1),
        ("--seed", seed, 0), ("--random-sites", random_sites, 0), ("--resamples", resamples, 0),
    ):  # fmt: skip
        check_least(option, value, least)
    check_schemes(schemes)
    for each in iou:
        check_iou(each)
    counted = counted_classes(classes, None, "mean", small_iou)
    check_file(out, inputs=[path for site in sites for path in site_file(site)], overwrite=overwrite)
    if cache is not None:
        check_writable(cache.resolve(), cache)
    places = [*map(load_site, sites), *(random_site(seed + i) for i in range(random_sites))]
    if not places:
        raise ValueError("there is no site to fit to: name one, or say --random-sites 8")
    detect = {place.name: site_detector(detector, place) for place in places}
    if cache is not None:
        check_digest(detector, detect[places[0].name], ": add one, or say --cache None")
    names = ", ".join(place.name for place in places[: len(sites)])
    drawn = f"{random_sites} random sites" if random_sites else ""
    source = (
        f"{frames} frames of {' and '.join(filter(None, (names, drawn)))} traffic, seed {seed}, {sets} sets, "
        f"detector {detector}"
    )
    with progress_bar("", hidden=json) as bar:
        fitted = fit_sites(
            places, lambda place: detect[place.name], schemes=schemes, classes=counted, ious=iou, frames=frames,
            poses=poses, sets=sets, seed=seed, models=[find_model(name) for name in model], resamples=resamples,
            source=source,
            cache=None if cache is None else Cache(cache / "cache.sqlite"), workers=workers,
            progress=bar.stage,
        )  # fmt: skip
    save_models(tuple(model for model, _ in fitted), out)
    lines = [f"{m.label:<10} {m.scheme:<7} IoU {m.iou:g}: AP within {rms:.3f} of the detector's" for m, rms in fitted]
    print_result(
        [{**asdict(model), "rms": rms} for model, rms in fitted], "\n".join([*lines, f"written to {out}"]), as_json=json
    )
    return OK
