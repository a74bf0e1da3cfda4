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
        self.classes = classes
        self._scheme = find_scheme(scheme)
        self._codec = codec
        self._radius = radius
        self.models = _choose_models(self._scheme, model, classes, iou)
        self._look(visibility, [None] * len(classes))

    def over(self, visibility: Visibility) -> "Surrogate":
        """Copy with the same models for other candidates in the same traffic.

        visibility: Their points. If it shares the array of boxes, factors of the
        objects' sizes are shared too."""
        surrogate = copy(self)
        surrogate._look(visibility, [part.sizes for part in self._parts])
        return surrogate

    def _look(self, visibility: Visibility, sizes: Sequence["_SizeFactors | None"]) -> None:
        """Set the points that sets are scored by.

        Args:
            visibility: Points of the candidates on objects.
            sizes: Factors of the objects' sizes for each class, used if they are of the same boxes;
                None to compute them."""
        visibility = visibility.of_classes(self.classes.labels)
        self._parts = []
        for label, model, known_sizes in zip(self.classes.labels, self.models, sizes, strict=True):
            seen = visibility if len(self.classes) == 1 else visibility.of_classes([label])
            if known_sizes is None or known_sizes.boxes is not seen.boxes:
                known_sizes = _SizeFactors(model, seen.boxes)
            self._parts.append(_Part(Evidence(seen, self._scheme, self._radius), known_sizes))
        self._sent = SentData(visibility, self._scheme, self._codec)

    def __call__(self, subsets: Sets, /) -> Estimate:
        """Expected AP and recall, and kbit, of each set; several classes are combined."""
        return self.by_class(subsets).combined(self.classes).without_nan()

    def by_class(self, subsets: Sets, /) -> ClassEstimates:
        """Expected AP and recall of each set for each class; NaN for a class without objects."""
        ap, recall = np.stack([part.expected(subsets) for part in self._parts], axis=2)
        return ClassEstimates(ap, recall, self._sent.kbit(subsets))

    def hits(self, subset: Bool[np.ndarray, " C"]) -> list[Float64[np.ndarray, " _"]]:
        """Probability that a set hits each object, one array per class in the objects' order.

        subset: True for the candidates of the set."""
        return [
            part.probability(part.sums(subset[None]))[0].astype(np.float64) for part in self._parts
        ]

    def evidence(
        self,
    ) -> list[tuple[Float32[np.ndarray, "C O"], Float64[np.ndarray, " O"], HitModel, float]]:
        """Evidence that adds up over the sensors of a set, for each class that has objects.

        Raises ValueError in hybrid fusion, whose evidence is no sum over sensors.

        Returns:
            For each class: evidence n ^ norm of each candidate and object; factor of each object's
            size on its hit probability; the hit model; the weight of the class, 1 in all."""
        has_objects = np.array([part.objects > 0 for part in self._parts])
        weights = np.where(has_objects, self.classes.weights, 0.0)
        shares = weights / max(float(weights.sum()), 1e-300)
        return [
            (part.powers(), part.sizes.factor, part.model, float(share))
            for part, share in zip(self._parts, shares, strict=True)
            if part.objects
        ]

    def in_frames(self, frames: Int64[np.ndarray, " _"]) -> "Surrogate":
        """Copy over some of the frames (indices, ascending); kbit remain the mean of all frames."""
        surrogate = copy(self)
        surrogate._parts = []
        for part in self._parts:
            seen = of_frames(part.evidence.visibility, frames)
            evidence = replace(part.evidence, visibility=seen)
            surrogate._parts.append(_Part(evidence, _SizeFactors(part.model, seen.boxes)))
        return surrogate

    def spread(self, subsets: Sets) -> Float64[np.ndarray, " n"]:
        """Standard error of each set's AP, NaN if a model knows none.

        It is the root of two squares: the deviation over the resampled fits, and the error against
        the detector, the largest of all classes."""
        if any(len(model.resampled) < 2 and not model.error for model in self.models):
            return np.full(len(subsets), np.nan)
        count = min(len(model.resampled) for model in self.models)
        fit = np.zeros(len(subsets))
        if count > 1:
            figures = np.stack([part.resampled(subsets, count) for part in self._parts], axis=2)
            ap = self.classes.combined(figures.reshape(-1, len(self._parts)))
            fit = np.nan_to_num(np.std(ap.reshape(count, -1), axis=0, ddof=1))
        ap = self.by_class(subsets).ap
        errors = np.sqrt(ap * (1 - ap)) * [model.error for model in self.models]
        return np.hypot(fit, np.nan_to_num(errors).max(axis=1))

    def doubts(self, sensors: Iterable[str] = ()) -> tuple[str, ...]:
        """Sentences on how candidates and objects exceed the fitted data, empty if they do not.

        sensors: Names of the classes of the candidates' sensor models."""
        sentences: dict[str, None] = {}
        for part in self._parts:
            if part.model.domain is not None:
                seen = part.evidence.visibility
                sentences |= dict.fromkeys(
                    part.model.domain.outside(seen.points, seen.distance, sensors)
                )
        return tuple(sentences)


