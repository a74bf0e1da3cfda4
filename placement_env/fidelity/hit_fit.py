"""Fit a `HitModel` to a detector's hits and misses, by maximum likelihood over all objects and
sensor sets."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import product
from typing import Any, NamedTuple

import numpy as np
from scipy.optimize import minimize, minimize_scalar

from placement_env.candidates.candidates import Candidates, own_and_random, random_sets
from placement_env.classes import VEHICLES, Classes
from placement_env.fidelity.detector import Detected
from placement_env.fidelity.hit_model import NUMBERS, RANGES, HitModel, build_domain
from placement_env.fidelity.renders import Renders
from placement_env.fidelity.surrogate import Evidence, Surrogate, compute_expected_ap
from placement_env.fidelity.traffic import Traffic, simulate_traffic
from placement_env.fidelity.visibility import Visibility
from placement_env.subsets import MemberSums, Sets
from toolkit.arrays import Bool, Float64
from toolkit.detection.scheme import Scheme
from toolkit.detection.schemes import PAPER_SCHEMES, find_scheme
from toolkit.objects import LABELS, VEHICLE, Detector, check_known
from toolkit.runtime.run import Run
from toolkit.sensors.sensor import SensorModel
from toolkit.sites.site import HYBRID_RADIUS, Site
from toolkit.traffic.spawner import LIFE

# plus ceiling as a logit, floor as a logarithm
FITTED = ("intercept", "density", "norm", "reach", "oblique", "bulk")
# to start from
NORM_OF_POINTS = 0.8
NORM_OF_BOXES = 4.0
CEILING_LOGIT = (-4.0, 7.0)
# to start from, and the range of its logarithm
FLOOR = 10.0
FLOOR_LOG = (-1.0, 5.0)
FIT_FRAMES = 100  # of each site


class Observed(NamedTuple):
    """Hits and AP of sensor sets at one site. radius: of hybrid fusion (m); sensors: kinds of
    models."""

    visibility: Visibility
    subsets: Sets
    hits: Bool[np.ndarray, "n O"]
    ap: Float64[np.ndarray, " n"]
    radius: float = HYBRID_RADIUS
    sensors: tuple[str, ...] = ()


# of each object and each set of a site
_Weights = tuple[Float64[np.ndarray, " _"], Float64[np.ndarray, " _"]]


def fit(
    observed: Sequence[Observed],
    *,
    scheme: Scheme | str,
    iou: float,
    source: str = "",
    label: str = LABELS[VEHICLE],
    resamples: int = 0,
    seed: int = 0,
) -> HitModel:
    """Model that best explains the hits at some sites, and then has the least mean squared error of
    the AP.

    resamples: repeated fits to sites (unless single), blocks of frames and sets drawn with
    replacement, from which the model states its uncertainty and its error at the sites (of a single
    one, sets) left out. Raises ValueError where the data are empty."""
    for each in observed:
        _check(each)
    hits = sum(int(each.hits.sum()) for each in observed)
    if not 0 < hits < sum(each.hits.size for each in observed):
        raise ValueError(
            f"a fit needs hits and misses, got {hits} hits of {sum(e.hits.size for e in observed)}"
        )
    scheme = find_scheme(scheme)
    fitting = _Fitting(observed, scheme, {"iou": iou, "source": source, "label": label})
    norm = NORM_OF_BOXES if scheme.sends_boxes else NORM_OF_POINTS
    starts = [
        (-2.0 - 3.0 * reach, 1.6, norm, reach, 0.5, 0.2, 3.0, float(np.log(FLOOR)))
        for reach in (0.0, 1.0)
    ]
    everything = [(np.ones(each.hits.shape[1]), np.ones(len(each.ap))) for each in observed]
    best, model = min(
        (fitting.fit(np.array(start), everything) for start in starts), key=lambda end: end[2]
    )[:2]
    rng = np.random.default_rng(seed)
    draws = [_draw(observed, rng) for _ in range(resamples)]
    again = [fitting.fit(best, drawn)[1] for drawn in draws]
    points, distance = (
        [getattr(each.visibility, name) for each in observed] for name in ("points", "distance")
    )
    kinds = [kind for each in observed for kind in each.sensors]
    domain = build_domain(points, distance, kinds, sum(len(each.ap) for each in observed))
    rows = tuple(tuple(float(f"{getattr(each, name):.6g}") for name in NUMBERS) for each in again)
    return replace(
        model, domain=domain, resampled=rows, error=round(fitting.find_error(again, draws), 4)
    )


class _Fitting:
    """Likelihood and misfit of models of one scheme, IoU threshold and class."""

    def __init__(self, observed: Sequence[Observed], scheme: Scheme, names: dict[str, Any]) -> None:
        self._observed = observed
        self._names = {"scheme": scheme.name, **names}
        self._evidence = [Evidence(each.visibility, scheme, each.radius) for each in observed]

    def fit(
        self, start: Float64[np.ndarray, " p"], weights: Sequence[_Weights]
    ) -> tuple[Float64[np.ndarray, " p"], HitModel, float]:
        """Best numbers from a start, their model, and the hits' unlikelihood under it."""
        bounds = [*(RANGES[name] for name in FITTED), CEILING_LOGIT, FLOOR_LOG]
        end = minimize(self._unlikelihood, start, args=(weights,), method="L-BFGS-B", bounds=bounds)
        ranked = [-np.sort(-p, axis=1) for p in self._probabilities(self._model(end.x))]
        total = max(sum(sets.sum() for _, sets in weights), 1.0)

        def misfit(rate: float) -> float:
            parts = zip(ranked, self._observed, weights, strict=True)
            return sum(
                float(np.square(compute_expected_ap(p, float(rate))[0] - each.ap) @ sets)
                for p, each, (_, sets) in parts
            ) / float(total)

        rate = minimize_scalar(misfit, bounds=RANGES["false_alarms"], method="bounded").x
        return end.x, self._model(end.x, float(rate)), float(end.fun)

    def find_error(self, models: Sequence[HitModel], draws: Sequence[Sequence[_Weights]]) -> float:
        """Error of models, as `HitModel` has it, at what each was not drawn from; 0 where that is
        nothing."""
        squares = 0.0
        scale = 1e-9
        for model, drawn in zip(models, draws, strict=True):
            for p, each, (objects, sets) in zip(
                self._probabilities(model), self._observed, drawn, strict=True
            ):
                out = (sets == 0) & (len(drawn) == 1 or not objects.any())
                ap = compute_expected_ap(-np.sort(-p[out], axis=1), model.false_alarms)[0]
                squares += float(np.square(ap - each.ap[out]).sum())
                scale += float((ap * (1 - ap)).sum())
        return min(float(np.sqrt(squares / scale)), RANGES["error"][1])

    def _model(self, numbers: Float64[np.ndarray, " p"], false_alarms: float = 0.0) -> HitModel:
        named: dict[str, Any] = dict(zip(FITTED, map(float, numbers[:-2]), strict=True))
        ceiling = float(1 / (1 + np.exp(-numbers[-2])))
        floor = float(np.exp(numbers[-1]))
        return HitModel(
            **self._names, **named, ceiling=ceiling, floor=floor, false_alarms=false_alarms
        )

    def _probabilities(self, model: HitModel) -> list[Float64[np.ndarray, "n O"]]:
        found = []
        for evidence, each in zip(self._evidence, self._observed, strict=True):
            sums = MemberSums(evidence.rows(model, np.float64))(each.subsets)
            found.append(
                model.probability(*evidence.joined(sums, model))
                * model.of_size(each.visibility.boxes)
            )
        return found

    def _unlikelihood(
        self, numbers: Float64[np.ndarray, " p"], weights: Sequence[_Weights]
    ) -> float:
        total = count = 0.0
        chances = self._probabilities(self._model(numbers))
        for p, each, (objects, _) in zip(chances, self._observed, weights, strict=True):
            p = np.clip(p, 1e-9, 1 - 1e-9)
            total -= float((np.where(each.hits, np.log(p), np.log1p(-p)) @ objects).sum())
            count += float(objects.sum()) * len(p)
        return total / max(count, 1.0)


