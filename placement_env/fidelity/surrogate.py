"""`Surrogate`: AP of sensor sets predicted from points.

It uses the number of points that their sensors have on each object. A `HitModel` gives each object's probability p of
being hit. Objects are ranked by it, as by a detector's scores. Down to the i-th of them, T_i = p_1 + ... + p_i hits are
expected and λ (i - T_i) false alarms, λ being the model's `false_alarms`. The area under that expected precision-recall
curve of O objects is

    AP = 1/O Σ_i p_i · T_i / (T_i + λ (i - T_i)),      recall = T_O / O
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from copy import copy

import numpy as np

from placement_env.classes import VEHICLES, Classes
from placement_env.fidelity.coverage import LEAST
from placement_env.fidelity.hits.hit_model import HitModel, shipped_model
from placement_env.fidelity.visibility import Visibility, of_frames
from placement_env.protocol import ClassEstimates, Estimate
from placement_env.subsets import MemberSums
from toolkit.arrays import Bool, Float, Float32, Float64, Int64
from toolkit.detection.codec import PAPER, Codec
from toolkit.detection.scheme import Scheme, estimate_bits, surrogate_name
from toolkit.detection.schemes import find_scheme
from toolkit.sites.site import HYBRID_RADIUS

MOST_POINTS = 1e5  # points on an object: powers and their sums fit float32


class Surrogate:
    """Sets of the candidates of `visibility` scored by models.

    There is one model per class; the default is the shipped one of `scheme` at the IoU threshold of the class. model:
    of vehicles, or one of each class; radius: the site's hybrid radius (m); codec: of the data sent; classes: of the
    objects that count, several combined. Raises ValueError where a model is of another scheme or missing.
    """

    name = "surrogate"

    def __init__(
        self,
        visibility: Visibility,
        scheme: Scheme | str = "early",
        model: HitModel | Sequence[HitModel] | None = None,
        *,
        iou: float = 0.7,
        radius: float = HYBRID_RADIUS,
        codec: Codec = PAPER,
        classes: Classes = VEHICLES,
    ) -> None:
        scheme, self.classes = find_scheme(scheme), classes
        visibility = visibility.of_classes(classes.labels)
        if model is None:
            model = [
                shipped_model(surrogate_name(scheme), classes.get_iou(name, iou), label=name) for name in classes.names
            ]
        models = [model] if isinstance(model, HitModel) else model
        for each in models:
            if each.scheme not in (scheme.name, surrogate_name(scheme)):
                raise ValueError(f"the model is for {each.scheme} fusion, not for {scheme.name}: pass one fitted to it")
        by_label = {each.label: each for each in models}
        if missing := [name for name in classes.names if name not in by_label]:
            raise ValueError(f"there is no model of {', '.join(missing)}: pass one fitted to each class")
        self.models = tuple(by_label[name] for name in classes.names)
        self._parts = [
            _Part(visibility.of_classes([label]), scheme, radius, of_class)
            for label, of_class in zip(classes.labels, self.models, strict=True)
        ]
        boxes = (visibility.points >= LEAST).sum(axis=1).astype(np.float64)
        self._bits = estimate_bits(scheme, codec, visibility, boxes)
        self._frames = visibility.frames

    def __call__(self, subsets: Bool[np.ndarray, "n C"], /) -> Estimate:
        """Expected AP and recall of each set. Several classes are combined; 0 without an object."""
        if len(self.classes) > 1:
            estimate = self.by_class(subsets).combined(self.classes)
            return Estimate(np.nan_to_num(estimate.ap), np.nan_to_num(estimate.recall), estimate.kbit)
        ap, recall = self._parts[0].expected(subsets)
        return Estimate(ap, recall, self._kbit(subsets))

    def by_class(self, subsets: Bool[np.ndarray, "n C"], /) -> ClassEstimates:
        """Expected AP and recall of each class. NaN where the class has no objects."""
        figures = [part.expected(subsets) for part in self._parts]
        for part, (ap, recall) in zip(self._parts, figures, strict=True):
            if not part.objects:
                ap[:] = recall[:] = np.nan
        ap, recall = (np.stack(each, axis=1) for each in zip(*figures, strict=True))
        return ClassEstimates(ap, recall, self._kbit(subsets))

    def evidence(self) -> list[tuple[Float32[np.ndarray, "C O"], Float64[np.ndarray, " O"], HitModel, float]]:
        """Evidence n ^ norm, by class.

        It is for each candidate and object. It comes with the factor of an object's size on its hit probability, the
        model of the class, and its weight among classes. Raises ValueError where the centre's data make it no sum over
        sensors.
        """
        weights = np.array(self.classes.weights)
        there = np.array([part.objects > 0 for part in self._parts])
        shares = np.where(there, weights, 0.0) / max(float(weights[there].sum()), 1e-300)
        return [
            (part.powers(), model.of_size(part.visibility.boxes), model, float(share))
            for part, model, share in zip(self._parts, self.models, shares, strict=True)
            if part.objects
        ]

    def in_frames(self, frames: Int64[np.ndarray, " _"]) -> Surrogate:
        """Same surrogate over some of the frames. Frames are ascending; kbit stay those of all."""
        other = copy(self)
        other._parts = [part.in_frames(frames) for part in self._parts]
        return other

    def spread(self, subsets: Bool[np.ndarray, "n C"]) -> Float64[np.ndarray, " n"]:
        """Standard deviation of each set's AP over resamples.

        The resamples are of the fit; NaN where a model has none. Effects outside the models are not included.
        """
        count = min(len(model.resampled) for model in self.models)
        if count < 2:
            return np.full(len(subsets), np.nan)
        drawn = []
        for k in range(count):
            models = [model.resamples[k] for model in self.models]
            parts = [part.with_model(model) for part, model in zip(self._parts, models, strict=True)]
            figures = np.stack([part.expected(subsets)[0] for part in parts], axis=1)
            empty = np.array([not part.objects for part in parts])
            drawn.append(self.classes.combined(np.where(empty, np.nan, figures)))
        return np.nan_to_num(np.std(drawn, axis=0, ddof=1))

    def doubts(self, sensors: Iterable[str] = ()) -> tuple[str, ...]:
        """Sentences on differences from the fitted data. sensors: kinds of their models."""
        said: dict[str, None] = {}
        for part, model in zip(self._parts, self.models, strict=True):
            if model.domain is not None:
                said |= dict.fromkeys(model.domain.outside(part.visibility.points, part.visibility.distance, sensors))
        return tuple(said)

    def _kbit(self, subsets: Bool[np.ndarray, "n C"]) -> Float64[np.ndarray, " n"]:
        return np.asarray(subsets @ self._bits / (1000 * self._frames))


class _Part:
    """Objects of one class, and their model."""

    def __init__(self, visibility: Visibility, scheme: Scheme, radius: float, model: HitModel) -> None:
        self.visibility, self._scheme, self._radius = visibility, scheme, radius
        self._model, self._evidence = model, Evidence(visibility, scheme, radius)
        self._sums = MemberSums(self._evidence.rows(model))
        self._of_size = model.of_size(visibility.boxes).astype(np.float32)
        self.objects = visibility.points.shape[1]

    def powers(self) -> Float32[np.ndarray, "C O"]:
        """n ^ norm of each candidate and object."""
        if self._sums.rows.shape[1] != self.objects * (2 if self._model.floor > 0 else 1):
            raise ValueError("in hybrid fusion evidence is no sum over sensors: say --scheme early or late")
        return self._sums.rows[:, : self.objects].copy()

    def with_model(self, model: HitModel) -> _Part:
        """Same objects by another model."""
        return _Part(self.visibility, self._scheme, self._radius, model)

    def in_frames(self, frames: Int64[np.ndarray, " _"]) -> _Part:
        """Objects in some of the frames."""
        return _Part(of_frames(self.visibility, frames), self._scheme, self._radius, self._model)

    def expected(self, subsets: Bool[np.ndarray, "n C"]) -> tuple[Float64[np.ndarray, " n"], Float64[np.ndarray, " n"]]:
        """AP and recall of each set."""
        ap, recall = np.zeros(len(subsets)), np.zeros(len(subsets))
        for block, sums in self._sums.blocks(subsets):
            ap[block], recall[block] = self._of_sums(sums)
        return ap, recall

    def _of_sums(self, sums: Float32[np.ndarray, "n w"]) -> tuple[Float64[np.ndarray, " n"], Float64[np.ndarray, " n"]]:
        powers, raw = self._evidence.joined(sums, self._model)
        if raw is None and not self._model.bulk:
            powers.sort(axis=1)
            return compute_expected_ap(self._model.probability(powers[:, ::-1]), self._model.false_alarms)
        probability = self._model.probability(powers, raw)
        probability *= self._of_size
        probability.sort(axis=1)
        return compute_expected_ap(probability[:, ::-1], self._model.false_alarms)


def compute_expected_ap(
    probability: Float[np.ndarray, "n O"], false_alarms: float
) -> tuple[Float64[np.ndarray, " n"], Float64[np.ndarray, " n"]]:
    """AP and recall (n,) by the formula above.

    Hit probabilities come in descending order.

    >>> compute_expected_ap(np.array([[1, 1, 0, 0], [0.5, 0.5, 0.5, 0.5]], np.float32), 1.0)
    (array([0.5 , 0.25]), array([0.5, 0.5]))
    """
    n, objects = probability.shape
    if not objects:
        return np.zeros(n), np.zeros(n)
    hits = np.cumsum(probability, axis=1)
    recall = hits[:, -1].astype(np.float64) / objects
    found = hits + false_alarms * (np.arange(1, objects + 1, dtype=hits.dtype) - hits)
    np.divide(hits, found, out=hits, where=found > 0)
    return np.einsum("no,no->n", probability, hits).astype(np.float64) / objects, recall


class Evidence:
    """Evidence of each candidate on each object.

    Its numbers add up over the members of a set. scheme: how sets fuse; radius: the site's hybrid radius (m). The sums
    of `rows` over a set, `joined`, are the model's Σ n_i ^ norm and, where it has a floor, Σ N_i ^ norm. Where points
    reach the centre beside boxes, it counts as one more sensor that holds them all.
    """

    def __init__(self, visibility: Visibility, scheme: Scheme, radius: float) -> None:
        self._visibility = visibility
        self._pooled = scheme.mask_pooled(visibility.distance, radius)

    def rows(self, model: HitModel, dtype: type = np.float32) -> Float[np.ndarray, "C w"]:
        """Evidence n ^ norm of each candidate and object.

        Where the centre gets the points too, n stands beside it; where the model has a floor, so do the same values of
        N.
        """
        seen = self._visibility
        points: np.ndarray = seen.points.astype(dtype)
        raw = self._columns(points, model) if model.floor > 0 else []
        points *= (np.maximum(seen.distance, 1).astype(dtype) / 20) ** model.reach
        points *= np.exp(-model.oblique * np.abs(np.sin(2 * seen.boxes[:, 6]))).astype(dtype)
        columns = [*self._columns(points, model), *raw]
        return columns[0] if len(columns) == 1 else np.concatenate(columns, axis=1)

    def _columns(self, points: np.ndarray, model: HitModel) -> list[np.ndarray]:
        powers = np.minimum(points, MOST_POINTS) ** model.norm
        return [powers] if self._pooled is None else [powers, np.where(self._pooled, points, 0)]

    def joined(
        self, sums: Float[np.ndarray, "n w"], model: HitModel
    ) -> tuple[Float[np.ndarray, "n O"], Float[np.ndarray, "n O"] | None]:
        """Sums of evidence over sets.

        They are Σ n_i ^ norm, and Σ N_i ^ norm where the model has a floor, from the sums of the members' rows.
        """
        if model.floor > 0:
            dense, raw = np.split(sums, 2, axis=1)
            return self._with_centre(dense, model), self._with_centre(raw, model)
        return self._with_centre(sums, model), None

    def _with_centre(self, sums: Float[np.ndarray, "n w"], model: HitModel) -> Float[np.ndarray, "n O"]:
        if self._pooled is None:
            return sums
        near, centre = np.split(sums, 2, axis=1)
        return near + centre**model.norm
