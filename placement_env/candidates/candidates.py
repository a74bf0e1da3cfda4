"""Candidates: the sensors that a search may choose from, a product of mount, height, heading, tilt
and sensor model.

Heading is counter-clockwise from +x, tilt below the horizon (rad), height above the mount's foot
(m). The five indices of a candidate are its `factors`; not every combination is a
candidate. A mount carries up to `Mount.max_sensors` sensors; all their data shares its one link,
and the mount itself is paid once.

Candidates of a site are its present sensors, pools of poses, poles or random samples.
"""

import warnings
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from difflib import get_close_matches
from functools import cached_property
from hashlib import sha256
from itertools import compress
from pathlib import Path

import numpy as np
import shapely
from numpy.typing import ArrayLike

from placement_env.candidates.poles import load_poles
from placement_env.candidates.sensor_catalogue import SensorCatalogue
from placement_env.links import max_load
from placement_env.subsets import Sets, list_set_members
from toolkit.arrays import Bool, Float64, Int64, Mask, Rng, Shaped
from toolkit.display import Card, Displayed, Table, describe_count
from toolkit.geometry import pose
from toolkit.sensors.models import DepthCamera
from toolkit.sensors.sensor import Sensor, SensorModel, tabulate_sensors
from toolkit.sites.site import Mount, Site

DEFAULT_HEIGHTS_M = (4.0, 6.0, 8.0)  # heights of a pool above the foot of the mount
DEFAULT_TILTS_DEG = (5.0, 15.0, 25.0)  # tilts of a pool below the horizon
DEFAULT_TILTS_RAD = tuple(float(np.deg2rad(tilt)) for tilt in DEFAULT_TILTS_DEG)
MAX_MOUNT_DISTANCE_M = 1.0  # from a present sensor to the foot of its mount, seen from above
AREA_CELLS = 16  # the area is checked at 16 x 16 points for poses that see no part of the area
AREA_HEIGHT_M = 1.0  # height of the checked points above the street
PAPER = (DepthCamera(),)  # the paper's camera, the default model
MAX_RANDOM_POSES = 8  # pool poses in one random set
# sensor models, or their prices by model if sensors cost anything
Models = Sequence[SensorModel] | Mapping[SensorModel, float]


@dataclass(frozen=True, eq=False)
class Axes:
    """Values that the factors of candidates (except the mount) are indices of.

    Raises ValueError if models and prices do not fit.

    Attributes:
        heights: Heights above the foot of the mount (m).
        headings: Headings, counter-clockwise from +x (rad).
        tilts: Tilts below the horizon (rad).
        models: Sensor models.
        prices: Price of each model, in the unit of the mounts' prices, or empty.
    """

    heights: Float64[np.ndarray, " heights"]
    headings: Float64[np.ndarray, " headings"]
    tilts: Float64[np.ndarray, " tilts"]
    models: tuple[SensorModel, ...]
    prices: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        """Raise ValueError for a wrong number of prices, or a price below 0."""
        if self.prices and len(self.prices) != len(self.models):
            raise ValueError(
                f"need a price for each of {len(self.models)} models, got {len(self.prices)}"
            )
        if not all(0 <= price < np.inf for price in self.prices):
            raise ValueError(f"prices of models must be finite and not negative, got {self.prices}")

    @property
    def shape(self) -> tuple[int, int, int, int]:
        """Number of heights, headings, tilts and models."""
        return len(self.heights), len(self.headings), len(self.tilts), len(self.models)


