"""Clusters of the measurements of each pixel over time.

Sorted measurements fall into clusters wherever two neighbours are farther apart than noise
explains; "nothing returned" is a cluster too, the farthest one."""

from collections.abc import Callable, Sequence
from itertools import product
from typing import NamedTuple

import numpy as np

from toolkit.arrays import Bool, Float32, ImageMask, ImageRanges, Int64
from toolkit.sensors.sensor import SensorModel, is_return

SCENE_SIGMAS = 4.0  # spreads; a measurement this near a median shows the empty scene
MIN_CLUSTER_SHARE = 0.1  # share of the measurements in a cluster of the scene
MIN_OPEN_SHARE = 0.5  # the same, for a surface before no return
GAP_SIGMAS = 4.0  # gap between clusters, in standard deviations of the model
GAP_SHARE = 0.004  # gap between clusters, as a share of the measurement
MAX_SPREAD_RATIO = 2.0  # over the usual spread; a broader cluster is more than one surface
DISTANCE_STEPS = 24  # steps of log distance, each with a usual spread
REACH_PX = 2  # a surface continues this far
# part of the depth by which a third pixel must leave the plane of two others to be another surface
MIN_SURFACE_GAP_SHARE = 0.1
MIN_FLICKER_RATE = 0.25  # rate at which the scene comes and goes, relative to random draws
_MAD_TO_SIGMA = 1.4826  # standard deviation of normal noise over its median absolute deviation
BATCH_PX = 256  # pixels at a time whose measurements are compared in pairs, to limit memory


class PixelMode(NamedTuple):
    """One cluster of each pixel, as images in the unit of the measurements.

    Attributes:
        median: median measurement, 0 for nothing returned, NaN for no cluster.
        spread: standard deviation of the measurements.
        share: share of all the pixel's measurements that are in the cluster, 0 to 1.
        least: smallest measurement.
        greatest: largest measurement.
    """

    median: ImageRanges
    spread: ImageRanges
    share: ImageRanges
    least: ImageRanges
    greatest: ImageRanges

    def reshape(self, shape: tuple[int, ...]) -> "PixelMode":
        """Return the same clusters with each image in another shape."""
        return PixelMode(*(column.reshape(shape) for column in self))

    def where(self, mask: ImageMask, outside: "PixelMode") -> "PixelMode":
        """Return these clusters for pixels inside the mask, the clusters of `outside` elsewhere."""
        pairs = zip(self, outside, strict=True)
        return PixelMode(*(np.where(mask, inner, outer) for inner, outer in pairs))


class _Clusters(NamedTuple):
    """Clusters of all pixels' sorted measurements, one after the other.

    Attributes:
        values: (pixels, n) sorted measurements of each pixel, infinite for nothing returned.
        solid: the same, 0 for nothing returned.
        starts: index of each cluster's first measurement in the flat `values`.
        ends: index after its last one.
        pixel: row in `values` of each cluster, ascending; clusters of a pixel are near to far.
    """

    values: Float32[np.ndarray, "pixels n"]
    solid: Float32[np.ndarray, "pixels n"]
    starts: Int64[np.ndarray, " k"]
    ends: Int64[np.ndarray, " k"]
    pixel: Int64[np.ndarray, " k"]

    @property
    def size(self) -> Int64[np.ndarray, " k"]:
        """Number of measurements in each cluster."""
        return self.ends - self.starts

    def pick(
        self, rank: Int64[np.ndarray, " k"], eligible: Bool[np.ndarray, " k"]
    ) -> Int64[np.ndarray, " pixels"]:
        """Pick each pixel's eligible cluster of highest rank, the farthest of several.

        rank: rank of each cluster; eligible: mask of clusters. A pixel without an eligible cluster
        gets the highest rank of the others. Returns cluster indices, one for each pixel."""
        # the last key counts first: by pixel, the best cluster of each last
        cluster_index = np.arange(len(self.starts))
        order = np.lexsort((cluster_index, rank, eligible, self.pixel))
        pixels = np.arange(len(self.values))
        last_of_pixel = np.searchsorted(self.pixel[order], pixels, side="right") - 1
        return order[last_of_pixel]