def _choose_models(
    scheme: Scheme, model: HitModel | Sequence[HitModel] | None, classes: Classes, iou: float
) -> tuple[HitModel, ...]:
    """Hit model of each class, from those given or the shipped ones.

    Arguments are as in `Surrogate`. Raises ValueError for a missing one, or one of another
    scheme."""
    name = surrogate_name(scheme)
    if model is None:
        model = [
            shipped_model(name, classes.get_iou(class_name, iou), label=class_name)
            for class_name in classes.names
        ]
    models = [model] if isinstance(model, HitModel) else model
    by_label = {class_model.label: class_model for class_model in models}
    for class_model in by_label.values():
        if class_model.scheme not in (scheme.name, name):
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

    def __init__(self, model: HitModel, boxes: Float64[np.ndarray, "O 7"]) -> None:
        self.model = model
        self.boxes = boxes

    @cached_property
    def factor(self) -> Float64[np.ndarray, " O"]:
        """Factor of each object, 1 unless it is bulky."""
        return self.model.of_size(self.boxes)

    @cached_property
    def single(self) -> Float32[np.ndarray, " O"]:
        """Factor of each object in single precision."""
        return self.factor.astype(np.float32)

    @cached_property
    def resampled(self) -> list[Float32[np.ndarray, " O"]]:
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
        self.evidence = evidence
        self.sizes = sizes
        self.model = sizes.model
        self.sums = MemberSums(evidence.rows(self.model))
        self.objects = evidence.visibility.points.shape[1]

    def powers(self) -> Float32[np.ndarray, "C O"]:
        # n ^ norm of each candidate and object; with a floor the rows hold N ^ norm after it, and
        # in hybrid fusion the centre's points too
        if self.sums.rows.shape[1] != self.objects * (2 if self.model.floor > 0 else 1):
            raise ValueError(
                "in hybrid fusion evidence is no sum over sensors: say --scheme early or late"
            )
        return self.sums.rows[:, : self.objects].copy()

    def expected(self, subsets: Sets) -> Float64[np.ndarray, "2 n"]:
        """AP and recall (rows) of each set by the formula of this module, NaN without an object."""
        figures = np.full((2, len(subsets)), np.nan)
        for block, sums in self.sums.blocks(subsets if self.objects else subsets[:0]):
            if self.model.floor > 0 or self.model.bulk:
                probability = self.probability(sums)
                probability.sort(axis=1)
                probability = probability[:, ::-1]
            else:
                # without floor and sizes, p grows with the evidence: sorting this is the same
                powers, _ = self.evidence.joined(sums, self.model)
                powers.sort(axis=1)
                probability = self.model.probability(powers[:, ::-1])
            figures[:, block] = compute_expected_ap(probability, self.model.false_alarms)
        return figures

    def resampled(
        self, subsets: Bool[np.ndarray, "n C"], count: int
    ) -> Float64[np.ndarray, "count n"]:
        """AP of each set by each of the first `count` resampled fits, NaN without an object."""
        if not self.objects:
            return np.full((count, len(subsets)), np.nan)
        models = self.model.resamples[:count]
        seen = self.evidence
        rows = [seen.rows(model) for model in models]
        sums = MemberSums(np.concatenate(rows, axis=1))(subsets)
        parts = np.split(sums, np.cumsum([columns.shape[1] for columns in rows])[:-1], axis=1)
        probability = np.stack(
            [
                model.probability(*seen.joined(part, model)) * sizes
                for model, part, sizes in zip(
                    models, parts, self.sizes.resampled[:count], strict=True
                )
            ]
        )
        probability.sort(axis=2)
        alarms = np.repeat([model.false_alarms for model in models], len(subsets)).astype(
            np.float32
        )
        ap, _ = compute_expected_ap(
            probability[:, :, ::-1].reshape(len(alarms), -1), alarms[:, None]
        )
        return ap.reshape(count, -1)

    def probability(self, sums: Float32[np.ndarray, "n w"]) -> Float32[np.ndarray, "n O"]:
        """Hit probability of each object for each of n sets.

        sums: Sums of `Evidence.rows` over the members of each set."""
        probability = self.model.probability(*self.evidence.joined(sums, self.model))
        probability *= self.sizes.single
        return probability


