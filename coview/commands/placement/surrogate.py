"""`coview surrogate`: fit a model that predicts a detector's AP from points on objects."""

from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path

from tyro.conf import Positional

from coview.arguments import Label, check_ending, check_least, check_schemes, site_file
from coview.detector_spec import DetectorSpec
from coview.detectors import check_digest, open_detector
from coview.outputs import OK, Writing, check_file, check_writable, claim, print_result
from coview.progress_bar import progress_bar
from placement_env.checks import check_iou
from toolkit.runtime.run import Run
from toolkit.sensors.models import find_model


@dataclass(frozen=True, kw_only=True)
class SurrogateFit:
    """Detector, classes and samples to fit to."""

    detector: str = "voxelnet"
    """Detector, as in coview evaluate except cluster."""
    classes: tuple[Label, ...] = ("vehicle",)
    """Classes of road users, with a model for each."""
    iou: tuple[float, ...] = (0.7, 0.8, 0.9)
    """IoU thresholds of vehicles, with a model for each."""
    small_iou: float = 0.5
    """IoU threshold of cyclists and pedestrians."""
    schemes: tuple[str, ...] = ("early", "late", "hybrid")
    """Fusion schemes, with a model for each: early, late and hybrid."""
    poses: int = 60
    """Number of random poses of the site's pool, added to its own sensors."""
    sets: int = 60
    """Number of random sets of 1 to 8 sensors that the detector scores."""
    model: tuple[str, ...] = ()
    """Names of the sensor models of the poses; the paper's camera when left out."""
    random_sites: int = 0
    """Number of random junctions to fit to as well; a fit to one site knows only its distances."""
    resamples: int = 20
    """Number of bootstrap refits, which tell how uncertain a prediction is."""

    def __post_init__(self) -> None:
        """Raise ValueError for an option that is out of range."""
        for option, value, minimum in (
            ("--poses", self.poses, 0),
            ("--sets", self.sets, 1),
            ("--random-sites", self.random_sites, 0),
            ("--resamples", self.resamples, 0),
        ):
            check_least(option, value, minimum)
        check_schemes(self.schemes)
        for iou in self.iou:
            check_iou(iou)


def surrogate_command(
    sites: Positional[tuple[str, ...]],
    /,
    *,
    out: Path,
    fit: SurrogateFit = SurrogateFit(),
    run: Run = Run(seed=1000, frames=100, cache=Path("out/cache")),
    writing: Writing = Writing(),
) -> int:
    """Fit a fast surrogate of a detector: it predicts AP from points on each object.

    Choose another --seed than for the traffic on which the surrogate will be judged.

    Example: coview surrogate tjunction --detector tjunction --classes vehicle pedestrian
        --out people.json

    Args:
        sites: tjunction, roundabout, or site files; none with --random-sites.
        out: File of models to write (.json), for coview search --surrogate."""
    from coview.options import ClassOptions
    from placement_env.fidelity.hit_fit import Sampling, fit_sites
    from placement_env.fidelity.hit_model import save_models
    from toolkit.sites.files import load_site
    from toolkit.sites.random import random_site

    check_ending(out, (".json",), "a surrogate")
    counted = ClassOptions(classes=fit.classes, small_iou=fit.small_iou).build()
    check = partial(check_file, out, inputs=[path for site in sites for path in site_file(site)])
    check(overwrite=True)
    if run.cache is not None:
        check_writable(run.cache.resolve(), run.cache)
    fitted_sites = [load_site(name) for name in sites]
    fitted_sites += [random_site(run.seed + number) for number in range(fit.random_sites)]
    if not fitted_sites:
        raise ValueError("there is no site to fit to: name one, or pass --random-sites 8")
    spec = DetectorSpec.from_name(fit.detector)
    detectors = {site.name: open_detector(spec, site) for site in fitted_sites}
    if run.cache is not None:
        first_detector = detectors[fitted_sites[0].name]
        check_digest(fit.detector, first_detector, ": add one, or pass --cache None")
    names = ", ".join(site.name for site in fitted_sites[: len(sites)])
    random_names = f"{fit.random_sites} random sites" if fit.random_sites else ""
    site_names = " and ".join(filter(None, (names, random_names)))
    source = (
        f"{run.frames} frames of {site_names} traffic, seed {run.seed}, {fit.sets} sets, detector "
        f"{fit.detector}"
    )
    sampling = Sampling(fit.poses, fit.sets, tuple(map(find_model, fit.model)), fit.resamples)
    claimed = claim(out, (sites, fit, run), check, overwrite=writing.overwrite)
    with claimed, progress_bar("", hidden=writing.json) as bar:
        fitted = fit_sites(
            fitted_sites,
            lambda site: detectors[site.name],
            schemes=fit.schemes,
            classes=counted,
            ious=fit.iou,
            sampling=sampling,
            source=source,
            run=replace(run, progress=bar.stage),
        )
        save_models(tuple(model for model, _ in fitted), out)
    lines = [
        f"{model.label:<10} {model.scheme:<7} IoU {model.iou:g}: AP within {rms:.3f} of the "
        "detector's"
        for model, rms in fitted
    ]
    rows = [{**asdict(model), "rms": rms} for model, rms in fitted]
    print_result(rows, "\n".join([*lines, f"written to {out}"]), as_json=writing.json)
    return OK
