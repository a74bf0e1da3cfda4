"""Error terms: what changes the measurements of a sensor and its believed pose."""

from dataclasses import Field, dataclass, fields, replace
from typing import ClassVar

import numpy as np

from toolkit.arrays import Float, Float64, ImageMask, Int64
from toolkit.objects import HEAVY, VEHICLE
from toolkit.sensors.readings import Draws, Reading, TrueImage
from toolkit.sensors.sensor import NEAR, Measure, angle

# rows down and columns right from a pixel to each of its four neighbours
_NEIGHBOURS = ((0, 1), (0, -1), (1, 0), (-1, 0))
# extinction per metre (natural logarithm of power) for an attenuation of 1 dB/km
PER_METRE_OF_DB_PER_KM = np.log(10) / 10 / 1000
# a measurement this close to the true one is of the same object, so it moves with the object
MAX_SAME_M = 1.0


class _Term:
    """Base of the error terms: fields are numbers from 0 on, checked when made."""

    __dataclass_fields__: ClassVar[dict[str, Field[object]]]
    needs_velocities: ClassVar[bool] = False
    # fields that change nothing while all are 0
    _strengths: ClassVar[tuple[str, ...]] = ("share",)
    _shares: ClassVar[tuple[str, ...]] = ("share",)  # fields that are at most 1
    _positive: ClassVar[tuple[str, ...]] = ()  # fields that are at least 0.001

    def __post_init__(self) -> None:
        """Raise ValueError for a share outside 0..1, or a number below its minimum or infinite.

        Fields named in `_shares` are shares; fields with a float as default are numbers from 0 on,
        or from 0.001 on if named in `_positive`."""
        name = type(self).__name__
        for entry in fields(self):
            value = getattr(self, entry.name)
            minimum = 1e-3 if entry.name in self._positive else 0
            is_number = isinstance(value, int | float | np.number)
            if entry.name in self._shares and not (is_number and 0 <= value <= 1):
                raise ValueError(
                    f"{entry.name} of {name} must be a share from 0 to 1, got {value!r}"
                )
            if isinstance(entry.default, float) and not (is_number and minimum <= value < np.inf):
                raise ValueError(
                    f"{entry.name} of {name} must be a number from {minimum:g} on, got {value!r}"
                )

    def apply(self, reading: Reading, draws: Draws) -> Reading:
        """Return the reading with this error, or the reading itself if all strengths are 0."""
        if not any(getattr(self, name) for name in self._strengths):
            return reading
        return self._change(reading, draws)

    def _change(self, reading: Reading, draws: Draws) -> Reading:
        """Return the reading with this error; only called if a strength is not 0."""
        raise NotImplementedError


@dataclass(frozen=True)
class ClockOffset(_Term):
    """Offset of each sensor's clock, constant over a recording.

    offset: standard deviation (s)."""

    needs_velocities: ClassVar[bool] = True
    _strengths = ("offset",)
    offset: float = 0.0

    def _change(self, reading: Reading, draws: Draws) -> Reading:
        """Shift each pixel's point as far as its object moves during the clock's offset.

        Pixels without object stay, and pixels that an earlier error moved off their object.
        `self.offset` is the standard deviation (s) of the sensors' offsets."""
        truth = reading.truth
        if truth.velocities is None:
            raise ValueError(
                "a clock's offset needs the objects' velocities: read a recording with tracks "
                "and times"
            )
        late_s = draws.of_sensor().standard_normal() * self.offset
        object_displacements = truth.velocities * late_s
        # owners: row of the object in each pixel; a row of zeros last, for -1, no object
        displacements = np.append(object_displacements, np.zeros((1, 3)), axis=0)[truth.owners]
        is_same_object = np.abs(reading.measurement - truth.measurement) < MAX_SAME_M
        is_shifted = reading.valid & is_same_object
        shift = np.where(is_shifted[..., None], displacements, 0).astype(np.float32)
        return replace(reading, shift=shift if reading.shift is None else reading.shift + shift)


@dataclass(frozen=True)
class DropOut(_Term):
    """Returns that fail, at random and by range and incidence.

    share: share of all returns that fail at random; half_range: range (m) from which half of the
    surfaces at right angles return, 0 for no loss by range; steepness: steepness of this law."""

    _strengths = ("share", "half_range")
    share: float = 0.0
    half_range: float = 0.0
    steepness: float = 2.0

    def _change(self, reading: Reading, draws: Draws) -> Reading:
        """Drop `self.share` of the returns, and more returns far away and at grazing incidence."""
        # probability that each pixel keeps its return
        chance = np.full(reading.measurement.shape, 1.0 - self.share)
        truth = reading.truth
        if self.half_range:  # 0 for no loss by range
            chance *= chance_of_return(
                truth.ranges, truth.cosines, half_range=self.half_range, steepness=self.steepness
            )
        return reading.without(draws.of_frame().random(chance.shape) >= chance)