def find_clusters(
    images: Float32[np.ndarray, "n rows columns"], model: SensorModel
) -> tuple[PixelMode, PixelMode, ImageMask]:
    """Find each pixel's farthest cluster of the scene and the largest nearer one.

    images: measurements over time, in the model's unit. Returns both clusters of all pixels, and a
    mask of the pixels in which the nearer one exists and comes and goes often enough to flicker."""
    shape = images.shape[1:]
    n = len(images)
    # (pixels, n): a row for each pixel, in order of time; infinite without a return
    in_time = np.where(is_return(images, model.max_range), images, np.inf).reshape(n, -1).T
    clusters = _split_clusters(np.sort(in_time), model)
    size = clusters.size  # number of measurements in each cluster of any pixel
    min_size = min(n, max(2, int(np.ceil(MIN_CLUSTER_SHARE * n))))
    is_enough = size >= min_size
    # `pick` takes for each pixel the cluster of highest rank. Clusters of a pixel are numbered near
    # to far, so the highest number is the farthest.
    cluster_index = np.arange(len(size))
    far_index = clusters.pick(np.where(is_enough, cluster_index, size), is_enough)
    is_nearer = is_enough & (cluster_index < far_index[clusters.pixel])
    near_index = clusters.pick(size, is_nearer)
    has_near = is_nearer[near_index]
    flickers = has_near & _comes_and_goes(clusters, near_index, in_time)
    far_mode = _measure_mode(clusters, far_index, model).reshape(shape)
    near_mode = _measure_mode(clusters, np.where(has_near, near_index, -1), model).reshape(shape)
    return far_mode, near_mode, flickers.reshape(shape)


def _comes_and_goes(
    clusters: _Clusters,
    cluster_index: Int64[np.ndarray, " pixels"],
    in_time: Float32[np.ndarray, "pixels n"],
) -> Bool[np.ndarray, " pixels"]:
    """Mark pixels in which a cluster comes and goes often enough for a part of the scene.

    A part of the scene, such as a leaf, appears and vanishes again and again, a parked car only
    once. Enough is `MIN_FLICKER_RATE` times the number of appearances that is expected if each
    measurement is an independent draw.

    clusters: clusters of all pixels; cluster_index: index of one cluster of each pixel; in_time:
    measurements of each pixel in order of time, in the model's unit, infinite without a return."""
    # the measurements of a cluster follow each other in the flat array, in ascending order
    values = clusters.values.ravel()
    least = values[clusters.starts[cluster_index]][:, None]
    greatest = values[clusters.ends[cluster_index] - 1][:, None]
    is_present = (in_time >= least) & (in_time <= greatest)
    share = is_present.mean(axis=1)
    # times that the cluster appears: in the first measurement, or after another cluster
    arrivals = (is_present[:, 1:] & ~is_present[:, :-1]).sum(axis=1) + is_present[:, 0]
    # In n independent draws with this share, `share * (1 - share) * n` would follow another one.
    return arrivals >= MIN_FLICKER_RATE * share * (1 - share) * in_time.shape[1]


def _split_clusters(values: Float32[np.ndarray, "pixels n"], model: SensorModel) -> _Clusters:
    """Split each pixel's sorted measurements into clusters at gaps that noise does not explain.

    values: (pixels, n) ascending, infinite for nothing returned, so that these are the last
    cluster."""
    finite_values = np.where(np.isfinite(values), values, np.float32(0))
    noise_gap = GAP_SIGMAS * np.asarray(model.deviation(finite_values))
    gap = np.maximum(noise_gap, GAP_SHARE * finite_values)[:, :-1]
    begins = np.ones(values.shape, bool)
    with np.errstate(invalid="ignore"):  # two missing returns are infinity less infinity: no gap
        begins[:, 1:] = values[:, 1:] - values[:, :-1] > gap
    starts = np.flatnonzero(begins)  # flat indices in `values`
    return _Clusters(
        values=values,
        solid=finite_values,
        starts=starts,
        ends=np.append(starts[1:], values.size),
        pixel=starts // values.shape[1],
    )


