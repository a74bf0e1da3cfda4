"""`Surrogate`: AP of sensor sets predicted from the points that their sensors have on each object.

A `HitModel` gives each object's probability p of being hit. Objects are ranked by it, as by a
detector's scores. Down to the i-th of them, T_i = p_1 + ... + p_i hits are expected and λ (i - T_i)
false alarms, λ being the model's `false_alarms`. The area under that expected precision-recall
curve of O objects is

    AP = 1/O Σ_i p_i · T_i / (T_i + λ (i - T_i)),      recall = T_O / O"""

from collections.abc import Iterable, Sequence
from copy import copy
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np

from placement_env.classes import Classes
from placement_env.defaults import VEHICLES
from placement_env.fidelity.coverage import SentData
from placement_env.fidelity.hit_model import HitModel, shipped_model
from placement_env.fidelity.visibility import Visibility, of_frames
from placement_env.protocol import ClassEstimates, Estimate
from placement_env.subsets import MemberSums, Sets
from toolkit.arrays import Bool, Float, Float32, Float64, Int64
from toolkit.detection.codec import PAPER, Codec
from toolkit.detection.scheme import Scheme, surrogate_name
from toolkit.detection.schemes import find_scheme
from toolkit.sites.site import HYBRID_RADIUS_M

MAX_OBJECT_POINTS = 1e5  # points on an object: powers and their sums fit float32
# multiplications up to which BLAS takes one thread for a product: waiting for a busy core to
# share the work takes far longer
MAX_ONE_THREAD_PRODUCT = 1 << 18


class ClassEvidence(NamedTuple):
    """Evidence of candidates on the objects of one class.

    Attributes:
        powers: n ^ norm of each candidate and object, which adds up over the sensors of a set.
        size_factor: Factor of each object's size on its hit probability.
        model: Hit model of the class.
        weight: Weight of the class among all classes with objects, which add up to 1."""

    powers: Float32[np.ndarray, "candidates objects"]
    size_factor: Float64[np.ndarray, " objects"]
    model: HitModel
    weight: float