@dataclass(frozen=True, eq=False)
class Candidates(Displayed):
    """Sensors of different names to choose from, on mounts.

    Raises ValueError if the fields do not fit together.

    Attributes:
        sensors: The sensors, one for each candidate.
        mounts: The mounts; some may have no candidate.
        factors: Index of each sensor's mount, then its indices of height, heading, tilt and model
            in `axes`. The sensor is lower or higher than its height there if the mount's range does
            not hold it.
        axes: Heights, headings, tilts and models, with the models' prices.
    """

    sensors: tuple[Sensor, ...]
    mounts: tuple[Mount, ...]
    factors: Int64[np.ndarray, "candidates 5"]
    axes: Axes

    def __post_init__(self) -> None:
        """Raise ValueError for fields that do not fit together.

        factors: a row for each sensor, with indices of its mount, height, heading, tilt and model,
        which must be below `shape`."""
        count = len(self.sensors)
        if len(self.factors) != count:
            raise ValueError(
                f"need one row of factors per sensor, got {count} sensors and {len(self.factors)} "
                "rows"
            )
        if len({sensor.name for sensor in self.sensors}) < count:
            repeat = find_repeat(s.name for s in self.sensors)
            raise ValueError(f"names of candidates must differ, got {repeat!r} twice")
        if count and not ((self.factors >= 0) & (self.factors < self.shape)).all():
            raise ValueError(
                f"factors must lie in 0..{self.shape}, got up to "
                f"{self.factors.max(axis=0).tolist()}"
            )

    @staticmethod
    def from_poses(
        sensors: Sequence[Sensor],
        mount: Int64[np.ndarray, " n"],
        aim: Float64[np.ndarray, "n 3"],
        pool: "Candidates",
    ) -> "Candidates":
        """Candidates in any poses on the mounts of a pool, with the pool's prices.

        Each has separate entries of heights, headings and tilts in the axes.

        Args:
            sensors: Sensors, whose names differ.
            mount: Index of each sensor's mount in the pool.
            aim: Height above the mount's foot (m), heading and tilt (rad) of each sensor.
            pool: Pool with the mounts, and with prices of all these models if it has any."""
        models = tuple(dict.fromkeys(sensor.model for sensor in sensors))
        model_index = [models.index(sensor.model) for sensor in sensors]
        prices: tuple[float, ...] = ()
        if pool.axes.prices:
            prices = tuple(pool.axes.prices[pool.axes.models.index(model)] for model in models)
        # each sensor has its own entry in the axes of heights, headings and tilts
        entry = np.arange(len(sensors))
        # columns: indices of mount, height, heading, tilt and model
        factors = np.column_stack([mount, entry, entry, entry, model_index]).astype(np.int64)
        heights, headings, tilts = aim.T
        return Candidates(
            sensors=tuple(sensors),
            mounts=pool.mounts,
            factors=factors,
            axes=Axes(heights, headings, tilts, models, prices),
        )

    def __len__(self) -> int:
        return len(self.sensors)

    def _card(self) -> Card:
        """Title, facts, table and map for a display, such as in a notebook."""
        kinds = ", ".join(dict.fromkeys(model.kind for model in self.axes.models))
        names = ("mount", "height", "heading", "tilt")
        # `strict` is off as the last number of `shape` is for models, given by kind instead
        facts = [
            describe_count(count, name) for name, count in zip(names, self.shape, strict=False)
        ]
        return Card(
            title=describe_count(len(self), "candidate sensor"),
            facts=(*facts, kinds),
            tables={"sensors": self._tabulate},
            drawing="placement_env.report.maps:draw_pool",
        )

    def _tabulate(self) -> Table:
        """Columns of a table with a row for each candidate, by name of the column."""
        heading_index, tilt_index = self.factors[:, 2:4].T
        axes = self.axes
        degrees = {
            "heading_deg": np.degrees(axes.headings)[heading_index],
            "tilt_deg": np.degrees(axes.tilts)[tilt_index],
        }
        mount_names = [self.mounts[mount].name for mount in self.mount]
        sensor_columns = tabulate_sensors(self.sensors)
        return {"mount": mount_names, **sensor_columns, **degrees, "price": self.prices}

    @property
    def shape(self) -> tuple[int, int, int, int, int]:
        """Number of mounts, heights, headings, tilts and models."""
        return len(self.mounts), *self.axes.shape

    @cached_property
    def mount(self) -> Int64[np.ndarray, " candidates"]:
        """Index of each candidate's mount."""
        return self.factors[:, 0].copy()

    @cached_property
    def mount_prices(self) -> Float64[np.ndarray, " mounts"]:
        """Price of each mount, paid once for all sensors on it."""
        return np.array([mount.price for mount in self.mounts], np.float64)

    @cached_property
    def model_prices(self) -> Float64[np.ndarray, " candidates"]:
        """Price of each candidate's sensor, without its mount."""
        prices = np.array(self.axes.prices or np.zeros(len(self.axes.models)), np.float64)
        return prices[self.factors[:, 4]]

    @cached_property
    def prices(self) -> Float64[np.ndarray, " candidates"]:
        """Price of each single candidate: its mount and its sensor."""
        return self.mount_prices[self.mount] + self.model_prices

    @cached_property
    def places(self) -> Int64[np.ndarray, " mounts"]:
        """Largest number of sensors on each mount."""
        return np.array([mount.max_sensors for mount in self.mounts], np.int64)

    @cached_property
    def has_shared_mounts(self) -> bool:
        """True if at least one mount can carry more than one sensor."""
        return bool((self.places > 1).any())

    @cached_property
    def capacity(self) -> Float64[np.ndarray, " candidates"]:
        """Capacity of the link of each candidate's mount (kbit per frame)."""
        return np.array([self.mounts[mount].capacity for mount in self.mount], np.float64)

    def find_mounts(self, names: Sequence[str]) -> Int64[np.ndarray, " k"]:
        """Index of the mount with each name. Raises ValueError for an unknown name."""
        indices = {mount.name: m for m, mount in enumerate(self.mounts)}
        for name in names:
            if name not in indices:
                similar_names = get_close_matches(name, indices, n=3, cutoff=0.4)
                suggestions = " or ".join(similar_names or list(indices)[:3])
                raise ValueError(
                    f"no sensor may stand on a pole {name!r}, which is unknown, in a keep-out "
                    f"area or on the carriageway: name one of the {len(indices)} poles that may be "
                    f"built, such as {suggestions}"
                )
        return np.array([indices[name] for name in names], np.int64)

    def per_mount(
        self, subsets: Sets, figure: Float64[np.ndarray, " candidates"] | None = None
    ) -> Shaped[np.ndarray, "n mounts"]:
        """Number of sensors of each set on each mount, or the sum of their figures.

        Args:
            subsets: n sets as rows of booleans.
            figure: Figure of each candidate to add up, such as its data; None to count."""
        sets = len(subsets)
        mounts = len(self.mounts)
        set_row, candidate = list_set_members(subsets)
        mount = self.mount[candidate]  # index of each member's mount
        cells = set_row * mounts + mount  # flat index in the result
        weights = None if figure is None else figure[candidate]
        return np.bincount(cells, weights, minlength=sets * mounts).reshape(sets, mounts)

    def at(
        self,
        mount: ArrayLike,
        height: ArrayLike,
        heading: ArrayLike,
        tilt: ArrayLike,
        model: ArrayLike,
    ) -> np.int64 | Int64[np.ndarray, "..."]:
        """Index of the first candidate with these factors, -1 without one.

        The arguments are indices in `mounts` and `axes`, as in `factors`; arrays are broadcast, and
        the result has their shape."""
        requested = np.stack(np.broadcast_arrays(mount, height, heading, tilt, model), axis=-1)
        # (..., 1, 5) is compared with (candidates, 5), which gives (..., candidates)
        is_same = (requested[..., None, :] == self.factors).all(axis=-1)
        # `argmax` finds the first True; a last column of True is found if no candidate matches
        no_match = np.ones((*requested.shape[:-1], 1), np.bool_)
        first_match = np.concatenate([is_same, no_match], axis=-1).argmax(axis=-1)
        # [()] makes a number of an array without axes
        return np.where(first_match < len(self), first_match, -1)[()]

    def select(self, indices: Sequence[int] | Int64[np.ndarray, " n"]) -> "Candidates":
        """Some of the candidates (indices), in this order.

        Mounts and axes stay, even unused ones, so factors keep their meaning."""
        rows = np.asarray(indices, np.int64)
        return Candidates(
            sensors=tuple(self.sensors[i] for i in rows),
            mounts=self.mounts,
            factors=self.factors[rows],
            axes=self.axes,
        )

    def digest(self) -> str:
        """SHA-256 (hexadecimal) over sensors, mounts, axes and factors, alike on every machine.

        The mounts' numbers of sensors count only if they are not all 1, and the prices of models
        only if they are not all 0, so that candidates without them keep their digest."""
        sha = sha256(repr([(sensor.name, sensor.digest) for sensor in self.sensors]).encode())
        for mount in self.mounts:
            terms = (mount.name, mount.min_height, mount.max_height, mount.price, mount.capacity)
            sha.update(repr((terms, mount.position.tolist())).encode())
        sha.update(repr(self.places.tolist()).encode() if self.has_shared_mounts else b"")
        axes = [self.axes.heights, self.axes.headings, self.axes.tilts]
        values = [axis.tolist() for axis in axes]
        sha.update(repr([values, self.axes.models, self.factors.tolist()]).encode())
        sha.update(repr(self.axes.prices).encode() if any(self.axes.prices) else b"")
        return sha.hexdigest()


