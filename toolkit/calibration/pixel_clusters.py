"""Clusters of the measurements of each pixel over time.

Sorted measurements fall into clusters wherever two neighbours are farther apart than noise
explains; "nothing returned" is a cluster too, the farthest one."""

from collections.abc import Callable, Sequence
from functools import partial
from itertools import product
from typing import NamedTuple

import numpy as np

from toolkit.arrays import Float32, ImageMask, ImageRanges
from toolkit.sensors.sensor import SensorModel, is_return

SIGMAS = 4.0  # spreads: a measurement this near a median shows the empty scene
LEAST_SHARE = 0.1  # fraction of the measurements that makes a cluster part of the scene
HALF = 0.5  # fraction of the measurements that makes a surface before no return part of the scene
# gap between clusters: standard deviations of the model, share of the measurement
GAP_SIGMAS = 4.0
GAP_SHARE = 0.004
BROAD = 2.0  # times the usual spread at a distance: a broader cluster is more than one surface
DISTANCES = 24  # steps of log distance, each with a usual spread
NEIGHBOURS = 2  # pixels: a surface continues this far
OTHER_SURFACE = (
    0.1  # fraction by which a depth must leave the plane through two others to be another surface
)
LEAST_FLICKER = (
    0.25  # least rate at which a part of the scene comes and goes, relative to random draws
)
_MAD_TO_SIGMA = 1.4826
_AT_ONCE = 256  # pixels whose measurements are compared in pairs at once


class PixelMode(NamedTuple):
    """One cluster per pixel."""

    median: ImageRanges  # 0 for nothing returned, NaN for no cluster
    spread: ImageRanges
    share: ImageRanges
    least: ImageRanges  # extreme measurements
    greatest: ImageRanges

    def reshape(self, shape: tuple[int, ...]) -> "PixelMode":
        """Return the same mode as images of a shape."""
        return PixelMode(*(column.reshape(shape) for column in self))

    def where(self, mask: ImageMask, outside: "PixelMode") -> "PixelMode":
        """Return this mode inside the mask, the other outside."""
        return PixelMode(
            *(
                np.where(mask, inside_image, outside_image)
                for inside_image, outside_image in zip(self, outside, strict=True)
            )
        )


def find_clusters(
    images: Float32[np.ndarray, "n rows columns"], model: SensorModel
) -> tuple[PixelMode, PixelMode, ImageMask]:
    """Find each pixel's farthest cluster of the scene, the largest nearer one, and a mask where
    that flickers."""
    shape = images.shape[1:]
    n = len(images)
    # a row for each pixel
    in_time = np.where(is_return(images, model.max_range), images, np.inf).reshape(n, -1).T
    values = np.sort(in_time)
    solid = np.where(np.isfinite(values), values, np.float32(0))
    gap = np.maximum(GAP_SIGMAS * np.asarray(model.deviation(solid)), GAP_SHARE * solid)[:, :-1]
    begins = np.ones(values.shape, bool)
    with np.errstate(invalid="ignore"):  # two missing returns are infinity less infinity: no gap
        begins[:, 1:] = values[:, 1:] - values[:, :-1] > gap
    starts = np.flatnonzero(begins)
    ends = np.append(starts[1:], values.size)
    pixel = starts // n
    size = ends - starts
    enough = size >= min(n, max(2, int(np.ceil(LEAST_SHARE * n))))
    number = np.arange(len(starts))

    def pick(rank: np.ndarray, eligible: np.ndarray) -> np.ndarray:
        """Pick each pixel's eligible cluster of highest rank."""
        order = np.lexsort((number, rank, eligible, pixel))
        return order[np.searchsorted(pixel[order], np.arange(len(values)), side="right") - 1]

    far = pick(np.where(enough, number, size), enough)
    rivals = enough & (number < far[pixel])
    near = pick(size, rivals)
    nearest, farthest = (
        values.ravel()[indices][:, None] for indices in (starts[near], ends[near] - 1)
    )
    present = (in_time >= nearest) & (in_time <= farthest)
    share = present.mean(axis=1)
    comes = (present[:, 1:] & ~present[:, :-1]).sum(axis=1) + present[:, 0]
    flickers = rivals[near] & (comes >= LEAST_FLICKER * share * (1 - share) * n)
    measure = partial(_measure_mode, solid.ravel(), starts, ends, n=n, model=model)
    far_mode = measure(far).reshape(shape)
    near_mode = measure(np.where(rivals[near], near, -1)).reshape(shape)
    return far_mode, near_mode, flickers.reshape(shape)


