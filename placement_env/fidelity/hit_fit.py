"""Fits a `HitModel` to what a detector hit and missed: maximum likelihood over all objects and sensor sets."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from placement_env.classes import VEHICLES, Classes
from placement_env.fidelity.hit_model import RANGES, HitModel
from placement_env.fidelity.protocol import ClassEstimates
from placement_env.fidelity.surrogate import Evidence, Surrogate, expected_ap
from placement_env.fidelity.visibility import Visibility
from placement_env.subsets import MemberSums
from toolkit.arrays import Bool, Float64
from toolkit.detection.scheme import Scheme
from toolkit.detection.schemes import PAPER_SCHEMES, scheme_of
from toolkit.objects import LABELS, VEHICLE, Detector, check_known
from toolkit.sites.site import HYBRID_RADIUS, Site

if TYPE_CHECKING:
    from placement_env.fidelity.detector import Detected
    from toolkit.runtime.cache import Cache

FITTED = ("intercept", "density", "norm", "reach", "oblique")  # and the ceiling, as a logit
NORM_OF_POINTS, NORM_OF_BOXES = 0.8, 4.0  # to start from
CEILING_LOGIT = (-4.0, 7.0)


def fit(
    visibility: Visibility,
    subsets: Bool[np.ndarray, "n C"],
    hits: Bool[np.ndarray, "n O"],
    ap: Float64[np.ndarray, " n"],
    *,
    scheme: Scheme | str,
    iou: float,
    radius: float = HYBRID_RADIUS,
    source: str = "",
    label: str = LABELS[VEHICLE],
) -> HitModel:
    """The model under which these hits are likeliest, and whose AP is nearest to the detector's in the mean square.

    hits: which objects of `visibility` each set hit; ap: what each set scored; radius: of hybrid fusion (m); label:
    class of the objects, for its name alone.
    Raises ValueError where there is nothing to fit; ModuleNotFoundError without SciPy.
    """
    _check(visibility, subsets, hits, ap)
    scheme = scheme_of(scheme)
    evidence = Evidence(visibility, scheme, radius)
    minimize, minimize_scalar = _scipy()

    def model_of(numbers: Float64[np.ndarray, " 6"], false_alarms: float = 0.0) -> HitModel:
        named = dict(zip(FITTED, map(float, numbers[:-1]), strict=True))
        ceiling = float(1 / (1 + np.exp(-numbers[-1])))
        return HitModel(
            scheme=scheme.name, iou=iou, ceiling=ceiling, false_alarms=false_alarms, source=source, label=label, **named
        )

    def unlikelihood(numbers: Float64[np.ndarray, " 6"]) -> float:
        p = np.clip(_probability(evidence, subsets, model_of(numbers)), 1e-9, 1 - 1e-9)
        return -float(np.where(hits, np.log(p), np.log1p(-p)).mean())

    bounds = [*(RANGES[name] for name in FITTED), CEILING_LOGIT]
    norm = NORM_OF_BOXES if scheme.sends_boxes else NORM_OF_POINTS
    starts = [(-2.0 - 3.0 * reach, 1.6, norm, reach, 0.5, 3.0) for reach in (0.0, 1.0)]
    ends = [minimize(unlikelihood, start, method="L-BFGS-B", bounds=bounds) for start in starts]
    best = min(ends, key=lambda end: float(end.fun)).x
    ranked = -np.sort(-_probability(evidence, subsets, model_of(best)), axis=1)
    misfit = minimize_scalar(
        lambda rate: float(np.square(expected_ap(ranked, float(rate))[0] - ap).mean()),
        bounds=RANGES["false_alarms"],
        method="bounded",
    )
    return model_of(best, float(misfit.x))


def fit_detected(
    visibility: Visibility,
    detected: Detected,
    subsets: Bool[np.ndarray, "n C"],
    *,
    radius: float = HYBRID_RADIUS,
    source: str,
) -> tuple[HitModel, ...]:
    """A model of each class at each IoU threshold of what `detected`, of the same candidates, frames and classes, says
    of the sets. Raises ValueError where there is nothing to fit, saying of which class."""
    from placement_env.fidelity.detector import IOUS

    estimates: dict[float, ClassEstimates] = detected.class_estimates(subsets)
    hits = np.stack([detected.hits(subset).hit for subset in subsets], axis=1)
    common: dict[str, Any] = {"scheme": detected.scheme, "radius": radius, "source": source}
    models: dict[tuple[str, float], HitModel] = {}
    for c, (name, label) in enumerate(zip(detected.classes.names, detected.classes.labels, strict=True)):
        own, seen = visibility.labels == label, visibility.of_classes([label])
        for i, iou in enumerate(IOUS):
            at = detected.iou_of(label, iou)
            if (name, at) in models:
                continue
            try:
                models[name, at] = fit(
                    seen, subsets, hits[i][:, own], estimates[iou].ap[:, c], iou=at, label=name, **common
                )
            except ValueError as error:
                raise ValueError(f"{name} at IoU {at:g} in {detected.scheme.name} fusion: {error}") from None
    return tuple(models.values())


class Fitted(NamedTuple):
    """A model, and by how much its AP is off that of the detector on the sets it was fitted to, root mean square."""

    model: HitModel
    rms: float


def fit_site(
    site: Site,
    detector: Detector,
    *,
    schemes: Sequence[Scheme | str] = PAPER_SCHEMES,
    classes: Classes = VEHICLES,
    frames: int = 100,
    poses: int = 60,
    sets: int = 60,
    seed: int = 1000,
    source: str = "",
    cache: Cache | None = None,
    workers: int = 1,
    progress: Callable[[str, int, int | None], None] | None = None,
) -> tuple[Fitted, ...]:
    """A model of each scheme, class and IoU threshold of what a detector hits at a site, with its own sensors and with
    poses of its pool, drawn from the seed as the traffic is.

    sets: how many, of 1 to 8 sensors; cache: where detections are kept, so that what was broken off goes on; progress:
    called with a scheme, frames done and how many. Raises ValueError where a class is not there or is always hit.
    """
    from placement_env.candidates.sampling import own_and_random, random_sets
    from placement_env.fidelity.detector import Detected
    from placement_env.fidelity.renders import Renders
    from placement_env.fidelity.traffic import simulate_traffic
    from placement_env.fidelity.visibility import see

    _scipy()
    check_known(detector, classes.names)
    rng = np.random.default_rng(seed)
    candidates = own_and_random(site, poses, rng)
    chosen = random_sets(candidates, len(site.sensors), sets, rng)
    traffic = simulate_traffic(site, frames, seed)
    visibility = see(traffic, candidates, labels=classes.labels, workers=workers, cache=cache)
    for name, label in zip(classes.names, classes.labels, strict=True):
        if not (visibility.labels == label).any():
            raise ValueError(f"there is no {name} in {frames} frames of traffic: take more, or leave out the class")
    renders = Renders(traffic, candidates, cache)
    fitted: list[Fitted] = []
    for scheme in map(scheme_of, schemes):
        detected = Detected(renders, detector, scheme, memo=cache, workers=workers, classes=classes)
        report = None if progress is None else partial(_done, progress, f"{scheme.name} fusion", frames)
        detected.estimates(chosen, progress=report)
        radius = site.hybrid_radius
        models = fit_detected(visibility, detected, chosen, radius=radius, source=source)
        fitted += [Fitted(model, _misfit(model, visibility, detected, chosen, radius)) for model in models]
    return tuple(fitted)


def _done(progress: Callable[[str, int, int | None], None], stage: str, total: int, done: int) -> None:
    progress(stage, done, total)


def _misfit(
    model: HitModel, visibility: Visibility, detected: Detected, subsets: Bool[np.ndarray, "n C"], radius: float
) -> float:
    own = Classes((model.label,))
    guess = Surrogate(visibility, detected.scheme, model, radius=radius, classes=own)(subsets).ap
    column = detected.classes.names.index(model.label)
    (at,) = [iou for iou in detected.ious if detected.iou_of(own.labels[0], iou) == model.iou][:1]
    return float(np.sqrt(np.square(guess - detected.class_estimates(subsets)[at].ap[:, column]).mean()))


def _probability(evidence: Evidence, subsets: np.ndarray, model: HitModel) -> np.ndarray:
    sums = MemberSums(evidence.rows(model, np.float64))(subsets)
    return model.probability(evidence.joined(sums, model))


def _check(visibility: Visibility, subsets: np.ndarray, hits: np.ndarray, ap: np.ndarray) -> None:
    wanted = (len(subsets), visibility.points.shape[1])
    if hits.shape != wanted or ap.shape != wanted[:1] or subsets.shape[1] != len(visibility.points):
        raise ValueError(
            f"there must be a hit or miss for each of {wanted[0]} sets and {wanted[1]} objects and an AP for each set, "
            f"got hits {hits.shape}, ap {ap.shape}: were they made of the same frames?"
        )
    if not hits.any() or hits.all() or not np.isfinite(ap).all():
        raise ValueError(f"a fit needs hits and misses and finite APs, got {int(hits.sum())} hits of {hits.size}")


def _scipy() -> tuple[Any, Any]:
    try:
        from scipy.optimize import minimize, minimize_scalar
    except ModuleNotFoundError:
        raise ModuleNotFoundError("fitting a surrogate needs SciPy: pip install scipy") from None
    return minimize, minimize_scalar