def find_repeat(names: Iterable[str]) -> str:
    """First name that occurs for the second time; StopIteration if all differ."""
    seen: set[str] = set()
    # `add` returns None, so a new name is added and passed over
    return next(name for name in names if name in seen or seen.add(name))  # type: ignore[func-returns-value]


def aims(sensors: Sequence[Sensor]) -> tuple[Float64[np.ndarray, " n"], Float64[np.ndarray, " n"]]:
    """Headings counter-clockwise from +x, and tilts below the horizon, of sensors (rad)."""
    turns = np.array([sensor.pose[:3, :3] for sensor in sensors]).reshape(-1, 3, 3)
    # optical axes in the sensors' frames, then in the world
    forward = np.array([sensor.model.body_SE3_sensor[0, :3] for sensor in sensors]).reshape(-1, 3)
    x, y, z = np.einsum("nij,nj->in", turns, forward)
    return np.arctan2(y, x), np.arctan2(-z, np.hypot(x, y))


def aim_sensor(
    sensor: Sensor, position: Float64[np.ndarray, "3"], heading: float, tilt: float
) -> Sensor:
    """Copy of a sensor at another position (m, world) with this heading and tilt (rad), no roll."""
    x, y, z = position.tolist()
    world_SE3_body = pose(x, y, z, yaw=heading, pitch=tilt)
    return replace(sensor, pose=world_SE3_body @ sensor.model.body_SE3_sensor)


