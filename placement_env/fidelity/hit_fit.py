"""Fit a `HitModel` to a detector's hits and misses, by maximum likelihood over all objects and
sensor sets."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import product
from typing import Any, NamedTuple

import numpy as np
from scipy.optimize import minimize, minimize_scalar

from placement_env.candidates.candidates import Candidates, own_and_random, random_sets
from placement_env.classes import Classes
from placement_env.defaults import VEHICLES
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
from toolkit.sites.site import HYBRID_RADIUS_M, Site
from toolkit.traffic.spawner import LIFE

# the optimiser's numbers: these, then the logit of the ceiling and the logarithm of the floor
FITTED_NUMBERS = ("intercept", "density", "norm", "reach", "oblique", "bulk")
START_POINT_NORM = 0.8  # norm that a fit starts from, for schemes that send points
START_BOX_NORM = 4.0  # the same for schemes that send boxes
CEILING_LOGIT_RANGE = (-4.0, 7.0)
START_FLOOR_POINTS = 10.0  # floor that a fit starts from
FLOOR_LOG_RANGE = (-1.0, 5.0)
DEFAULT_FIT_FRAMES = 100  # frames of traffic at each site


class Observed(NamedTuple):
    """Hits and AP of n sensor sets at one site, measured with a detector.

    Attributes:
        visibility: Points of the candidates on the scored objects, all of one class.
        subsets: Sets as rows of booleans, one column per candidate.
        hits: True if a set hits an object.
        ap: AP of each set.
        radius: Radius of hybrid fusion (m).
        sensors: Names of the classes of the candidates' sensor models."""

    visibility: Visibility
    subsets: Sets
    hits: Bool[np.ndarray, "n objects"]
    ap: Float64[np.ndarray, " n"]
    radius: float = HYBRID_RADIUS_M
    sensors: tuple[str, ...] = ()


class _Weights(NamedTuple):
    """Weights of the data of one site: all count once, or as often as a resample drew them.

    Attributes:
        objects: How often each object counts.
        sets: How often each sensor set counts."""

    objects: Float64[np.ndarray, " objects"]
    sets: Float64[np.ndarray, " n"]


class _Optimum(NamedTuple):
    """Result of a fit.

    Attributes:
        numbers: Best numbers: `FITTED_NUMBERS`, logit of the ceiling and logarithm of the floor.
        model: Model with these numbers, and with its false alarms.
        unlikelihood: Mean negative log-likelihood of the hits, the less the better."""

    numbers: Float64[np.ndarray, " p"]
    model: HitModel
    unlikelihood: float


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
    """Fit a model to hits and AP of sensor sets at some sites.

    Its numbers have the maximum likelihood of the hits, except for the false alarms: these have the
    least mean squared error of the AP.

    Args:
        observed: Hits and AP at each site, of one class.
        scheme: Fusion scheme of the sets, or its name.
        iou: IoU threshold of the hits.
        source: Fitted data in words, for the model.
        label: Name of the class of the objects.
        resamples: Number of further fits to sites (unless there is one), blocks of frames and sets
            drawn with replacement. They give the model's uncertainty, and its error at the sites
            left out of each draw (at the sets left out for a single site); 0 for none.
        seed: Seed of the draws.

    Raises ValueError if the data are empty, do not fit together, or are all hits or all misses."""
    for observation in observed:
        _check(observation)
    hits = sum(int(observation.hits.sum()) for observation in observed)
    if not 0 < hits < sum(observation.hits.size for observation in observed):
        raise ValueError(
            f"a fit needs hits and misses, got {hits} hits of {sum(e.hits.size for e in observed)}"
        )
    scheme = find_scheme(scheme)
    fitting = _Fitting(observed, scheme, {"iou": iou, "source": source, "label": label})
    norm = START_BOX_NORM if scheme.sends_boxes else START_POINT_NORM
    # intercept, density, norm, reach, oblique, bulk (`FITTED_NUMBERS`), then logit of the ceiling
    # and logarithm of the floor
    starts = [
        (-2.0 - 3.0 * reach, 1.6, norm, reach, 0.5, 0.2, 3.0, float(np.log(START_FLOOR_POINTS)))
        for reach in (0.0, 1.0)
    ]
    full_weights = [
        _Weights(objects=np.ones(observation.hits.shape[1]), sets=np.ones(len(observation.ap)))
        for observation in observed
    ]
    optima = [fitting.fit(np.array(start), full_weights) for start in starts]
    best = min(optima, key=lambda optimum: optimum.unlikelihood)
    rng = np.random.default_rng(seed)
    draws = [_draw(observed, rng) for _ in range(resamples)]
    refits = [fitting.fit(best.numbers, weights).model for weights in draws]
    points = [observation.visibility.points for observation in observed]
    distance = [observation.visibility.distance for observation in observed]
    kinds = [kind for observation in observed for kind in observation.sensors]
    set_count = sum(len(observation.ap) for observation in observed)
    return replace(
        best.model,
        domain=build_domain(points, distance, kinds, sets=set_count),
        resampled=tuple(map(_round_numbers, refits)),
        error=round(fitting.find_error(refits, draws), 4),
    )