class Surrogate:
    """Score sets by the AP that is expected from their points on each object.

    Args:
        visibility: Points of the candidates on objects.
        scheme: Fusion scheme, or its name.
        model: Hit model of vehicles, or one of each class; None for the shipped ones of the scheme
            at the IoU threshold of each class.
        iou: IoU threshold of vehicles for shipped models, not used otherwise.
        radius: Hybrid radius of the site (m).
        codec: Codec of the data sent.
        classes: Classes of the objects that count; several are combined.

    Raises ValueError for a model that is missing or of another scheme."""

    name = "surrogate"

    def __init__(
        self,
        visibility: Visibility,
        scheme: Scheme | str = "early",
        model: HitModel | Sequence[HitModel] | None = None,
        *,
        iou: float = 0.7,
        radius: float = HYBRID_RADIUS_M,
        codec: Codec = PAPER,
        classes: Classes = VEHICLES,
    ) -> None:
        """Choose the hit models of the classes, and take the points that sets are scored by.

        model: for vehicles, or one for each class; None for the shipped ones, by the IoU from which
        a detection hits; radius: distance to a sensor (m) within which scheme hybrid pools."""
        self.classes = classes
        self._scheme = find_scheme(scheme)
        self._codec = codec
        self._radius = radius
        self.models = _choose_models(self._scheme, model, classes, iou)
        self._set_visibility(visibility, sizes=[None] * len(classes))  # None: computed there

    def over(self, visibility: Visibility) -> "Surrogate":
        """Copy with the same models for other candidates in the same traffic.

        visibility: Points of the other candidates. If it shares the array of boxes, factors of the
            objects' sizes are shared too."""
        surrogate = copy(self)
        surrogate._set_visibility(visibility, [part.sizes for part in self._parts])
        return surrogate

    def _set_visibility(
        self, visibility: Visibility, sizes: Sequence["_SizeFactors | None"]
    ) -> None:
        """Set the points that sets are scored by.

        Args:
            visibility: Points of the candidates on objects.
            sizes: Factors of the objects' sizes for each class, used if they are of the same boxes;
                None to compute them."""
        counted_visibility = visibility.of_classes(self.classes.labels)
        self._parts = []
        for label, model, class_sizes in zip(self.classes.labels, self.models, sizes, strict=True):
            class_visibility = (
                counted_visibility
                if len(self.classes) == 1
                else counted_visibility.of_classes([label])
            )
            if class_sizes is None or class_sizes.boxes is not class_visibility.boxes:
                class_sizes = _SizeFactors(model, class_visibility.boxes)
            # hit probabilities follow from the points on objects (evidence) and their sizes
            evidence = Evidence(class_visibility, self._scheme, self._radius)
            self._parts.append(_Part(evidence, class_sizes))
        # gives the kbit of sets
        self._sent = SentData(counted_visibility, self._scheme, self._codec)

    def __call__(self, subsets: Sets, /) -> Estimate:
        """Expected AP and recall, and kbit, of each set; several classes are combined."""
        return self.by_class(subsets).combined(self.classes).without_nan()

    def by_class(self, subsets: Sets, /) -> ClassEstimates:
        """Expected AP and recall of each set for each class; NaN for a class without objects."""
        # axes: AP or recall, set, class
        ap, recall = np.stack([part.find_figures(subsets) for part in self._parts], axis=2)
        return ClassEstimates(ap=ap, recall=recall, kbit=self._sent.kbit(subsets))

    def hits(self, subset: Bool[np.ndarray, " candidates"]) -> list[Float64[np.ndarray, " _"]]:
        """Probability that a set hits each object, one array per class in the objects' order.

        subset: True for the candidates of the set."""
        return [
            part.probability(part.sums(subset[None]))[0].astype(np.float64) for part in self._parts
        ]

    def evidence(self) -> list[ClassEvidence]:
        """Evidence that adds up over the sensors of a set, for each class that has objects.

        Raises ValueError in hybrid fusion, whose evidence is no sum over sensors."""
        has_objects = np.array([part.objects > 0 for part in self._parts])
        weights = np.where(has_objects, self.classes.weights, 0.0)
        shares = weights / max(float(weights.sum()), 1e-300)  # never divides by 0
        return [
            ClassEvidence(
                powers=part.powers(),
                size_factor=part.sizes.factor,
                model=part.model,
                weight=float(share),
            )
            for part, share in zip(self._parts, shares, strict=True)
            if part.objects
        ]

    def in_frames(self, frames: Int64[np.ndarray, " _"]) -> "Surrogate":
        """Copy over some of the frames (indices, ascending); kbit remain the mean of all frames."""
        surrogate = copy(self)
        surrogate._parts = []
        for part in self._parts:
            visibility = of_frames(part.evidence.visibility, frames)
            evidence = replace(part.evidence, visibility=visibility)
            surrogate._parts.append(_Part(evidence, _SizeFactors(part.model, visibility.boxes)))
        return surrogate

    def spread(self, subsets: Sets) -> Float64[np.ndarray, " n"]:
        """Standard error of each set's AP, NaN if a model knows none.

        It is √(a² + b²) with a, the standard deviation over the resampled fits, and b, the error of
        the model against the detector, the largest of all classes."""
        if any(len(model.resampled) < 2 and not model.error for model in self.models):
            return np.full(len(subsets), np.nan)
        count = min(len(model.resampled) for model in self.models)
        fit_deviation = np.zeros(len(subsets))
        if count > 1:
            # axes: resampled fit, set, class
            class_ap = np.stack([part.resample(subsets, count) for part in self._parts], axis=2)
            resampled_ap = self.classes.combined(class_ap.reshape(-1, len(self._parts)))
            deviation = np.std(resampled_ap.reshape(count, -1), axis=0, ddof=1)
            fit_deviation = np.nan_to_num(deviation)
        ap = self.by_class(subsets).ap
        # `HitModel.error` is in parts of √(AP (1 - AP)); columns are classes
        errors = np.sqrt(ap * (1 - ap)) * [model.error for model in self.models]
        return np.hypot(fit_deviation, np.nan_to_num(errors).max(axis=1))

    def doubts(self, sensors: Iterable[str] = ()) -> tuple[str, ...]:
        """Sentences on how candidates and objects exceed the fitted data, empty if they do not.

        sensors: Names of the classes of the candidates' sensor models."""
        sentences: dict[str, None] = {}  # keys in order, each once
        for part in self._parts:  # objects of each class
            domain = part.model.domain
            if domain is not None:
                visibility = part.evidence.visibility
                class_sentences = domain.outside(visibility.points, visibility.distance, sensors)
                sentences |= dict.fromkeys(class_sentences)
        return tuple(sentences)