def fit_together(
    candidates: Candidates, subsets: Sets, sent: Float64[np.ndarray, " candidates"] | None = None
) -> Mask:
    """Mask of sets that fit on their mounts and shared links.

    A sensor without others on its mount always fits its link here: `FeasibleSets.linked` checks
    that.

    Args:
        candidates: Candidates, the columns of `subsets`.
        subsets: n sets as rows of booleans.
        sent: kbit per frame of each candidate, None if links always suffice.
    """
    counts = candidates.per_mount(subsets)  # sensors of each set (row) on each mount
    # `places`: largest number of sensors on each mount
    fits_mounts = np.asarray((counts <= candidates.places).all(axis=1))
    if sent is None or not candidates.has_shared_mounts:
        return fits_mounts
    loads = candidates.per_mount(subsets, sent)  # kbit per frame
    capacities = np.array([mount.capacity for mount in candidates.mounts])
    fits_links = ((loads <= max_load(capacities)) | (counts <= 1)).all(axis=1)
    return np.asarray(fits_mounts & fits_links)


def room_beside(
    candidates: Candidates, subsets: Sets, sent: Float64[np.ndarray, " candidates"] | None = None
) -> Sets:
    """Mask of candidates (columns) that could be added to each set (row) and fit their mounts.

    Members of a set are False. A candidate on a mount without a sensor always fits its link here.

    Args:
        candidates: Candidates, the columns of `subsets`.
        subsets: n sets as rows of booleans.
        sent: kbit per frame of each candidate, None if links always suffice.
    """
    mount = candidates.mount
    counts = candidates.per_mount(subsets)  # sensors of each set (row) on each mount
    # `places`: largest number of sensors on each mount. Indexed by `mount`, figures of mounts
    # become figures of candidates
    has_room = np.asarray((counts < candidates.places)[:, mount] & ~subsets)
    if sent is None or not candidates.has_shared_mounts:
        return has_room
    loads = candidates.per_mount(subsets, sent)[:, mount] + sent
    is_first = (counts == 0)[:, mount]
    fits_link = (loads <= max_load(candidates.capacity)) | is_first
    return np.asarray(has_room & fits_link)


def extra_prices(
    candidates: Candidates, row: Bool[np.ndarray, " candidates"]
) -> Float64[np.ndarray, " candidates"]:
    """Price that each candidate adds to a set; a mount that carries a sensor already is paid.

    row: True for the candidates of the set."""
    is_paid = np.isin(candidates.mount, candidates.mount[row])
    return np.where(is_paid, candidates.model_prices, candidates.prices)


class NoCandidates(ValueError):
    """Error of a pool if no mount or pose remains for a sensor."""


