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

from placement_env.classes import VEHICLES, Classes
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
# multiplications that BLAS does in one thread: waiting for a busy core takes far longer
MAX_ONE_THREAD_PRODUCT = 1 << 18


class Surrogate:
    """Expected AP of sets of the candidates of `visibility`, by a hit model of each class.

    model: Model of vehicles or of each class, None for the shipped ones of `scheme` at the IoU
    threshold of the class; radius: hybrid radius of the site (m); codec: codec of the data sent;
    classes: classes of objects that count, several combined. Raises ValueError for a model that is
    missing or of another scheme."""

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
        """Surrogate with the same models over another view of the same traffic."""
        surrogate = copy(self)
        surrogate._look(visibility, [part.sizes for part in self._parts])
        return surrogate

    def _look(self, visibility: Visibility, sizes: Sequence["_SizeFactors | None"]) -> None:
        """Take the view of the candidates. sizes: factors of each class in another view."""
        visibility = visibility.of_classes(self.classes.labels)
        self._parts = []
        for label, model, known_sizes in zip(self.classes.labels, self.models, sizes, strict=True):
            seen = visibility if len(self.classes) == 1 else visibility.of_classes([label])
            if known_sizes is None or known_sizes.boxes is not seen.boxes:
                known_sizes = _SizeFactors(model, seen.boxes)
            self._parts.append(_Part(Evidence(seen, self._scheme, self._radius), known_sizes))
        self._sent = SentData(visibility, self._scheme, self._codec)

    def __call__(self, subsets: Sets, /) -> Estimate:
        """Expected AP and recall of each set."""
        return self.by_class(subsets).combined(self.classes).without_nan()

    def by_class(self, subsets: Sets, /) -> ClassEstimates:
        """Expected AP and recall of each class; NaN without objects."""
        ap, recall = np.stack([part.expected(subsets) for part in self._parts], axis=2)
        return ClassEstimates(ap, recall, self._sent.kbit(subsets))

    def hits(self, subset: Bool[np.ndarray, " C"]) -> list[Float64[np.ndarray, " _"]]:
        """Probability that a set hits each object, by class, in the order of the class's
        objects."""
        return [
            part.probability(part.sums(subset[None]))[0].astype(np.float64) for part in self._parts
        ]

    def evidence(
        self,
    ) -> list[tuple[Float32[np.ndarray, "C O"], Float64[np.ndarray, " O"], HitModel, float]]:
        """Evidence n ^ norm of each candidate and object, by class.

        It comes with the factor of an object's size on its hit probability, the model of the class,
        and its weight among classes. Raises ValueError where the centre's data make it no sum over
        sensors."""
        has_objects = np.array([part.objects > 0 for part in self._parts])
        weights = np.where(has_objects, self.classes.weights, 0.0)
        shares = weights / max(float(weights.sum()), 1e-300)
        return [
            (part.powers(), part.sizes.factor, part.model, float(share))
            for part, share in zip(self._parts, shares, strict=True)
            if part.objects
        ]

    def in_frames(self, frames: Int64[np.ndarray, " _"]) -> "Surrogate":
        """Surrogate over some of the frames, ascending; kbit are still the mean of all frames."""
        surrogate = copy(self)
        surrogate._parts = []
        for part in self._parts:
            seen = of_frames(part.evidence.visibility, frames)
            evidence = replace(part.evidence, visibility=seen)
            surrogate._parts.append(_Part(evidence, _SizeFactors(part.model, seen.boxes)))
        return surrogate

    def spread(self, subsets: Sets) -> Float64[np.ndarray, " n"]:
        """Standard error of each set's AP: of the fit, from its resamples, and against the
        detector, the greatest of a class; NaN where a model knows neither."""
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
        """Sentences on differences from the fitted data. sensors: kinds of their models."""
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
    """Hit model of each class. Raises ValueError for a missing one, or one of another scheme."""
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
    """Factors of the sizes of objects on their hit probabilities, by one model."""

    def __init__(self, model: HitModel, boxes: Float64[np.ndarray, "O 7"]) -> None:
        self.model = model
        self.boxes = boxes

    @cached_property
    def factor(self) -> Float64[np.ndarray, " O"]:
        """Factor of each object."""
        return self.model.of_size(self.boxes)

    @cached_property
    def single(self) -> Float32[np.ndarray, " O"]:
        """Factor of each object in single precision."""
        return self.factor.astype(np.float32)

    @cached_property
    def resampled(self) -> list[Float32[np.ndarray, " O"]]:
        """Factor of each object by each resample of the fit."""
        return [model.of_size(self.boxes).astype(np.float32) for model in self.model.resamples]