@dataclass(frozen=True)
class DeadRows(_Term):
    """Rows of the image that never return: lasers or lines of a detector that failed.

    share: share of all rows."""

    share: float = 0.0

    def _change(self, reading: Reading, draws: Draws) -> Reading:
        dead = draws.of_sensor().random((len(reading.measurement), 1)) < self.share
        return reading.without(np.broadcast_to(dead, reading.measurement.shape))


@dataclass(frozen=True)
class BlindSector(_Term):
    """Columns of the image that see nothing, as in the glare of a low sun.

    share: share of all columns, the same ones in every frame."""

    share: float = 0.0

    def _change(self, reading: Reading, draws: Draws) -> Reading:
        """Drop all returns of neighbouring columns, from one that is drawn for the sensor."""
        columns = reading.measurement.shape[1]
        # columns from `first` on, and again from 0 on past the last one
        first = int(draws.of_sensor().integers(columns))
        blind = (np.arange(columns) - first) % columns < round(self.share * columns)
        return reading.without(np.broadcast_to(blind, reading.measurement.shape))


@dataclass(frozen=True)
class RangeBias(_Term):
    """Ranges of each sensor that are all too long or too short.

    deviation: standard deviation of the error (m)."""

    _strengths = ("deviation",)
    deviation: float = 0.0

    def _change(self, reading: Reading, draws: Draws) -> Reading:
        bias = np.float32(draws.of_sensor().standard_normal() * self.deviation)
        biased = np.maximum(reading.measurement + bias, 0)
        return reading.measuring(np.where(reading.valid, biased, np.float32(0)))


def chance_of_return(
    ranges: Float[np.ndarray, "*n"],
    cosines: Float[np.ndarray, "*n"],
    half_range: float,
    steepness: float,
    reflectivity: float | Float[np.ndarray, "*n"] = 1.0,
) -> Float64[np.ndarray, "*n"]:
    """Probability (0 to 1) that a surface returns, by range, incidence and reflectivity.

    Args:
        ranges: distance of each surface (m).
        cosines: cosine of the angle between ray and surface normal, 1 at right angles.
        half_range: range (m) at which half of the surfaces at right angles return.
        steepness: how fast the probability falls around `half_range`; infinity would be a step.
        reflectivity: share of light that surfaces reflect, relative to others, 1 for all."""
    # received power falls with the square of the range; at a `deficit` of 1 half of the surfaces
    # return
    power = np.asarray(reflectivity) * cosines * half_range**2
    deficit = np.asarray(ranges, np.float64) ** 2 / np.maximum(power, 1e-12)
    return 1 / (1 + deficit**steepness)


@dataclass(frozen=True)
class MixedPixels(_Term):
    """Pixels next to an edge that measure something between two surfaces.

    All distances between the two are equally likely. The other surface is a neighbour's, drawn from
    four; a neighbour without return mixes nothing.

    share: share of the pixels next to an edge; gap: smallest difference between neighbours that
    is an edge (m); reach: largest difference that mixes (m). For a lidar it is c/2 times the
    length of the pulse (s), some 1.5 m."""

    share: float = 0.0
    gap: float = 0.3
    reach: float = 1000.0

    def _change(self, reading: Reading, draws: Draws) -> Reading:
        """Move some pixels next to an edge towards the measurement of one of their neighbours.

        An edge is a difference between `self.gap` and `self.reach` (m); `self.share` of the pixels
        there move."""
        image = reading.measurement
        rng = draws.of_frame()
        # three draws for every pixel in this order, so that results stay the same
        neighbour_number = rng.integers(len(_NEIGHBOURS), size=image.shape)
        is_drawn = rng.random(image.shape) < self.share
        weight = rng.random(image.shape, np.float32)  # 0 keeps the pixel, 1 takes the neighbour
        # a border of one pixel without return, hence + 1 in the indices below
        padded = np.pad(np.where(reading.valid, image, np.float32(0)), 1)
        rows, columns = image.shape
        # steps (-1, 0 or 1) along rows and columns from each pixel to the neighbour drawn for it
        down, right = np.array(_NEIGHBOURS)[neighbour_number].transpose(2, 0, 1)
        neighbour = padded[np.arange(rows)[:, None] + 1 + down, np.arange(columns) + 1 + right]
        difference = np.abs(neighbour - image)
        is_edge = (neighbour > 0) & (difference > self.gap) & (difference < self.reach)
        is_mixed = reading.valid & is_edge & is_drawn
        mixed = image + weight * (neighbour - image)
        return reading.measuring(np.where(is_mixed, mixed, image))