def paper_candidates(site: Site) -> Candidates:
    """Candidates that are the present sensors of a site, each on a separate mount.

    The mount is the site's nearest one within `MAX_MOUNT_DISTANCE_M` (a copy with another name for
    a second sensor), or a new one at the sensor. Axes hold the heights, headings and tilts that
    occur, to 1e-6. Raises ValueError if the site has no sensors.
    """
    if not site.sensors:
        raise ValueError(
            f"site {site.name!r} has no sensors of its own: take candidates from pool(site)"
        )
    mounts: list[Mount] = []
    for sensor in site.sensors:
        x, y, z = sensor.position.tolist()

        def distance(mount: Mount, xy: tuple[float, float] = (x, y)) -> float:
            # from the sensor (m), seen from above; xy is bound as a default, as the loop changes it
            return float(np.hypot(*(mount.position[:2] - xy)))

        nearest = min(site.mounts, key=distance, default=None)
        if nearest is None or distance(nearest) > MAX_MOUNT_DISTANCE_M:
            foot = min(z, float(site.ground(np.array([x, y]))))
            name = f"{sensor.name}_mount"
            nearest = Mount(
                name,
                position=np.array([x, y, foot]),
                min_height=min(3.0, z - foot),
                max_height=max(8.0, z - foot),
            )
        elif nearest.name in {mount.name for mount in mounts}:
            nearest = replace(nearest, name=f"{nearest.name}_{sensor.name}")
        mounts.append(nearest)
    mounted = [s.position[2] - m.position[2] for s, m in zip(site.sensors, mounts, strict=True)]
    sensor_headings, sensor_tilts = aims(site.sensors)
    # values that occur, and the index among them of each sensor's
    heights, height_index = np.unique(np.round(mounted, 6), return_inverse=True)
    headings, heading_index = np.unique(np.round(sensor_headings, 6), return_inverse=True)
    tilts, tilt_index = np.unique(np.round(sensor_tilts, 6), return_inverse=True)
    models = tuple(dict.fromkeys(sensor.model for sensor in site.sensors))
    model_index = np.array([models.index(sensor.model) for sensor in site.sensors])
    factors = np.column_stack(
        [np.arange(len(mounts)), height_index, heading_index, tilt_index, model_index]
    )
    return Candidates(site.sensors, tuple(mounts), factors, Axes(heights, headings, tilts, models))


def pool(
    site: Site,
    *,
    heights: Sequence[float] = DEFAULT_HEIGHTS_M,
    headings: int = 8,
    tilts: Sequence[float] = DEFAULT_TILTS_RAD,
    models: Models = PAPER,
    keep_out: Sequence[shapely.Geometry] = (),
    mounts: Sequence[Mount] | None = None,
    blind: bool = False,
) -> Candidates:
    """Candidates with every model on every mount, at every height, heading and tilt.

    Args:
        site: Site with the detection area.
        heights: Heights above the mount's foot (m), clipped to the range of the mount; equal ones
            are kept once.
        headings: Number of headings, evenly spaced counter-clockwise from +x on.
        tilts: Tilts below the horizon (rad).
        models: Sensor models, or their prices by model; without prices only mounts cost.
        keep_out: Areas (m, world frame) whose mounts are not used.
        mounts: Mounts of the sensors, None for the site's.
        blind: True to keep poses whose field of view misses the whole detection area.

    Raises ValueError if an argument does not fit, `NoCandidates` if nothing remains.
    """
    available = site.mounts if mounts is None else mounts
    if len({mount.name for mount in available}) < len(available):
        raise ValueError(
            f"mounts[].name must differ, got {find_repeat(m.name for m in available)!r} twice: "
            "rename one"
        )
    spots = np.array([mount.position[:2] for mount in available]).reshape(-1, 2)
    open_mounts = tuple(
        compress(available, ~shapely.intersects_xy(shapely.union_all(list(keep_out)), *spots.T))
    )
    if not open_mounts:
        problem = (
            f"site {site.name!r} has no mount outside the keep-out areas (of {len(available)})"
        )
        raise NoCandidates(f"{problem}: give some poles")
    axes = _build_axes(heights, headings, tilts, models)
    feet = np.array([mount.position for mount in open_mounts])
    mounted = _clip_heights(open_mounts, axes.heights)  # axes: mount, height
    shape = (len(open_mounts), *axes.shape)
    is_in_range = np.broadcast_to(np.isfinite(mounted)[:, :, None, None, None], shape)
    factors = np.argwhere(is_in_range).astype(np.int64)
    height = mounted[factors[:, 0], factors[:, 1]]
    position = feet[factors[:, 0]] + height[:, None] * [0.0, 0.0, 1.0]
    bodies = np.empty((len(axes.headings), len(axes.tilts), 3, 3))
    for number, heading in enumerate(axes.headings.tolist()):
        for tilt_number, tilt in enumerate(axes.tilts.tolist()):
            bodies[number, tilt_number] = pose(yaw=heading, pitch=tilt)[:3, :3]
    # (headings, tilts, models, 3, 3): world axes from sensor axes
    rotations = np.stack([bodies @ model.body_SE3_sensor[:3, :3] for model in axes.models], axis=2)
    if not blind:
        is_visible = _mask_seeing_area(site, position, factors, rotations, axes.models)
        factors = factors[is_visible]
        position = position[is_visible]
    if not len(factors):
        remedy = "give other heights, headings, tilts or mounts"
        raise NoCandidates(f"no pose sees the area of site {site.name!r}: {remedy}")
    poses = np.tile(np.eye(4), (len(factors), 1, 1))
    poses[:, :3, :3] = rotations[tuple(factors[:, 2:].T)]
    poses[:, :3, 3] = position
    names = _build_names(open_mounts, mounted, axes, factors)
    sensors = tuple(
        Sensor(name, axes.models[factors[row, 4]], poses[row]) for row, name in enumerate(names)
    )
    return Candidates(sensors, open_mounts, factors, axes)