def _round_numbers(model: HitModel) -> tuple[float, ...]:
    """Numbers of a model in the order of `NUMBERS`, to six significant digits."""
    return tuple(float(f"{getattr(model, name):.6g}") for name in NUMBERS)


class _Fitting:
    """Fits of models for one scheme, IoU threshold and class to the same data.

    Args:
        observed: Hits and AP at each site.
        scheme: Fusion scheme of the sets.
        names: Fields of each model that are not fitted, except the scheme."""

    def __init__(self, observed: Sequence[Observed], scheme: Scheme, names: dict[str, Any]) -> None:
        """Prepare the evidence of the candidates at each site, which all fits share."""
        self._observed = observed
        self._fixed_fields = {"scheme": scheme.name, **names}
        self._evidence = [
            Evidence(observation.visibility, scheme, observation.radius) for observation in observed
        ]

    def fit(self, start: Float64[np.ndarray, " p"], weights: Sequence[_Weights]) -> _Optimum:
        """Fit a model to weighted data.

        Args:
            start: `FITTED_NUMBERS`, logit of the ceiling and logarithm of the floor (p = 8).
            weights: At each site, how often each object and each set counts."""
        bounds = [*(RANGES[name] for name in FITTED_NUMBERS), CEILING_LOGIT_RANGE, FLOOR_LOG_RANGE]
        optimum = minimize(
            self._compute_unlikelihood, start, args=(weights,), method="L-BFGS-B", bounds=bounds
        )
        # probabilities of each set's objects in descending order
        ranked = [-np.sort(-p, axis=1) for p in self._probabilities(self._build_model(optimum.x))]
        total = max(sum(site_weights.sets.sum() for site_weights in weights), 1.0)

        def misfit(rate: float) -> float:
            """Mean squared error of the AP with this rate of false alarms."""
            squares = []
            for p, observation, site_weights in zip(ranked, self._observed, weights, strict=True):
                ap, _ = compute_expected_ap(p, float(rate))
                squares.append(float(np.square(ap - observation.ap) @ site_weights.sets))
            return sum(squares) / float(total)

        # the likelihood does not depend on the false alarms, so they are fitted afterwards
        rate = minimize_scalar(misfit, bounds=RANGES["false_alarms"], method="bounded").x
        return _Optimum(
            numbers=optimum.x,
            model=self._build_model(optimum.x, float(rate)),
            unlikelihood=float(optimum.fun),
        )

    def find_error(self, models: Sequence[HitModel], draws: Sequence[Sequence[_Weights]]) -> float:
        """Error of the AP (`HitModel.error`) of refitted models at the data left out of each draw.

        Left out are the sets that were not drawn, at sites that were not drawn (or at the only
        site). 0 if nothing is left out.

        Args:
            models: Model fitted to each draw.
            draws: For each draw and site, how often each object and each set was drawn."""
        squares = 0.0  # sum of squared errors of the AP
        scale = 1e-9  # sum of AP (1 - AP), which squares are divided by; never 0
        for model, weights in zip(models, draws, strict=True):
            is_only_site = len(weights) == 1
            # for each site: probability p that a set (row) hits an object (column)
            for p, observation, site_weights in zip(
                self._probabilities(model), self._observed, weights, strict=True
            ):
                # no object of a site that was not drawn has weight
                is_test_site = is_only_site or not site_weights.objects.any()
                left_out = (site_weights.sets == 0) & is_test_site  # mask of the sets
                ranked = -np.sort(-p[left_out], axis=1)  # each row in descending order
                ap, _ = compute_expected_ap(ranked, model.false_alarms)
                # `observation.ap`: measured AP of each set
                squares += float(np.square(ap - observation.ap[left_out]).sum())
                scale += float((ap * (1 - ap)).sum())
        _, max_error = RANGES["error"]  # least and largest error that a model states
        return min(float(np.sqrt(squares / scale)), max_error)

    def _build_model(
        self, numbers: Float64[np.ndarray, " p"], false_alarms: float = 0.0
    ) -> HitModel:
        """Model of `FITTED_NUMBERS`, logit of the ceiling and logarithm of the floor.

        false_alarms: number per frame of a set."""
        by_name: dict[str, Any] = dict(zip(FITTED_NUMBERS, map(float, numbers[:-2]), strict=True))
        ceiling = float(1 / (1 + np.exp(-numbers[-2])))
        floor = float(np.exp(numbers[-1]))
        return HitModel(
            **self._fixed_fields, **by_name, ceiling=ceiling, floor=floor, false_alarms=false_alarms
        )

    def _probabilities(self, model: HitModel) -> list[Float64[np.ndarray, "n objects"]]:
        """Hit probability of each object (columns) for each set (rows), at each site."""
        probabilities = []
        for evidence, observation in zip(self._evidence, self._observed, strict=True):
            sums = MemberSums(evidence.rows(model, np.float64))(observation.subsets)
            powers, raw_powers = evidence.joined(sums, model)
            size_factors = model.of_size(observation.visibility.boxes)
            probabilities.append(model.probability(powers, raw_powers) * size_factors)
        return probabilities

    def _compute_unlikelihood(
        self, numbers: Float64[np.ndarray, " p"], weights: Sequence[_Weights]
    ) -> float:
        """Mean negative log-likelihood of the hits and misses of all sets under a model.

        Args:
            numbers: `FITTED_NUMBERS`, logit of the ceiling and logarithm of the floor.
            weights: At each site, how often each object counts for every set."""
        total = count = 0.0
        # for each site: probability p that a set (row) hits an object (column)
        probabilities = self._probabilities(self._build_model(numbers))
        for p, observation, site_weights in zip(
            probabilities, self._observed, weights, strict=True
        ):
            clipped_p = np.clip(p, 1e-9, 1 - 1e-9)  # so that the logarithms are finite
            logs = np.where(observation.hits, np.log(clipped_p), np.log1p(-clipped_p))
            total -= float((logs @ site_weights.objects).sum())
            count += float(site_weights.objects.sum()) * len(clipped_p)
        return total / max(count, 1.0)