@dataclass(frozen=True)
class Calibration(_Term):
    """Error of calibration, constant over a recording, normal about and along each axis.

    rotation: root mean square of the angle (rad) about any axis through the sensor; translation:
    root mean square of the displacement (m) in any direction."""

    _strengths = ("rotation", "translation")
    rotation: float = angle(0.0)
    translation: float = 0.0

    def _change(self, reading: Reading, draws: Draws) -> Reading:
        """Move the believed pose by a rotation and a translation that stay for the recording.

        `self.rotation` (rad) and `self.translation` (m) are root mean squares of their sizes."""
        # rotation about and translation along x, y, z of the sensor; / sqrt(3) gives the length of
        # each vector a root mean square of 1
        turn, move = draws.of_sensor().standard_normal((2, 3)) / np.sqrt(3)
        error = np.eye(4)
        error[:3, :3] = make_rotation(turn * self.rotation)
        error[:3, 3] = move * self.translation
        return replace(reading, pose=reading.pose @ error)


@dataclass(frozen=True)
class PoleSway(_Term):
    """Slow sway of poles; all sensors of a pole sway together.

    To first order, a moved sensor at its believed pose equals an unmoved sensor at a wrong pose, so
    nothing is rendered again. A pole's foot is at z = 0.

    amplitude: angle by which the tip of a pole turns (rad); period: seconds, up to a third longer
    or shorter from pole to pole."""

    _strengths = ("amplitude",)
    _positive = ("period",)
    amplitude: float = angle(0.0)
    period: float = 3.0

    def _change(self, reading: Reading, draws: Draws) -> Reading:
        """Tilt and move the believed pose as the sensor's pole sways at the time of the frame.

        `self.amplitude` (rad) is how far its tip turns, `self.period` (s) the mean period. Each
        pole has a direction, phase and period, equal in all frames."""
        position = reading.truth.sensor.position
        height = max(position[2], 0.0)
        # shares from 0 to 1, the same in every frame: heading and phase as shares of a full turn
        heading_share, phase_share, period_share = draws.of_pole(position).random(3)
        period = self.period * (1 + (2 * period_share - 1) / 3)  # 2/3 to 4/3 of `self.period`
        turns = reading.truth.time / period + phase_share
        tip_angle = self.amplitude * np.sin(2 * np.pi * turns)
        heading = 2 * np.pi * heading_share
        direction = np.array([np.cos(heading), np.sin(heading), 0.0])
        # a quarter turn to the left of the direction: a turn about it tilts the pole there
        sway_axis = np.array([-direction[1], direction[0], 0.0])
        swayed = reading.pose.copy()
        swayed[:3, :3] = make_rotation(tip_angle * sway_axis) @ reading.pose[:3, :3]
        # a beam that is clamped at its foot and bent at its tip moves by 2/3 of tip angle · height
        swayed[:3, 3] += 2 / 3 * tip_angle * height * direction
        return replace(reading, pose=swayed)


def make_rotation(vector: Float64[np.ndarray, "3"]) -> Float64[np.ndarray, "3 3"]:
    """Rotation matrix (3, 3) about a vector's direction, by its length (rad)."""
    from scipy.spatial.transform import Rotation

    return Rotation.from_rotvec(vector).as_matrix()


@dataclass(frozen=True)
class OwnNoise(_Term):
    """Noise that the sensor's model states, with the same random numbers as in a dataset."""

    def apply(self, reading: Reading, draws: Draws) -> Reading:
        """Add the model's noise to the measurement."""
        model = reading.truth.sensor.model
        return reading.measuring(model.noisy(reading.measurement, draws.own_noise()))