def choose_candidates(
    site: Site,
    which: str | Path,
    models: Sequence[SensorModel] = (),
    *,
    catalogue: SensorCatalogue | None = None,
    keep_out: Sequence[shapely.Geometry] = (),
) -> Candidates:
    """Candidates that a user names.

    Args:
        site: Site of the candidates.
        which: "pool" for every pose on the site's mounts, "paper" for the site's present sensors,
            else the path of a GeoJSON file of poles.
        models: Sensor models, empty for the paper's camera.
        catalogue: Models with prices, in place of `models`; it also prices the poles of a file.
        keep_out: Areas in addition to those in the file (m, world frame). A warning gives the
            number of mounts in them.

    Raises ValueError if models or areas are given for present sensors, and the errors of
    `load_poles` and `pool`.
    """
    if which == "paper":
        if models:
            raise ValueError(
                "the site's own sensors have their models: give models with 'pool' or a file of "
                "poles"
            )
        if keep_out:
            raise ValueError(
                "the site's own sensors hang already: keep-out areas are for 'pool' or a file of "
                "poles"
            )
        return paper_candidates(site)
    offer: Models = models or PAPER
    if catalogue is not None:
        offer = {item.model: item.price for item in catalogue.models}
    mounts = site.mounts if which == "pool" else load_poles(which, site, catalogue)
    if keep_out:
        spots = np.array([mount.position[:2] for mount in mounts]).reshape(-1, 2)
        barred_count = int(shapely.intersects_xy(shapely.union_all(list(keep_out)), *spots.T).sum())
        areas = f"{len(keep_out)} keep-out area{'s' * (len(keep_out) > 1)}"
        warnings.warn(
            f"{areas} at {site.name}: {barred_count} of {len(mounts)} poles stand there",
            stacklevel=3,
        )
    return pool(site, mounts=mounts, keep_out=keep_out, models=offer)


def own_and_random(
    site: Site, poses: int, rng: Rng, *, models: Sequence[SensorModel] = ()
) -> Candidates:
    """Present sensors of a site, each on a separate mount, then random poses of its pool.

    With present sensors the factors after the mount are all 0: axes do not describe the random
    poses.

    Args:
        site: Site with the sensors and mounts.
        poses: Number of random poses.
        rng: Generator that draws them.
        models: Sensor models of the random poses, empty for the paper's camera.

    Raises ValueError if the pool has fewer poses, or there would be no sensor.
    """
    all_poses = pool(site, models=tuple(models) or PAPER)
    min_poses = 0 if site.sensors else 1
    if not min_poses <= poses <= len(all_poses):
        raise ValueError(
            f"poses must be {min_poses} to the {len(all_poses)} of the pool of {site.name!r}, "
            f"got {poses}"
        )
    random_poses = all_poses.select(np.sort(rng.choice(len(all_poses), poses, replace=False)))
    if not site.sensors:
        return random_poses
    present = paper_candidates(site)
    mount = np.concatenate([present.mount, len(present.mounts) + random_poses.mount])
    factors = np.column_stack([mount, np.zeros((len(mount), 4), np.int64)])
    return replace(
        present,
        sensors=present.sensors + random_poses.sensors,
        mounts=present.mounts + random_poses.mounts,
        factors=factors,
    )