def _draw(observed: Sequence[Observed], rng: np.random.Generator) -> list[_Weights]:
    """Draw sites with replacement, and at each as many blocks of frames and sets as it has.

    A block is `LIFE` frames, as long as a vehicle may be seen. A site that is drawn k times gives k
    times as many. The order of draws (sites; then blocks and sets of each site) fixes the figures
    of a seed.

    Returns:
        At each site, how often each object and each set is drawn."""

    def count_draws(total: int, count: int) -> np.ndarray:
        # how often each of `count` items is drawn in `total` draws with replacement; no items, no
        # draws
        return rng.multinomial(total, np.full(count, 1 / count)) if count else np.zeros(0, np.int64)

    weights = []
    site_repeats = count_draws(len(observed), len(observed)).tolist()
    for observation, repeats in zip(observed, site_repeats, strict=True):
        sets = len(observation.ap)
        # block_index: index in `blocks` of each object's block
        blocks, block_index = np.unique(observation.visibility.frame // LIFE, return_inverse=True)
        block_weights = count_draws(len(blocks) * repeats, len(blocks))
        set_weights = count_draws(sets * repeats, sets)
        weights.append(
            _Weights(
                objects=block_weights[block_index].astype(np.float64),
                sets=set_weights.astype(np.float64),
            )
        )
    return weights


class Fitted(NamedTuple):
    """A hit model, and the root mean square error of its AP on the sets that it was fitted to."""

    model: HitModel
    rms: float


def fit_detected(
    detected_sites: Sequence[tuple[Visibility, Detected, Bool[np.ndarray, "_ _"]]],
    *,
    source: str,
    ious: Sequence[float] = (),
    resamples: int = 0,
    seed: int = 0,
) -> tuple[Fitted, ...]:
    """Fit a model to a detector for each class at each of its IoU thresholds.

    Args:
        detected_sites: At each site the visibility, the fidelity `Detected` of the same candidates,
            frames and classes, and the sets as rows of booleans.
        source: Fitted data in words, for the models.
        ious: IoU thresholds of vehicles, from the ones of `Detected`; all if empty. Other
            classes are fitted at the thresholds that `Classes.get_iou` gives for them.
        resamples: Number of fits to resampled data that give each model its spread, 0 for none.
        seed: Seed of the resamples.

    Raises ValueError if the data of a class are empty."""
    first = detected_sites[0][1]
    estimates = [detected.class_estimates(subsets) for _, detected, subsets in detected_sites]
    hits = []  # at each site; axes: IoU threshold, set, object
    for _, detected, subsets in detected_sites:
        hits.append(np.stack([detected.hits(subset) for subset in subsets], axis=1))
    fitted: dict[tuple[str, float], Fitted] = {}  # by class and its IoU threshold
    class_numbers = enumerate(zip(first.classes.names, first.classes.labels, strict=True))
    for (c, (name, label)), iou in product(class_numbers, ious or first.ious):
        threshold = first.classes.get_iou(name, iou)
        iou_row = first.ious.index(iou)
        if (name, threshold) in fitted:
            continue  # several thresholds of vehicles may give a class the same one
        observed = []
        for (visibility, detected, subsets), site_hits, site_estimates in zip(
            detected_sites, hits, estimates, strict=True
        ):
            has_label = visibility.labels == label
            if has_label.any():
                sensors = detected.renders.sensors
                observed.append(
                    Observed(
                        visibility=visibility.of_classes([label]),
                        subsets=subsets,
                        hits=site_hits[iou_row][:, has_label],
                        ap=site_estimates[iou].ap[:, c].copy(),
                        radius=detected.renders.site.hybrid_radius,
                        sensors=tuple(sorted({type(sensor.model).__name__ for sensor in sensors})),
                    )
                )
        try:
            model = fit(
                observed,
                scheme=first.scheme,
                iou=threshold,
                label=name,
                source=source,
                resamples=resamples,
                seed=seed,
            )
        except ValueError as error:
            raise ValueError(
                f"{name} at IoU {threshold:g} in {first.scheme.name} fusion: {error}"
            ) from None
        fitted[name, threshold] = Fitted(model, rms=_compute_rms(model, observed, first.scheme))
    return tuple(fitted.values())


def _compute_rms(model: HitModel, observed: Sequence[Observed], scheme: Scheme) -> float:
    """Root mean square error of the AP that a model predicts for all observed sets."""
    errors = []
    classes = Classes((model.label,))
    for observation in observed:
        surrogate = Surrogate(
            observation.visibility, scheme, model, radius=observation.radius, classes=classes
        )
        errors.append(surrogate(observation.subsets).ap - observation.ap)
    return float(np.sqrt(np.square(np.concatenate(errors)).mean()))


@dataclass(frozen=True)
class Sampling:
    """Numbers of sensors and sets to draw for a fit.

    Attributes:
        poses: Random poses of a site's pool, in addition to the site's sensors.
        sets: Sets of sensors, at most.
        models: Sensor models of the random poses; empty for the paper's camera.
        resamples: Fits to resampled data for each model, see `fit`."""

    poses: int = 60
    sets: int = 60
    models: tuple[SensorModel, ...] = ()
    resamples: int = 20

    def draw(self, site: Site, frames: int, seed: int) -> tuple[Traffic, Candidates, Sets]:
        """Draw traffic in `frames` frames, candidates and sets (rows of booleans) at a site.

        Candidates are the site's sensors, then `poses` random ones. There are up to `sets` sets,
        each with a sensor or more. Poses are drawn before sets from the same generator, so this
        order fixes the result of a seed."""
        rng = np.random.default_rng(seed)
        candidates = own_and_random(site, self.poses, rng, models=self.models)
        subsets = random_sets(candidates, len(site.sensors), self.sets, rng)
        has_members = subsets.any(axis=1)
        return simulate_traffic(site, frames, seed), candidates, subsets[has_members]


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
    """Fit models to a detector's hits at some sites, for each scheme, class and IoU threshold.

    Args:
        sites: Sites whose traffic is simulated.
        detector_of: Returns the detector to use at a site.
        schemes: Fusion schemes, or their names.
        classes: Classes of the objects.
        ious: IoU thresholds of vehicles. Other classes are fitted at the thresholds that
            `Classes.get_iou` gives for them.
        sampling: Numbers of poses, sets and resamples to draw.
        source: Fitted data in words, for the models.
        run: Frames, processes, progress, cache and seed. Seed plus index of a site draws its
            traffic, poses and sets; the cache keeps detections, so an interrupted run resumes.

    Raises ValueError if a class is absent or is always hit."""
    from placement_env.fidelity.seeing import see

    observed = []
    frames = run.frames_or(DEFAULT_FIT_FRAMES)
    for number, site in enumerate(sites):
        detector = detector_of(site)
        check_known(detector, classes.names)
        traffic, candidates, subsets = sampling.draw(site, frames, run.seed + number)
        seen = see(traffic, candidates, labels=classes.labels, run=run)
        observed.append((seen, subsets, detector, Renders(traffic, candidates, run.memo)))
    for name, label in zip(classes.names, classes.labels, strict=True):
        if not any((seen.labels == label).any() for seen, *_ in observed):
            raise ValueError(
                f"no {name} appears in {frames} frames of traffic: increase --frames or leave it "
                "out"
            )
    fitted: list[Fitted] = []
    for scheme in map(find_scheme, schemes):
        detected_sites = []
        for number, (seen, subsets, detector, renders) in enumerate(observed):
            detected = Detected(
                renders, detector, scheme, memo=run.memo, processes=run, classes=classes
            )
            detected = detected.at(ious[0], also=ious)
            report = run.stage(f"{scheme.name} fusion", len(sites) * frames, before=number * frames)
            detected.estimates(subsets, progress=report)  # keeps its detections for the fit
            detected_sites.append((seen, detected, subsets))
        fitted += fit_detected(
            detected_sites, source=source, ious=ious, resamples=sampling.resamples, seed=run.seed
        )
    return tuple(fitted)


def _check(observation: Observed) -> None:
    """Raise ValueError unless sets, hits, AP and visibility fit together and each AP is finite."""
    candidates, objects = observation.visibility.points.shape
    sets = len(observation.subsets)
    ap = observation.ap
    hits = observation.hits
    if (
        hits.shape != (sets, objects)
        or ap.shape != (sets,)
        or observation.subsets.shape[1] != candidates
    ):
        raise ValueError(
            f"there must be a hit or miss for each of {sets} sets and {objects} objects "
            f"and an AP for each set, got hits {hits.shape}, ap {ap.shape}: were they made of the "
            "same frames?"
        )
    if not np.isfinite(ap).all():
        raise ValueError("a fit needs finite APs: leave out what has nothing to find")