@dataclass(frozen=True)
class RangeNoise(_Term):
    """Normal noise, sigma = constant + proportional · z + quadratic · z² (m).

    z: measurement without this noise (m). A noisy measurement below 0 becomes 0, no return.
    measures: "depth" or "range" adds the noise only to sensors that measure this; None adds it to
    all."""

    _strengths = ("constant", "proportional", "quadratic")
    constant: float = 0.0
    proportional: float = 0.0
    quadratic: float = 0.0
    measures: Measure | None = None

    def __post_init__(self) -> None:
        """Raise ValueError for numbers out of range, or an unknown measure."""
        super().__post_init__()
        if self.measures not in (None, "depth", "range"):
            raise ValueError(
                f"measures must be depth, range or None for all sensors, got {self.measures!r}"
            )

    def _change(self, reading: Reading, draws: Draws) -> Reading:
        """Add normal noise to all returns; its standard deviation (m) grows with the measurement z.

        The reading itself comes back for a sensor that measures another quantity than
        `self.measures`, "depth" or "range"."""
        if self.measures not in (None, reading.truth.sensor.model.measures):
            return reading
        z = np.where(reading.valid, reading.measurement, np.float32(0))
        noise = draws.of_frame().standard_normal(z.shape, dtype=np.float32)
        sigma = np.float32(self.constant) + np.float32(self.proportional) * z
        sigma = sigma + np.float32(self.quadratic) * z**2
        noisy = np.maximum(z + noise * sigma, 0)
        return reading.measuring(np.where(reading.valid, noisy, np.float32(0)))


def stereo_noise(*, baseline: float, focal: float, disparity: float = 0.1) -> RangeNoise:
    """Noise of a stereo camera, which grows with the square of the depth.

    baseline: distance between the two cameras (m); focal: focal length (pixels); disparity:
    standard deviation of the disparity (pixels)."""
    if not (baseline > 0 and focal > 0):
        raise ValueError(
            f"baseline and focal length must be above 0, got {baseline} m and {focal} pixels"
        )
    return RangeNoise(quadratic=disparity / (focal * baseline), measures="depth")


def time_of_flight_noise(*, at_10_m: float = 0.02, ambient: float = 0.5) -> RangeNoise:
    """Noise of a time-of-flight camera; sensors of every kind get it.

    at_10_m: standard deviation at 10 m (m); ambient: share, from 0 to 1, that is due to ambient
    light and electronics. This share grows with the square of the measurement, the rest in
    proportion."""
    if not 0 <= ambient <= 1:
        raise ValueError(f"ambient must be a share from 0 to 1, got {ambient}")
    return RangeNoise(proportional=at_10_m * (1 - ambient) / 10, quadratic=at_10_m * ambient / 100)


def lidar_noise(*, constant: float = 0.02, proportional: float = 0.0005) -> RangeNoise:
    """Noise of a lidar, in addition to the noise of its model.

    constant: standard deviation at range 0 (m); proportional: by which it grows (m per m)."""
    return RangeNoise(constant=constant, proportional=proportional, measures="range")


@dataclass(frozen=True)
class Glass(_Term):
    """Window glass of cars: some rays return from anywhere inside, the others return nothing.

    Attributes:
        share: share of the window band that is glass; the rest is pillars.
        lower: lower end of the band, as a share of a vehicle's height.
        upper: its upper end.
        behind: share of the rays through glass that return from the inside.
    """

    _shares = ("share", "lower", "upper", "behind")
    share: float = 0.0
    lower: float = 0.62
    upper: float = 0.93
    behind: float = 0.3

    def __post_init__(self) -> None:
        """Raise ValueError for numbers out of range, or a band that does not rise."""
        super().__post_init__()
        if not self.lower < self.upper:
            raise ValueError(
                f"the window band must have lower < upper, got {self.lower} and {self.upper}"
            )

    def _change(self, reading: Reading, draws: Draws) -> Reading:
        """Move returns from glass to anywhere inside the vehicle, or drop them.

        `self.share` of the window band is glass; `self.behind` of the rays through it return."""
        # three draws for every pixel in this order, so that results stay the same
        rng = draws.of_frame()
        shape = reading.measurement.shape
        is_pane = rng.random(shape) < self.share  # not a pillar
        returns_from_inside = rng.random(shape) < self.behind
        way_share = rng.random(shape)  # share of the way from the glass to the far side
        is_glass = self.band(reading.truth) & is_pane & reading.valid
        is_inside = is_glass & returns_from_inside
        pixels = np.flatnonzero(is_inside)
        # for each pixel, m behind the glass along the ray
        added_range = np.zeros(is_glass.size)
        added_range[pixels] = way_share.ravel()[pixels] * _depths_of_boxes(reading.truth, pixels)
        # `ray_lengths`: m of range in one measured metre, as a camera measures along its axis,
        # which is shorter than along the ray; 1 for sensors that measure ranges
        added_measurement = added_range.reshape(shape) / reading.truth.ray_lengths
        added_measurement = added_measurement.astype(np.float32)
        measurement = reading.measurement + added_measurement
        measurement = np.where(is_inside, measurement, reading.measurement)
        return reading.measuring(measurement).without(is_glass & ~returns_from_inside)

    def band(self, truth: TrueImage) -> ImageMask:
        """Mask of the pixels on the window band of a vehicle, heavy ones excluded.

        The band goes from `self.lower` to `self.upper`, as shares of the vehicle's height."""
        owners = truth.owners.ravel()  # row of the object in each pixel, -1 for no object
        pixels = np.flatnonzero(owners >= 0)
        pixels = pixels[truth.objects.labels[owners[pixels]] == VEHICLE]
        boxes = truth.objects.boxes[owners[pixels]]
        box_middle, box_height = boxes[:, 2], boxes[:, 5]
        # 0 at the foot and 1 at the top
        height_share = (truth.points[pixels, 2] - box_middle) / box_height + 0.5
        band = np.zeros(owners.size, np.bool_)
        band[pixels] = (height_share > self.lower) & (height_share < self.upper)
        return band.reshape(truth.measurement.shape)