def _choose_models(
    scheme: Scheme, model: HitModel | Sequence[HitModel] | None, classes: Classes, iou: float
) -> tuple[HitModel, ...]:
    """Hit model of each class, from the given ones or the shipped ones.

    Args:
        scheme: Fusion scheme that the models must be for.
        model: Model of vehicles, or one of each class; None for the shipped ones.
        classes: Classes of the objects.
        iou: IoU threshold of vehicles for shipped models, not used otherwise.

    Raises ValueError for a model that is missing or of another scheme."""
    predicted_scheme = surrogate_name(scheme)  # name under which models of the scheme are kept
    if model is None:
        model = [
            shipped_model(predicted_scheme, classes.get_iou(class_name, iou), label=class_name)
            for class_name in classes.names
        ]
    models = [model] if isinstance(model, HitModel) else model
    by_label = {class_model.label: class_model for class_model in models}
    for class_model in by_label.values():
        if class_model.scheme not in (scheme.name, predicted_scheme):
            raise ValueError(
                f"the model is for {class_model.scheme} fusion, not for {scheme.name}: pass "
                "one fitted to it"
            )
    if missing := [class_name for class_name in classes.names if class_name not in by_label]:
        raise ValueError(
            f"there is no model of {', '.join(missing)}: pass one fitted to each class"
        )
    return tuple(by_label[class_name] for class_name in classes.names)


class _SizeFactors:
    """Factors of objects' sizes on their hit probabilities by one model, computed when needed."""

    def __init__(self, model: HitModel, boxes: Float64[np.ndarray, "objects 7"]) -> None:
        self.model = model
        self.boxes = boxes

    @cached_property
    def factor(self) -> Float64[np.ndarray, " objects"]:
        """Factor of each object, 1 unless it is bulky."""
        return self.model.of_size(self.boxes)

    @cached_property
    def single(self) -> Float32[np.ndarray, " objects"]:
        """Factor of each object in single precision."""
        return self.factor.astype(np.float32)

    @cached_property
    def resampled(self) -> list[Float32[np.ndarray, " objects"]]:
        """Factors of all objects for each resampled fit of the model."""
        return [model.of_size(self.boxes).astype(np.float32) for model in self.model.resamples]


class _Part:
    """Objects of one class with their hit model, and the evidence of the candidates on them.

    Attributes:
        evidence: Evidence of each candidate on each object.
        sizes: Factors of the objects' sizes.
        model: Hit model of the class.
        sums: Sums of the evidence's rows over the members of a set.
        objects: Number of objects."""

    def __init__(self, evidence: "Evidence", sizes: _SizeFactors) -> None:
        """Prepare the sums of the evidence by the hit model, which `sizes` holds."""
        self.evidence = evidence
        self.sizes = sizes
        self.model = sizes.model
        self.sums = MemberSums(evidence.rows(self.model))
        self.objects = evidence.visibility.points.shape[1]

    def powers(self) -> Float32[np.ndarray, "candidates objects"]:
        """Evidence n ^ norm of each candidate and object.

        Raises ValueError in hybrid fusion, whose evidence is no sum over sensors."""
        # columns: n ^ norm of each object; with a floor then N ^ norm; only in hybrid fusion there
        # are more, for the points that the centre gets
        if self.sums.rows.shape[1] != self.objects * (2 if self.model.floor > 0 else 1):
            raise ValueError(
                "in hybrid fusion evidence is no sum over sensors: say --scheme early or late"
            )
        return self.sums.rows[:, : self.objects].copy()

    def find_figures(self, subsets: Sets) -> Float64[np.ndarray, "2 n"]:
        """Expected AP and recall (rows) of each set (columns), NaN without an object."""
        figures = np.full((2, len(subsets)), np.nan)
        # block: slice of sets; sums: evidence (`Evidence.rows`), summed over each set's members
        for block, sums in self.sums.blocks(subsets if self.objects else subsets[:0]):
            # hit probabilities in descending order
            if self.model.floor > 0 or self.model.bulk:
                ascending = self.probability(sums)
                ascending.sort(axis=1)
                probability = ascending[:, ::-1]
            else:
                # without floor and sizes, p grows with the evidence: sorting this is the same
                powers, _ = self.evidence.joined(sums, self.model)
                powers.sort(axis=1)
                probability = self.model.probability(powers[:, ::-1])
            # two rows: AP, recall
            figures[:, block] = compute_expected_ap(probability, self.model.false_alarms)
        return figures

    def resample(
        self, subsets: Bool[np.ndarray, "n candidates"], count: int
    ) -> Float64[np.ndarray, "count n"]:
        """AP of each set by each of the first `count` resampled fits, NaN without an object.

        subsets: masks of the sets' candidates."""
        if not self.objects:
            return np.full((count, len(subsets)), np.nan)
        models = self.model.resamples[:count]
        size_factors = self.sizes.resampled[:count]
        # only members: the evidence of all candidates would take hundreds of megabytes
        members = np.flatnonzero(subsets.any(axis=0))
        visibility = self.evidence.visibility.select(members)
        evidence = replace(self.evidence, visibility=visibility)
        # the evidence of all models is summed over the sets' members in one go, then split again
        rows = [evidence.rows(model) for model in models]
        sums = MemberSums(np.concatenate(rows, axis=1))(subsets[:, members])
        model_ends = np.cumsum([columns.shape[1] for columns in rows])
        model_sums = np.split(sums, model_ends[:-1], axis=1)
        probabilities = []
        for model, sums_of_model, factors in zip(models, model_sums, size_factors, strict=True):
            powers, raw_powers = evidence.joined(sums_of_model, model)
            probabilities.append(model.probability(powers, raw_powers) * factors)
        probability = np.stack(probabilities)  # axes: model, set, object
        probability.sort(axis=2)
        false_alarms = np.repeat([model.false_alarms for model in models], len(subsets))
        alarms = false_alarms.astype(np.float32)
        # one row for each model and set, objects in descending order
        ranked = probability[:, :, ::-1].reshape(len(alarms), -1)
        ap, _ = compute_expected_ap(ranked, alarms[:, None])
        return ap.reshape(count, -1)

    def probability(self, sums: Float32[np.ndarray, "n w"]) -> Float32[np.ndarray, "n objects"]:
        """Hit probability of each object for each of n sets.

        sums: Sums of `Evidence.rows` over the members of each set."""
        probability = self.model.probability(*self.evidence.joined(sums, self.model))
        probability *= self.sizes.single
        return probability


