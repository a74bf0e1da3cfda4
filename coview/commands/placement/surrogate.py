"""`coview surrogate`: fit to a detector what predicts its AP from how many points sensors have on each object."""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from pathlib import Path

from tyro.conf import Positional

from coview.arguments import Label, check_least, check_schemes, site_file
from coview.detectors import check_digest, site_detector
from coview.exits import OK
from coview.outputs import check_file, check_writable
from coview.printing import print_result
from coview.progress_bar import progress_bar
from toolkit.runtime.run import Run


@dataclass(frozen=True, kw_only=True)
class SurrogateOptions:
    """Surrogate, and what it is fitted to."""

    out: Path
    """File of models to write (.json): coview search --surrogate takes it."""
    detector: str = "voxelnet"
    """Detector, as in coview evaluate, but for cluster."""
    classes: tuple[Label, ...] = ("vehicle",)
    """Classes of road users, with a model for each."""
    iou: tuple[float, ...] = (0.7, 0.8, 0.9)
    """IoU thresholds of vehicles: a search at others, or by their mean, needs those too."""
    small_iou: float = 0.5
    """IoU threshold of cyclists and pedestrians."""
    schemes: tuple[str, ...] = ("early", "late", "hybrid")
    """Fusion schemes: early, late and hybrid."""
    poses: int = 60
    """Poses of the site's pool, drawn at random, beside its own sensors."""
    sets: int = 60
    """Sets of 1 to 8 sensors, drawn at random, that the detector scores."""
    model: tuple[str, ...] = ()
    """Sensor models, by name, of the poses; the paper's camera when left out."""
    random_sites: int = 0
    """Drawn junctions to fit to beside the sites: a fit to one site knows its distances only."""
    resamples: int = 20
    """Refits to what is drawn with replacement, which say how sure a prediction is."""
    overwrite: bool = False
    """Replace a file that is there."""
    json: bool = False
    """Print models and errors as JSON."""

    def __post_init__(self) -> None:
        from placement_env.checks import check_iou

        for option, value, least in (
            ("--poses", self.poses, 0),
            ("--sets", self.sets, 1),
            ("--random-sites", self.random_sites, 0),
            ("--resamples", self.resamples, 0),
        ):
            check_least(option, value, least)
        check_schemes(self.schemes)
        for each in self.iou:
            check_iou(each)


def surrogate(
    sites: Positional[tuple[str, ...]],
    /,
    *,
    asked: SurrogateOptions,
    run: Run = Run(seed=1000, frames=100, cache=Path("out/cache")),
) -> int:
    """Fit a surrogate of a detector at some sites, a model for each scheme, class and IoU threshold.

    Take another seed than that of the traffic by which the surrogate will be judged.

    Example: coview surrogate tjunction --detector tjunction --classes vehicle pedestrian --out people.json
    Example: coview surrogate mine.json --random-sites 8 --detector general --frames 8 --out general.json

    Args:
        sites: tjunction, roundabout, or site files; none where random ones are enough.
    """
    from coview.options import ClassOptions
    from placement_env.fidelity.hit_fit import Sampling, fit_sites
    from placement_env.fidelity.hit_model import save_models
    from toolkit.sensors.models import find_model
    from toolkit.sites.files import load_site
    from toolkit.sites.random import random_site

    counted = ClassOptions(classes=asked.classes, small_iou=asked.small_iou).build()
    check_file(asked.out, inputs=[path for site in sites for path in site_file(site)], overwrite=asked.overwrite)
    if run.cache is not None:
        check_writable(run.cache.resolve(), run.cache)
    places = [*map(load_site, sites), *(random_site(run.seed + i) for i in range(asked.random_sites))]
    if not places:
        raise ValueError("there is no site to fit to: name one, or say --random-sites 8")
    detect = {place.name: site_detector(asked.detector, place) for place in places}
    if run.cache is not None:
        check_digest(asked.detector, detect[places[0].name], ": add one, or say --cache None")
    names = ", ".join(place.name for place in places[: len(sites)])
    drawn = f"{asked.random_sites} random sites" if asked.random_sites else ""
    source = (
        f"{run.frames} frames of {' and '.join(filter(None, (names, drawn)))} traffic, seed {run.seed}, "
        f"{asked.sets} sets, detector {asked.detector}"
    )
    sampling = Sampling(asked.poses, asked.sets, tuple(map(find_model, asked.model)), asked.resamples)
    with progress_bar("", hidden=asked.json) as bar:
        fitted = fit_sites(
            places,
            lambda place: detect[place.name],
            schemes=asked.schemes,
            classes=counted,
            ious=asked.iou,
            sampling=sampling,
            source=source,
            run=replace(run, progress=bar.stage),
        )
    save_models(tuple(model for model, _ in fitted), asked.out)
    lines = [f"{m.label:<10} {m.scheme:<7} IoU {m.iou:g}: AP within {rms:.3f} of the detector's" for m, rms in fitted]
    rows = [{**asdict(model), "rms": rms} for model, rms in fitted]
    print_result(rows, "\n".join([*lines, f"written to {asked.out}"]), as_json=asked.json)
    return OK