@dataclass(frozen=True)
class Paint(_Term):
    """Dark or wet paint of vehicles, heavy ones included.

    Recordings without track ids draw other dark vehicles in each frame.

    Attributes:
        share: share of dark vehicles, by track id, the same for all sensors and frames.
        dark: reflectivity of dark vehicles relative to others.
        wet: reflectivity of every vehicle relative to a dry one.
        half_range: as for `DropOut`, for a vehicle that is not dark (m).
        steepness: as for `DropOut`.
    """

    _shares = ("share", "dark", "wet")
    _positive = ("half_range",)
    share: float = 0.0
    dark: float = 0.1
    wet: float = 1.0
    half_range: float = 150.0
    steepness: float = 2.0

    def apply(self, reading: Reading, draws: Draws) -> Reading:
        """Drop returns of dark or wet vehicles; dry bright ones lose nothing.

        A return stays with the ratio of its chance to the chance of a dry bright vehicle."""
        truth = reading.truth
        shape = reading.measurement.shape
        if not (self.share or self.wet < 1) or not len(truth.objects):
            return reading
        is_vehicle = np.isin(truth.objects.labels, (VEHICLE, HEAVY))
        is_dark = (draws.of_objects(truth.objects.ids) < self.share) & is_vehicle
        # `self.wet` of a wet vehicle, and `self.dark` of a dark one, relative to others
        reflectivity = np.where(is_vehicle, self.wet, 1.0) * np.where(is_dark, self.dark, 1.0)
        # owners: row of the object in each pixel; 1 last, for -1, no object
        pixel_reflectivity = np.append(reflectivity, 1.0)[truth.owners]
        chance_if_dry = chance_of_return(
            truth.ranges, truth.cosines, half_range=self.half_range, steepness=self.steepness
        )
        chance = chance_of_return(
            truth.ranges,
            truth.cosines,
            half_range=self.half_range,
            steepness=self.steepness,
            reflectivity=pixel_reflectivity,
        )
        return reading.without(draws.of_frame().random(shape) >= chance / chance_if_dry)


def _depths_of_boxes(
    truth: TrueImage, pixels: Int64[np.ndarray, " n"]
) -> Float64[np.ndarray, " n"]:
    """Distance (m) that each ray goes on from its point to the far side of its object's box.

    pixels: flat numbers of pixels (row after row) that show an object."""
    boxes = truth.objects.boxes[truth.owners.ravel()[pixels]]
    centres = boxes[:, :3]
    half_extents = boxes[:, 3:6] / 2  # half length, width and height
    rays = truth.sensor.world_rays.T[pixels].astype(np.float64)
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    # from here on along each box's length, width and height, from its centre
    start = _turn_into_boxes(truth.points[pixels] - centres, boxes)
    ray = _turn_into_boxes(rays, boxes)
    ray = np.where(np.abs(ray) < 1e-9, 1e-9, ray)  # to divide by
    # to the planes of the three faces that the ray leaves through; the nearest is the exit
    to_faces = (np.copysign(half_extents, ray) - start) / ray
    return np.maximum(to_faces.min(axis=1), 0.0)