def random_sets(candidates: Candidates, present: int, count: int, rng: np.random.Generator) -> Sets:
    """Draw up to `count` different sets, as rows of booleans in ascending order.

    Half are from the first `present` candidates, if there are any. The others have 1 to
    `MAX_RANDOM_POSES` of the other candidates, at most one on a mount. The order of the draws from
    `rng` fixes the sets of a seed.

    Args:
        candidates: Present sensors, then poses.
        present: Number of present sensors, with which the candidates begin.
        count: Number of draws; equal sets are returned once.
        rng: Generator that draws.
    """
    sets = np.zeros((count, len(candidates)), bool)
    present_count = count // 2 if present else 0  # sets of present sensors
    for row in sets[:present_count]:
        size = rng.integers(1, present + 1)
        row[rng.choice(present, size, replace=False)] = True
    for row in sets[present_count:]:
        shuffled = present + rng.permutation(len(candidates) - present)
        _, first_on_mount = np.unique(candidates.mount[shuffled], return_index=True)
        members = shuffled[np.sort(first_on_mount)]  # the first of each mount, still shuffled
        row[members[: rng.integers(1, MAX_RANDOM_POSES + 1)]] = True
    return np.unique(sets, axis=0)


def _build_axes(
    heights: Sequence[float], headings: int, tilts: Sequence[float], models: Models
) -> Axes:
    """Axes of a pool: heights and tilts ascending, each once.

    Args:
        heights: Heights above the mount's foot (m).
        headings: Number of headings, evenly spaced from +x on.
        tilts: Tilts below the horizon (rad).
        models: Sensor models, or their prices by model.

    Raises ValueError if an argument does not fit."""
    if headings < 1 or not (len(heights) and len(tilts) and len(models)):
        raise ValueError("a pool needs at least one height, heading, tilt and sensor model")
    if not (np.isfinite(heights).all() and min(heights) >= 0):
        raise ValueError(f"heights must be finite and not negative, got {list(heights)}")
    if not (np.isfinite(tilts).all() and np.abs(tilts).max() <= np.pi / 2):
        raise ValueError(
            f"tilts must lie in -pi/2..pi/2 rad, got {list(tilts)}: give degrees as np.deg2rad(10)"
        )
    prices = tuple(float(price) for price in models.values()) if isinstance(models, Mapping) else ()
    return Axes(
        heights=np.unique(np.asarray(heights, np.float64)),
        headings=np.arange(headings) * 2 * np.pi / headings,
        tilts=np.unique(np.asarray(tilts, np.float64)),
        models=tuple(dict.fromkeys(models)),
        prices=prices,
    )


def _clip_heights(
    mounts: Sequence[Mount], heights: np.ndarray
) -> Float64[np.ndarray, "mounts heights"]:
    """Each height (m above the foot), clipped to the range of each mount.

    Several heights may be clipped to the same one; only the nearest to it then has it, and the
    others are NaN."""
    mounted_heights = np.full((len(mounts), len(heights)), np.nan)  # axes: mount, height
    for row, mount in enumerate(mounts):
        clipped_heights = np.clip(heights, mount.min_height, mount.max_height)
        # indices of the heights, those that clipping moves least first
        nearest_first = np.argsort(np.abs(clipped_heights - heights), kind="stable")
        # different heights, and where each comes first
        values, first = np.unique(clipped_heights[nearest_first], return_index=True)
        mounted_heights[row, nearest_first[first]] = values
    return mounted_heights