def compute_expected_ap(
    probability: Float[np.ndarray, "n objects"], false_alarms: float | Float32[np.ndarray, "n 1"]
) -> tuple[Float64[np.ndarray, " n"], Float64[np.ndarray, " n"]]:
    """Expected AP and recall of n sets; 0 without an object.

    With T_i = p_1 + ... + p_i expected hits among the best i of O objects, AP is
    1/O Σ_i p_i · T_i / (T_i + λ (i - T_i)) and recall is T_O / O.

    Args:
        probability: Hit probability p of each object, in descending order for each set.
        false_alarms: λ, expected false alarms for each object that is less surely found and not
            hit: one for all sets, or a column with one for each."""
    n, objects = probability.shape
    if not objects:
        return np.zeros(n), np.zeros(n)
    # column i: over the best i + 1 objects, expected hits, and detections reported with them
    hits = np.cumsum(probability, axis=1)
    recall = hits[:, -1].astype(np.float64) / objects
    ranks = np.arange(1, objects + 1, dtype=hits.dtype)
    reported = hits + false_alarms * (ranks - hits)
    precision = np.divide(hits, reported, out=hits, where=reported > 0)  # overwrites `hits`
    ap = np.einsum("no,no->n", probability, precision).astype(np.float64) / objects
    return ap, recall