def _turn_into_boxes(
    vectors: Float64[np.ndarray, "n 3"], boxes: Float64[np.ndarray, "n 7"]
) -> Float64[np.ndarray, "n 3"]:
    """Turn world vectors into the axes of their boxes: along length, width and height.

    Row i of the result belongs to box i."""
    yaw = boxes[:, 6]
    cos, sin = np.cos(yaw), np.sin(yaw)
    x, y, z = vectors.T
    return np.column_stack([x * cos + y * sin, x * -sin + y * cos, z])


@dataclass(frozen=True)
class Weather(_Term):
    """Rain, fog or snow: returns are lost on the way, and drops in the air return.

    Args:
        extinction: coefficient (1/m); light falls by exp(-extinction) per metre, there and back.
        share: share of rays into the open that return from the air, below 1.
        reach: distance (m) over which the rate of such returns falls to 1/e."""

    _strengths = ("extinction", "share")
    _positive = ("reach",)
    extinction: float = 0.0
    share: float = 0.0
    reach: float = 8.0

    def __post_init__(self) -> None:
        """Raise ValueError for numbers out of range, or a share of 1."""
        super().__post_init__()
        if self.share == 1:
            raise ValueError(
                "share of Weather must be below 1, got 1: nothing else would ever be seen"
            )

    def _change(self, reading: Reading, draws: Draws) -> Reading:
        """Drop returns by the light lost on the way, then let drops nearer than them return.

        `self.extinction` (1/m) is how fast light is lost, `self.share` the share of rays into the
        open that meet a drop, and `self.reach` (m) how far most drops are."""
        rng = draws.of_frame()
        truth = reading.truth
        # two draws for every pixel, even if only one is used
        loss_draw = rng.random(reading.measurement.shape)
        drop_draw = rng.random(reading.measurement.shape)
        # m along the ray; a camera's measurement is shorter
        ranges = np.where(
            reading.valid, reading.measurement * truth.ray_lengths, np.float32(np.inf)
        )
        light_share = np.exp(-2 * self.extinction * np.where(reading.valid, ranges, 0))
        reading = reading.without(reading.valid & (loss_draw >= light_share))
        if not self.share:
            return reading
        # `decay` is exp(-(r - NEAR) / reach) for the range r of the first drop on each ray; it is
        # above 0 for `self.share` of the rays, the others meet no drop
        decay = 1 + np.log1p(-drop_draw) / -np.log1p(-self.share)
        drop_range = NEAR - self.reach * np.log(np.maximum(decay, 1e-12))
        is_in_range = (drop_range < ranges) & (drop_range < truth.sensor.model.max_range)
        drop_measurement = (drop_range / truth.ray_lengths).astype(np.float32)
        return reading.measuring(
            np.where((decay > 0) & is_in_range, drop_measurement, reading.measurement)
        )


def rain(rate: float) -> Weather:
    """Rain of `rate` mm/h: 2.5 is light, 10 heavy.

    For each mm/h, 0.3 % of the rays into the open return from a drop."""
    # attenuation in dB/km is 1.076 * rate**0.67
    extinction = PER_METRE_OF_DB_PER_KM * 1.076 * _check_rate(rate) ** 0.67
    return Weather(extinction, share=1 - np.exp(-0.003 * rate), reach=8.0)


def snow(rate: float, *, wet: bool = False) -> Weather:
    """Snow of `rate` mm/h of water: 1 is light, 4 heavy. wet: wet snow instead of dry.

    For each mm/h, 4 % of the rays into the open return from a flake."""
    # attenuation in dB/km is factor * rate**power; 905 is the wavelength (nm)
    if wet:
        factor, power = 1.02e-4 * 905 + 3.786, 0.72
    else:
        factor, power = 5.42e-5 * 905 + 5.496, 1.38
    extinction = PER_METRE_OF_DB_PER_KM * factor * _check_rate(rate) ** power
    return Weather(extinction, share=1 - np.exp(-0.04 * rate), reach=6.0)


def fog(visibility: float) -> Weather:
    """Fog with a visibility in metres.

    A share 1 - exp(-5 m / visibility) of the rays into the open return from it, most near by."""
    if not visibility > 0:
        raise ValueError(f"visibility must be above 0 m, got {visibility}")
    # visibility is the distance at which contrast falls to 2 %: 3.912 = -log(0.02)
    return Weather(
        extinction=3.912 / visibility, share=1 - np.exp(-5 / visibility), reach=visibility / 10
    )


def _check_rate(rate: float) -> float:
    """Return a rate (mm/h); ValueError if it is negative, infinite or NaN."""
    if not 0 <= rate < np.inf:
        raise ValueError(f"a rate must be a number of mm/h from 0 on, got {rate}")
    return rate