def compute_expected_ap(
    probability: Float[np.ndarray, "n O"], false_alarms: float | Float32[np.ndarray, "n 1"]
) -> tuple[Float64[np.ndarray, " n"], Float64[np.ndarray, " n"]]:
    """Expected AP and recall of n sets by the formula of this module; 0 without an object.

    Args:
        probability: Hit probability of each object, in descending order for each set.
        false_alarms: λ of the formula, one for all sets or a column with one for each."""
    n, objects = probability.shape
    if not objects:
        return np.zeros(n), np.zeros(n)
    hits = np.cumsum(probability, axis=1)
    recall = hits[:, -1].astype(np.float64) / objects
    reported = hits + false_alarms * (np.arange(1, objects + 1, dtype=hits.dtype) - hits)
    np.divide(hits, reported, out=hits, where=reported > 0)
    return np.einsum("no,no->n", probability, hits).astype(np.float64) / objects, recall


def resample_ap(
    probability: Float64[np.ndarray, " O"],
    false_alarms: float,
    draws: Float32[np.ndarray, "n B"],
    block: Int64[np.ndarray, " O"],
) -> Float64[np.ndarray, " n"]:
    """AP of one set in n resamples of the traffic, NaN for a resample without an object.

    It follows the formula of this module, with each object as often as its block is drawn.

    Args:
        probability: Hit probability of each object.
        false_alarms: λ of the formula.
        draws: How often each of B blocks is drawn in each resample.
        block: Index of each object's block."""
    order = np.argsort(-probability, kind="stable")
    # (B, O): 1 for the objects of each block, best objects first
    in_block = (block[order] == np.arange(draws.shape[1])[:, None]).astype(np.float32)
    expected = in_block * probability[order].astype(np.float32)
    hits = np.cumsum(expected, axis=1)
    reported = np.cumsum(expected + np.float32(false_alarms) * (in_block - expected), axis=1)
    area = np.zeros(len(draws), np.float32)
    at_once = max(1, MAX_ONE_THREAD_PRODUCT // max(in_block.size, 1))
    for first in range(0, len(draws), at_once):
        part = draws[first : first + at_once]
        precision = part @ hits
        # 0 where nothing is found yet
        precision /= np.maximum(part @ reported, np.finfo(np.float32).tiny)
        area[first : first + at_once] = ((precision @ expected.T) * part).sum(axis=1)
    objects = draws @ in_block.sum(axis=1)
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
    def _pooled(self) -> Bool[np.ndarray, "C O"] | None:
        # pairs whose points the centre gets in addition to boxes; None in a scheme without such
        return self.scheme.mask_pooled(self.visibility.distance, self.radius)

    @cached_property
    def _place(self) -> tuple[Float32[np.ndarray, "C O"], Float64[np.ndarray, " O"]]:
        """Distance of each pair in units of 20 m, at least 1 m; |sin 2ψ| of each object's yaw ψ."""
        seen = self.visibility
        return np.maximum(seen.distance, 1) / 20, np.abs(np.sin(2 * seen.boxes[:, 6]))

    def rows(self, model: HitModel, dtype: type = np.float32) -> Float[np.ndarray, "C w"]:
        """Columns of each candidate that are summed over the members of a set.

        These are n ^ norm of each object; in hybrid fusion then n of each object whose points the
        centre gets, else 0. If the model has a floor the same follows for N, the mere points.

        dtype: Type of the result, float64 for a fit."""
        points: np.ndarray = self.visibility.points.astype(dtype)
        away, aside = self._place
        raw = self._columns(points, model) if model.floor > 0 else []
        points *= away.astype(dtype, copy=False) ** model.reach
        points *= np.exp(-model.oblique * aside).astype(dtype)
        columns = [*self._columns(points, model), *raw]
        return columns[0] if len(columns) == 1 else np.concatenate(columns, axis=1)

    def _columns(self, points: np.ndarray, model: HitModel) -> list[np.ndarray]:
        # columns of `rows` for n or N
        powers = np.minimum(points, MAX_OBJECT_POINTS) ** model.norm
        return [powers] if self._pooled is None else [powers, np.where(self._pooled, points, 0)]

    def joined(
        self, sums: Float[np.ndarray, "n w"], model: HitModel
    ) -> tuple[Float[np.ndarray, "n O"], Float[np.ndarray, "n O"] | None]:
        """Σ n_i ^ norm, and Σ N_i ^ norm if the model has a floor (else None), of n sets.

        sums: Sums of `rows` over the members of each set, for the same model."""
        if model.floor > 0:
            dense, raw = np.split(sums, 2, axis=1)
            return self._with_centre(dense, model), self._with_centre(raw, model)
        return self._with_centre(sums, model), None

    def _with_centre(
        self, sums: Float[np.ndarray, "n w"], model: HitModel
    ) -> Float[np.ndarray, "n O"]:
        # Σ over the sensors, and the centre as one more in hybrid fusion
        if self._pooled is None:
            return sums
        near, centre = np.split(sums, 2, axis=1)
        return near + centre**model.norm