def resample_ap(
    probability: Float64[np.ndarray, " objects"],
    false_alarms: float,
    draws: Float32[np.ndarray, "n blocks"],
    block: Int64[np.ndarray, " objects"],
) -> Float64[np.ndarray, " n"]:
    """Expected AP of one set in n resamples of the traffic, NaN for a resample without an object.

    It is the AP of `compute_expected_ap`, with each object as often as its block is drawn.

    Args:
        probability: Hit probability of each object.
        false_alarms: Expected false alarms for each object that is less surely found and not hit.
        draws: How often each block is drawn in each resample.
        block: Index of each object's block."""
    order = np.argsort(-probability, kind="stable")
    # axes block, object: 1 for the objects of each block, best objects first
    in_block = (block[order] == np.arange(draws.shape[1])[:, None]).astype(np.float32)
    expected = in_block * probability[order].astype(np.float32)
    # for each block, over the best objects up to each: hits, and detections up to there
    hits = np.cumsum(expected, axis=1)
    reported = np.cumsum(expected + np.float32(false_alarms) * (in_block - expected), axis=1)
    area = np.zeros(len(draws), np.float32)  # under the precision-recall curve, times the objects
    chunk_size = max(1, MAX_ONE_THREAD_PRODUCT // max(in_block.size, 1))
    for first in range(0, len(draws), chunk_size):
        chunk = draws[first : first + chunk_size]
        precision = chunk @ hits  # axes: resample, object
        # 0 as long as no object is found
        precision /= np.maximum(chunk @ reported, np.finfo(np.float32).tiny)
        area[first : first + chunk_size] = ((precision @ expected.T) * chunk).sum(axis=1)
    objects = draws @ in_block.sum(axis=1)  # number of objects in each resample
    return np.divide(
        area, objects, out=np.full(len(area), np.nan), where=objects > 0, dtype=np.float64
    )


@dataclass(frozen=True, eq=False)
class Evidence:
    """Evidence of each candidate on each object, which adds up over the members of a set.

    The sums of `rows` over a set go to `joined`, which gives Σ n_i ^ norm of the hit model and, if
    it has a floor, Σ N_i ^ norm. In hybrid fusion the centre counts as one more sensor that has the
    far points of all.

    Attributes:
        visibility: Points of the candidates on objects of one class.
        scheme: Fusion scheme.
        radius: Hybrid radius of the site (m)."""

    visibility: Visibility
    scheme: Scheme
    radius: float

    @cached_property
    def _pooled(self) -> Bool[np.ndarray, "candidates objects"] | None:
        """Mask of pairs whose points the centre gets in addition to boxes; None if there are none.

        Only hybrid fusion has such pairs."""
        return self.scheme.mask_pooled(self.visibility.distance, self.radius)

    @cached_property
    def _place(
        self,
    ) -> tuple[Float32[np.ndarray, "candidates objects"], Float64[np.ndarray, " objects"]]:
        """Distance of each pair (1 m or more) in units of 20 m; |sin 2ψ| of each object's yaw ψ."""
        yaw = self.visibility.boxes[:, 6]
        return np.maximum(self.visibility.distance, 1) / 20, np.abs(np.sin(2 * yaw))

    def rows(self, model: HitModel, dtype: type = np.float32) -> Float[np.ndarray, "candidates w"]:
        """Evidence of each candidate, whose columns are summed over the members of a set.

        n are a candidate's points N on an object, weighted by its distance and heading. Columns are
        n ^ norm for each object. In hybrid fusion then come n for each object whose points the
        centre gets, and 0 for others. If the model has a floor, all this follows for N.

        dtype: Type of the result, float64 for a fit."""
        points: np.ndarray = self.visibility.points.astype(dtype)  # N, then n
        relative_distance, obliqueness = self._place
        raw_columns = self._columns(points, model) if model.floor > 0 else []
        points *= relative_distance.astype(dtype, copy=False) ** model.reach
        points *= np.exp(-model.oblique * obliqueness).astype(dtype)
        columns = [*self._columns(points, model), *raw_columns]
        return columns[0] if len(columns) == 1 else np.concatenate(columns, axis=1)

    def _columns(self, points: np.ndarray, model: HitModel) -> list[np.ndarray]:
        """One or two groups of columns of `rows`, each (candidates, objects).

        They come from n or N of each pair."""
        powers = np.minimum(points, MAX_OBJECT_POINTS) ** model.norm
        return [powers] if self._pooled is None else [powers, np.where(self._pooled, points, 0)]

    def joined(
        self, sums: Float[np.ndarray, "n w"], model: HitModel
    ) -> tuple[Float[np.ndarray, "n objects"], Float[np.ndarray, "n objects"] | None]:
        """Σ n_i ^ norm, and Σ N_i ^ norm if the model has a floor (else None), of n sets.

        sums: Sums of `rows` over the members of each set, for the same model."""
        if model.floor > 0:
            weighted, raw = np.split(sums, 2, axis=1)  # columns for n, then for N
            return self._with_centre(weighted, model), self._with_centre(raw, model)
        return self._with_centre(sums, model), None

    def _with_centre(
        self, sums: Float[np.ndarray, "n w"], model: HitModel
    ) -> Float[np.ndarray, "n objects"]:
        """Sum over the sensors, and over the centre as one more sensor in hybrid fusion.

        sums: Sums of `_columns` over the members of each set."""
        if self._pooled is None:
            return sums
        sensor_powers, centre_points = np.split(sums, 2, axis=1)
        return sensor_powers + centre_points**model.norm