def _measure_mode(
    clusters: _Clusters, numbers: Int64[np.ndarray, " pixels"], model: SensorModel
) -> PixelMode:
    """Measure one cluster of every pixel.

    numbers: index of each pixel's cluster, -1 for none; such pixels get a median of NaN and zeros.
    Returns flat images, one value for each pixel."""
    n = clusters.values.shape[1]  # frames
    # consecutive and ascending within a cluster
    values = clusters.solid.ravel()
    # a number of -1 reads the last cluster; its figures are replaced at the end
    start = clusters.starts[numbers]
    end = clusters.ends[numbers]
    size = end - start
    # the median is the mean of the two middle values, which are one value if the size is odd
    median = (values[start + (size - 1) // 2] + values[start + size // 2]) / 2
    # (pixels, n): no cluster has more than n members, so most rows end with non-members
    offset = np.arange(n)
    is_member = offset < size[:, None]
    members = values[np.minimum(start[:, None] + offset, len(values) - 1)]
    deviations = np.where(is_member, np.abs(members - median[:, None]), np.float32(np.inf))
    deviations = np.sort(deviations)  # non-members are infinite and come last
    row = np.arange(len(numbers))
    median_deviation = (deviations[row, (size - 1) // 2] + deviations[row, size // 2]) / 2
    spread = np.maximum(_MAD_TO_SIGMA * median_deviation, np.asarray(model.deviation(median)))
    exists = numbers >= 0
    return PixelMode(
        median=np.where(exists, median, np.nan).astype(np.float32),
        spread=np.where(exists & (median > 0), spread, 0).astype(np.float32),
        share=np.where(exists, size / n, 0).astype(np.float32),
        least=np.where(exists, values[start], 0),
        greatest=np.where(exists, values[end - 1], 0),
    )


def usual_spread(far: PixelMode, model: SensorModel) -> Callable[[ImageRanges], ImageRanges]:
    """Return a function that gives the usual spread for an image of median measurements.

    It interpolates the median spread over the logarithm of the distance, and is never below the
    model's noise. far: farthest cluster of each pixel; only pixels that see it in at least
    `MIN_OPEN_SHARE` of the frames count."""
    is_clear = (far.share >= MIN_OPEN_SHARE) & (far.median > 0)
    log_distance = np.log(far.median[is_clear])
    spread = far.spread[is_clear]
    if not len(log_distance):
        return lambda median: np.broadcast_to(model.deviation(np.nan_to_num(median)), median.shape)
    edges = np.linspace(log_distance.min(), log_distance.max() + 1e-6, DISTANCE_STEPS + 1)
    step = np.digitize(log_distance, edges)
    steps = np.unique(step)  # steps without a pixel are left out
    step_spread = [np.median(spread[step == k]) for k in steps]
    step_log_distance = [np.median(log_distance[step == k]) for k in steps]

    def interpolate(median: ImageRanges) -> ImageRanges:
        """Usual spread at each median, with the logarithm of 1 for pixels without a return."""
        pixel_log_distance = np.log(np.where(median > 0, median, 1))
        spreads = np.interp(pixel_log_distance, step_log_distance, step_spread)
        return np.maximum(spreads, model.deviation(np.nan_to_num(median))).astype(np.float32)

    return interpolate


def narrow_broad(mode: PixelMode, usual: ImageRanges, images: Sequence[ImageRanges]) -> PixelMode:
    """Replace clusters that are too broad by their densest stretch.

    Broad is more than `MAX_SPREAD_RATIO` usual spreads; the stretch is `SCENE_SIGMAS` usual spreads
    wide to either side.

    Args:
        mode: one cluster of each pixel.
        usual: usual spread at the cluster's median, for each pixel.
        images: measurements over time that the clusters were found in."""
    narrow_mode = PixelMode(*(image.copy() for image in mode))
    broad_pixels = np.flatnonzero(mode.spread > MAX_SPREAD_RATIO * usual)
    for start in range(0, len(broad_pixels), BATCH_PX):
        pixels = broad_pixels[start : start + BATCH_PX]
        least = mode.least.ravel()[pixels][:, None]
        greatest = mode.greatest.ravel()[pixels][:, None]
        spread = usual.ravel()[pixels]
        # (pixels, n) measurements over time, then sorted: members of the cluster first, infinite
        # values last
        in_time = np.stack([image.ravel()[pixels] for image in images], axis=1)
        is_in_cluster = (in_time >= least) & (in_time <= greatest)
        values = np.sort(np.where(is_in_cluster, in_time, np.inf))
        first, size = _find_densest(values, 2 * SCENE_SIGMAS * spread)
        row = np.arange(len(pixels))
        # the median is the mean of the two middle values, which are one value if the size is odd
        lower_middle = values[row, first + (size - 1) // 2]
        median = (lower_middle + values[row, first + size // 2]) / 2
        rank = np.arange(values.shape[1])
        is_member = (rank >= first[:, None]) & (rank < (first + size)[:, None])
        deviations = np.sort(np.where(is_member, np.abs(values - median[:, None]), np.inf))
        deviation = _MAD_TO_SIGMA * deviations[row, (size - 1) // 2]
        # ravel gives views of the copied images
        narrow_mode.median.ravel()[pixels] = median
        narrow_mode.spread.ravel()[pixels] = np.clip(deviation, spread, MAX_SPREAD_RATIO * spread)
        narrow_mode.share.ravel()[pixels] = size / len(images)
    return narrow_mode


def _find_densest(
    values: Float32[np.ndarray, "pixels n"], width: Float32[np.ndarray, " pixels"]
) -> tuple[Int64[np.ndarray, " pixels"], Int64[np.ndarray, " pixels"]]:
    """Start and size of the densest stretch of sorted values, the farthest of several.

    Args:
        values: sorted values of each pixel, infinite ones last, which do not count.
        width: greatest difference between the first and last value of a stretch, for each pixel."""
    rank = np.arange(values.shape[1])
    row = np.arange(len(values))
    # (pixels, first value of a stretch, other value). The sum over the last axis also counts the
    # values before the first one, `rank` of them.
    is_in_stretch = values[:, None, :] <= values[:, :, None] + width[:, None, None]
    count = np.where(np.isfinite(values), is_in_stretch.sum(axis=2) - rank, 0)
    # argmax takes the first of equal counts, so the reversed one gives the farthest
    start = rank[-1] - count[:, ::-1].argmax(axis=1)
    return start, count[row, start]


def mark_continuation(near: PixelMode, far: ImageRanges) -> ImageMask:
    """Mark pixels whose nearer surface continues a neighbour's farthest, at most `REACH_PX` off.

    The neighbour's surface must not continue the pixel's farthest one, as ground does below the
    foot of a car. Inverse depths of a plane are linear in the image, so the plane is extrapolated
    from the opposite neighbour through the pixel.

    Args:
        near: nearer cluster of each pixel.
        far: median of each pixel's farthest cluster, 0 for nothing returned."""
    max_gap = np.maximum(SCENE_SIGMAS * near.spread, GAP_SHARE * near.median)
    inverse = np.where(far > 0, 1 / np.where(far > 0, far, 1), 0)
    # NaN and repeated edges, so that all slices below have the image's shape
    padded_far = np.pad(far, REACH_PX, constant_values=np.nan)
    padded_inverse = np.pad(inverse, REACH_PX, mode="edge")
    rows, columns = far.shape
    continues = np.zeros(far.shape, bool)
    for down, right in product(range(-REACH_PX, REACH_PX + 1), repeat=2):
        # the neighbour this many pixels down and right, and the one on the other side of the pixel
        neighbour = padded_far[REACH_PX + down :, REACH_PX + right :][:rows, :columns]
        opposite_inverse = padded_inverse[REACH_PX - down :, REACH_PX - right :][:rows, :columns]
        # inverse depth, at the neighbour, of the plane through the opposite pixel and the pixel
        plane_inverse = 2 * inverse - opposite_inverse
        is_other_surface = np.abs(plane_inverse * neighbour - 1) > MIN_SURFACE_GAP_SHARE
        continues |= (np.abs(neighbour - near.median) <= max_gap) & is_other_surface
    return continues