def _mask_seeing_area(
    site: Site,
    position: np.ndarray,
    factors: np.ndarray,
    rotations: np.ndarray,
    models: Sequence[SensorModel],
) -> Bool[np.ndarray, " candidates"]:
    """Mask of poses with a part of the area in view, without occlusion.

    Args:
        site: Site with the area, checked at `AREA_CELLS` x `AREA_CELLS` points.
        position: (candidates, 3) position of each pose (m, world frame).
        factors: (candidates, 5) indices of each pose's mount, height, heading, tilt and model.
        rotations: (headings, tilts, models, 3, 3) world axes from sensor axes.
        models: Sensor models."""
    xmin, ymin, xmax, ymax = site.area
    middles = (np.arange(AREA_CELLS) + 0.5) / AREA_CELLS
    x, y = np.meshgrid(xmin + middles * (xmax - xmin), ymin + middles * (ymax - ymin))
    z = site.ground(np.stack([x, y], axis=-1)) + AREA_HEIGHT_M
    checked_points = np.stack([x, y, z], axis=-1).reshape(-1, 3)
    has_view = np.zeros(len(factors), bool)
    # indices of each combination; all its poses are turned alike
    for heading, tilt, model in np.ndindex(rotations.shape[:3]):
        rows = np.flatnonzero((factors[:, 2:] == (heading, tilt, model)).all(axis=1))
        # the points in each sensor's axes, (poses, points, 3)
        offsets = (checked_points - position[rows, None]) @ rotations[heading, tilt, model]
        has_view[rows] = models[model].in_view(offsets).any(axis=1)
    return has_view


def _build_names(
    mounts: Sequence[Mount], mounted: np.ndarray, axes: Axes, factors: np.ndarray
) -> list[str]:
    """Name of each candidate, such as post07_6.0m_h90_t15_camera.

    Its parts are mount, height above the foot, heading and tilt (deg), and kind of model, numbered
    from 0 if several models are of one kind.

    Args:
        mounts: The mounts.
        mounted: (mounts, heights) heights above the foot (m), clipped to the mount's range.
        axes: Headings, tilts and models.
        factors: (candidates, 5) indices of each one's mount, height, heading, tilt and model."""
    mount_index, height_index = factors[:, :2].T
    heading_index, tilt_index = factors[:, 2:4].T
    model_index = factors[:, 4]
    # heights that occur, and the number among these of each candidate's height
    heights, height_number = np.unique(mounted[mount_index, height_index], return_inverse=True)
    height_texts = _format_distinct(heights, decimals=1)
    heading_texts = _format_distinct(np.rad2deg(axes.headings), decimals=0)
    tilt_texts = _format_distinct(np.rad2deg(axes.tilts), decimals=0)
    kinds = [model.kind for model in axes.models]
    model_texts = []
    for number, kind in enumerate(kinds):
        is_single = kinds.count(kind) == 1
        model_texts.append(kind if is_single else f"{kind}{kinds[:number].count(kind)}")
    poles = [name_sensor(mount.name) for mount in mounts]
    names = []
    for c in range(len(factors)):
        place = f"{poles[mount_index[c]]}_{height_texts[height_number[c]]}m"
        angles = f"h{heading_texts[heading_index[c]]}_t{tilt_texts[tilt_index[c]]}"
        names.append(f"{place}_{angles}_{model_texts[model_index[c]]}")
    return names


def name_sensor(pole: str) -> str:
    """Name of a pole as part of a sensor's name, which a recording has as a group: - for /."""
    return pole.replace("/", "-")


def _format_distinct(values: np.ndarray, decimals: int) -> list[str]:
    """Texts of different numbers with `decimals` decimals, or with more if needed to differ."""
    texts = [f"{value:.{decimals}f}" for value in values]
    if len(set(texts)) == len(texts) or decimals > 15:
        return texts
    return _format_distinct(values, decimals + 1)


def with_terms(candidates: Candidates, pole_price: float, capacity: float | None) -> Candidates:
    """Copy of candidates with mounts priced in a currency, and another capacity of links.

    Args:
        candidates: Candidates whose mounts are priced in ordinary poles.
        pole_price: Price of an ordinary pole in the currency; 1 keeps prices.
        capacity: Capacity of each mount's link (kbit per frame), None to keep theirs."""
    mounts = []
    for mount in candidates.mounts:
        new_capacity = mount.capacity if capacity is None else capacity
        mounts.append(replace(mount, price=mount.price * pole_price, capacity=new_capacity))
    return replace(candidates, mounts=tuple(mounts))