def _draw(observed: Sequence[Observed], rng: np.random.Generator) -> list[_Weights]:
    """Sites drawn with replacement, with their blocks and sets."""

    def draw(total: int, count: int) -> np.ndarray:
        return rng.multinomial(total, np.full(count, 1 / count)) if count else np.zeros(0, np.int64)

    weights = []
    for each, often in zip(observed, draw(len(observed), len(observed)).tolist(), strict=True):
        blocks, place = np.unique(each.visibility.frame // LIFE, return_inverse=True)
        drawn = draw(len(blocks) * often, len(blocks))
        weights.append(
            (
                drawn[place].astype(np.float64),
                draw(len(each.ap) * often, len(each.ap)).astype(np.float64),
            )
        )
    return weights


class Fitted(NamedTuple):
    """A model and its root-mean-square AP error against the detector, on the sets that it was
    fitted to."""

    model: HitModel
    rms: float


def fit_detected(
    found: Sequence[tuple[Visibility, Detected, Bool[np.ndarray, "_ _"]]],
    *,
    source: str,
    ious: Sequence[float] = (),
    resamples: int = 0,
    seed: int = 0,
) -> tuple[Fitted, ...]:
    """Models of each class at each IoU threshold.

    found: at each site the visibility, the detections of the same candidates, frames and classes,
    and the sets; ious: of vehicles, from those of `Detected`, all where empty. Raises ValueError
    where the data of a class are empty."""
    first = found[0][1]
    estimates = [detected.class_estimates(sets) for _, detected, sets in found]
    hits = [np.stack([detected.hits(row) for row in sets], axis=1) for _, detected, sets in found]
    fitted: dict[tuple[str, float], Fitted] = {}
    for (c, (name, label)), iou in product(
        enumerate(zip(first.classes.names, first.classes.labels, strict=True)), ious or first.ious
    ):
        at = first.classes.get_iou(name, iou)
        row = first.ious.index(iou)
        if (name, at) in fitted:
            continue
        observed = []
        for (seen, detected, sets), hit, estimate in zip(found, hits, estimates, strict=True):
            own = seen.labels == label
            renders = detected.renders
            kinds = tuple(sorted({type(sensor.model).__name__ for sensor in renders.sensors}))
            where = seen.of_classes([label]), sets, hit[row][:, own], estimate[iou].ap[:, c].copy()
            observed += [Observed(*where, renders.site.hybrid_radius, kinds)] if own.any() else []
        named: dict[str, Any] = {"scheme": first.scheme, "iou": at, "label": name, "source": source}
        try:
            model = fit(observed, resamples=resamples, seed=seed, **named)
        except ValueError as error:
            raise ValueError(
                f"{name} at IoU {at:g} in {first.scheme.name} fusion: {error}"
            ) from None
        errors = []
        classes = Classes((model.label,))
        for each in observed:
            surrogate = Surrogate(
                each.visibility, first.scheme, model, radius=each.radius, classes=classes
            )
            errors.append(surrogate(each.subsets).ap - each.ap)
        fitted[name, at] = Fitted(model, float(np.sqrt(np.square(np.concatenate(errors)).mean())))
    return tuple(fitted.values())


@dataclass(frozen=True)
class Sampling:
    """Sensors and sets for a fit beside a site's own. sets: of 1 to 8 sensors; models: empty for
    the paper's camera."""

    poses: int = 60
    sets: int = 60
    models: tuple[SensorModel, ...] = ()
    resamples: int = 20

    def draw(self, site: Site, frames: int, seed: int) -> tuple[Traffic, Candidates, Sets]:
        """Draw traffic, poses and sets of them at a site."""
        rng = np.random.default_rng(seed)
        candidates = own_and_random(site, self.poses, rng, models=self.models)
        chosen = random_sets(candidates, len(site.sensors), self.sets, rng)
        return simulate_traffic(site, frames, seed), candidates, chosen[chosen.any(axis=1)]


def fit_sites(
    sites: Sequence[Site],
    detector_of: Callable[[Site], Detector],
    *,
    schemes: Sequence[Scheme | str] = PAPER_SCHEMES,
    classes: Classes = VEHICLES,
    ious: Sequence[float] = (0.7, 0.8, 0.9),
    sampling: Sampling = Sampling(),
    source: str = "",
    run: Run = Run(seed=1000),
) -> tuple[Fitted, ...]:
    """Models of a detector's hits at some sites, for each scheme, class and IoU threshold.

    ious: of vehicles; run: its seed, plus the place of a site in the list, draws traffic, poses and
    sets; its cache keeps detections, so an interrupted run resumes. Raises ValueError where a class
    is absent or is always hit."""
    from placement_env.fidelity.seeing import see

    observed = []
    frames = run.frames_or(FIT_FRAMES)
    for place, site in enumerate(sites):
        detector = detector_of(site)
        check_known(detector, classes.names)
        traffic, candidates, chosen = sampling.draw(site, frames, run.seed + place)
        seen = see(traffic, candidates, labels=classes.labels, run=run)
        observed.append((seen, chosen, detector, Renders(traffic, candidates, run.memo)))
    for name, label in zip(classes.names, classes.labels, strict=True):
        if not any((seen.labels == label).any() for seen, *_ in observed):
            raise ValueError(
                f"no {name} appears in {frames} frames of traffic: increase --frames or leave it "
                "out"
            )
    fitted: list[Fitted] = []
    for scheme in map(find_scheme, schemes):
        found = []
        for place, (seen, chosen, detector, renders) in enumerate(observed):
            detected = Detected(
                renders, detector, scheme, memo=run.memo, processes=run, classes=classes
            )
            detected = detected.at(ious[0], also=ious)
            report = run.stage(f"{scheme.name} fusion", len(sites) * frames, before=place * frames)
            detected.estimates(chosen, progress=report)
            found.append((seen, detected, chosen))
        fitted += fit_detected(
            found, source=source, ious=ious, resamples=sampling.resamples, seed=run.seed
        )
    return tuple(fitted)


def _check(each: Observed) -> None:
    wanted = (len(each.subsets), each.visibility.points.shape[1])
    ap = each.ap
    hits = each.hits
    if (
        hits.shape != wanted
        or ap.shape != wanted[:1]
        or each.subsets.shape[1] != len(each.visibility.points)
    ):
        raise ValueError(
            f"there must be a hit or miss for each of {wanted[0]} sets and {wanted[1]} objects "
            f"and an AP for each set, got hits {hits.shape}, ap {ap.shape}: were they made of the "
            "same frames?"
        )
    if not np.isfinite(ap).all():
        raise ValueError("a fit needs finite APs: leave out what has nothing to find")