class _Part:
    """Objects of one class, and their model."""

    def __init__(self, evidence: "Evidence", sizes: _SizeFactors) -> None:
        self.evidence = evidence
        self.sizes = sizes
        self.model = sizes.model
        self.sums = MemberSums(evidence.rows(self.model))
        self.objects = evidence.visibility.points.shape[1]

    def powers(self) -> Float32[np.ndarray, "C O"]:
        if self.sums.rows.shape[1] != self.objects * (2 if self.model.floor > 0 else 1):
            raise ValueError(
                "in hybrid fusion evidence is no sum over sensors: say --scheme early or late"
            )
        return self.sums.rows[:, : self.objects].copy()

    def expected(self, subsets: Sets) -> Float64[np.ndarray, "2 n"]:
        """AP and recall of each set, NaN without an object."""
        figures = np.full((2, len(subsets)), np.nan)
        for block, sums in self.sums.blocks(subsets if self.objects else subsets[:0]):
            if self.model.floor > 0 or self.model.bulk:
                probability = self.probability(sums)
                probability.sort(axis=1)
                probability = probability[:, ::-1]
            else:
                powers, _ = self.evidence.joined(sums, self.model)
                powers.sort(axis=1)
                probability = self.model.probability(powers[:, ::-1])
            figures[:, block] = compute_expected_ap(probability, self.model.false_alarms)
        return figures

    def resampled(
        self, subsets: Bool[np.ndarray, "n C"], count: int
    ) -> Float64[np.ndarray, "count n"]:
        """AP of each set by the first resamples of the fit, NaN without an object."""
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
        """Hit probability of each object, from the sums of each set's rows."""
        probability = self.model.probability(*self.evidence.joined(sums, self.model))
        probability *= self.sizes.single
        return probability


def compute_expected_ap(
    probability: Float[np.ndarray, "n O"], false_alarms: float | Float32[np.ndarray, "n 1"]
) -> tuple[Float64[np.ndarray, " n"], Float64[np.ndarray, " n"]]:
    """AP and recall by the formula above, from hit probabilities in descending order."""
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
    """AP by the formula above where the objects of each block occur as often as it is drawn; NaN
    without any."""
    order = np.argsort(-probability, kind="stable")
    # objects of each block
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

    radius: the site's hybrid radius (m). The sums of `rows` over a set, `joined`, are the model's Σ
    n_i ^ norm and, where it has a floor, Σ N_i ^ norm. Where points reach the centre beside boxes,
    it counts as one more sensor that holds them all."""

    visibility: Visibility
    scheme: Scheme
    radius: float

    @cached_property
    def _pooled(self) -> Bool[np.ndarray, "C O"] | None:
        return self.scheme.mask_pooled(self.visibility.distance, self.radius)

    @cached_property
    def _place(self) -> tuple[Float32[np.ndarray, "C O"], Float64[np.ndarray, " O"]]:
        """Distance in 20 m, and how far each object is turned from both axes."""
        seen = self.visibility
        return np.maximum(seen.distance, 1) / 20, np.abs(np.sin(2 * seen.boxes[:, 6]))

    def rows(self, model: HitModel, dtype: type = np.float32) -> Float[np.ndarray, "C w"]:
        """Evidence n ^ norm, beside it n where the centre gets the points, then both of N where
        there is a floor."""
        points: np.ndarray = self.visibility.points.astype(dtype)
        away, aside = self._place
        raw = self._columns(points, model) if model.floor > 0 else []
        points *= away.astype(dtype, copy=False) ** model.reach
        points *= np.exp(-model.oblique * aside).astype(dtype)
        columns = [*self._columns(points, model), *raw]
        return columns[0] if len(columns) == 1 else np.concatenate(columns, axis=1)

    def _columns(self, points: np.ndarray, model: HitModel) -> list[np.ndarray]:
        powers = np.minimum(points, MAX_OBJECT_POINTS) ** model.norm
        return [powers] if self._pooled is None else [powers, np.where(self._pooled, points, 0)]

    def joined(
        self, sums: Float[np.ndarray, "n w"], model: HitModel
    ) -> tuple[Float[np.ndarray, "n O"], Float[np.ndarray, "n O"] | None]:
        """Σ n_i ^ norm, and Σ N_i ^ norm where the model has a floor, from the sums of the members'
        rows."""
        if model.floor > 0:
            dense, raw = np.split(sums, 2, axis=1)
            return self._with_centre(dense, model), self._with_centre(raw, model)
        return self._with_centre(sums, model), None

    def _with_centre(
        self, sums: Float[np.ndarray, "n w"], model: HitModel
    ) -> Float[np.ndarray, "n O"]:
        if self._pooled is None:
            return sums
        near, centre = np.split(sums, 2, axis=1)
        return near + centre**model.norm