def _measure_mode(
    values: np.ndarray,
    starts: np.ndarray,
    ends: np.ndarray,
    cluster: np.ndarray,
    n: int,
    model: SensorModel,
) -> PixelMode:
    """Measure one chosen cluster (-1: none) of every pixel."""
    first = starts[cluster]
    last = ends[cluster]
    size = last - first
    median = (values[first + (size - 1) // 2] + values[first + size // 2]) / 2
    offset = np.arange(n)
    inside = offset < size[:, None]
    members = values[np.minimum(first[:, None] + offset, len(values) - 1)]
    deviation = np.sort(np.where(inside, np.abs(members - median[:, None]), np.float32(np.inf)))
    row = np.arange(len(cluster))
    typical = (deviation[row, (size - 1) // 2] + deviation[row, size // 2]) / 2
    spread = np.maximum(_MAD_TO_SIGMA * typical, np.asarray(model.deviation(median)))
    exists = cluster >= 0
    figures = (exists, median, np.nan), (exists & (median > 0), spread, 0), (exists, size / n, 0)
    ends_of = (np.where(exists, values[index], 0) for index in (first, last - 1))
    return PixelMode(*(np.where(*figure).astype(np.float32) for figure in figures), *ends_of)


def usual_spread(far: PixelMode, model: SensorModel) -> Callable[[ImageRanges], ImageRanges]:
    """Return the usual spread as a function of distance, from pixels that mostly see the scene."""
    clear = (far.share >= HALF) & (far.median > 0)
    distance = np.log(far.median[clear])
    spread = far.spread[clear]
    if not len(distance):
        return lambda median: np.broadcast_to(model.deviation(np.nan_to_num(median)), median.shape)
    edges = np.linspace(distance.min(), distance.max() + 1e-6, DISTANCES + 1)
    step = np.digitize(distance, edges)
    steps = np.unique(step)
    usual = [np.median(spread[step == k]) for k in steps]
    middle = [np.median(distance[step == k]) for k in steps]

    def at(median: ImageRanges) -> ImageRanges:
        log_distance = np.log(np.where(median > 0, median, 1))
        return np.maximum(
            np.interp(log_distance, middle, usual), model.deviation(np.nan_to_num(median))
        ).astype(np.float32)

    return at


def narrow_broad(mode: PixelMode, usual: ImageRanges, images: Sequence[ImageRanges]) -> PixelMode:
    """Replace broad clusters by their densest stretch, `SIGMAS` usual spreads wide to either
    side."""
    narrowed = PixelMode(*(raster.copy() for raster in mode))
    broad_pixels = np.flatnonzero(mode.spread > BROAD * usual)
    for start in range(0, len(broad_pixels), _AT_ONCE):
        broad = broad_pixels[start : start + _AT_ONCE]
        lowest, greatest, spread = (
            raster.ravel()[broad][:, None] for raster in (mode.least, mode.greatest, usual)
        )
        values = np.stack([image.ravel()[broad] for image in images], axis=1)
        values = np.sort(np.where((values >= lowest) & (values <= greatest), values, np.inf))
        rank = np.arange(values.shape[1])
        row = np.arange(len(broad))
        within = values[:, None, :] <= values[:, :, None] + 2 * SIGMAS * spread[:, :, None]
        count = np.where(np.isfinite(values), within.sum(axis=2) - rank, 0)
        begin = rank[-1] - count[:, ::-1].argmax(axis=1)  # the farthest of the densest
        size = count[row, begin]
        median = (values[row, begin + (size - 1) // 2] + values[row, begin + size // 2]) / 2
        inside = (rank >= begin[:, None]) & (rank < (begin + size)[:, None])
        deviation = np.sort(np.where(inside, np.abs(values - median[:, None]), np.inf))[
            row, (size - 1) // 2
        ]
        narrowed.median.ravel()[broad] = median
        narrowed.spread.ravel()[broad] = np.clip(
            _MAD_TO_SIGMA * deviation, spread[:, 0], BROAD * spread[:, 0]
        )
        narrowed.share.ravel()[broad] = size / len(images)
    return narrowed


def mark_continuation(near: PixelMode, far: ImageRanges) -> ImageMask:
    """Mark pixels whose nearer surface continues a neighbour's farthest, at most `NEIGHBOURS` off,
    but not their own, as ground goes on below the foot of a car: planes have inverse depths that
    are linear in the image."""
    within = np.maximum(SIGMAS * near.spread, GAP_SHARE * near.median)
    inverse = np.where(far > 0, 1 / np.where(far > 0, far, 1), 0)
    padded = np.pad(far, NEIGHBOURS, constant_values=np.nan)
    opposite = np.pad(inverse, NEIGHBOURS, mode="edge")
    rows, columns = far.shape
    same = np.zeros(far.shape, bool)
    for down, right in product(range(-NEIGHBOURS, NEIGHBOURS + 1), repeat=2):
        beyond = padded[NEIGHBOURS + down :, NEIGHBOURS + right :][:rows, :columns]
        opposite_inverse = opposite[NEIGHBOURS - down :, NEIGHBOURS - right :][:rows, :columns]
        other_surface = np.abs((2 * inverse - opposite_inverse) * beyond - 1) > OTHER_SURFACE
        same |= (np.abs(beyond - near.median) <= within) & other_surface
    return same
