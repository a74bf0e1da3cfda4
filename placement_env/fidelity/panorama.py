"""`TrafficView`: immediate views of moving sensors.

A panorama, or `Surround`, has the moving objects of all frames seen from one place.

Sensors may be turned, tilted, raised and lowered on their mounts. Panoramas of all frames are made
at every half metre of a mount's height when one of its sensors is first requested. Between two of
these heights the view is interpolated; heading and tilt are looked up."""

import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from threading import Lock
from typing import Any, Literal, NamedTuple

import numpy as np

from placement_env.candidates.candidates import Candidates
from placement_env.fidelity.bounded import Bounded
from placement_env.fidelity.ray_table import Lookup
from placement_env.fidelity.still import Still
from placement_env.fidelity.surround import ScoredItems, Surround, place_strips, successive_strips
from placement_env.fidelity.traffic import Traffic, build_renderer
from placement_env.fidelity.visibility import Visibility, distances
from toolkit.arrays import Float64
from toolkit.objects import VEHICLE
from toolkit.rendering.strips import Strips
from toolkit.runtime.cache import Cache, code_digest, make_key, recall
from toolkit.sensors.sensor import Sensor, SensorModel
from toolkit.sites.site import Mount

HEIGHT_STEP_M = 0.5  # m between the panoramas of a mount
MAX_HEIGHT_GAP_M = 1.5  # m of height within which a first view is taken from another panorama
DEFAULT_PANORAMA_BYTES = 600_000_000  # memory of the panoramas that are kept
FULL_SHARE = 0.9  # share of this memory beyond which it counts as full
HOLD_PAUSE_S = 0.001  # s between two questions to `TrafficView.hold`
Place = tuple[float, float, float]  # x, y, z (m, world frame), rounded to 1e-6 m
_MountPlaces = list[tuple[Place, Mount]]  # places of panoramas, each with the mount it belongs to
Reach = Literal["mount", "own", "nearest"]  # panoramas made for a sensor, see `TrafficView.see`


class _Share(NamedTuple):
    """Place of a panorama, and its weight (0 to 1) in the view of a sensor."""

    place: Place
    weight: float


def _never() -> bool:
    # `hold` of a view that need not wait
    return False


class TrafficView:
    """Points of sensors that move on mounts, in all frames of traffic, from panoramas.

    Only sensors that measure all of the detection area can be seen so (`seeing.choose_quick`).
    A copy, also one that is pickled, keeps the panoramas and goes on without the original: nobody
    waits for it.

    Args:
        traffic: Frames to look at.
        labels: Classes (numbers) of the objects that count.
        cache: Keeps panoramas for other processes too, None to keep them in this object's memory
            only.

    Attributes:
        surrounds: Panoramas in memory by place, the longest unused first.
        casting: Lock that a thread holds while it casts rays.
        hold: Function that is asked before each frame of a panorama; while it returns True, the
            thread that casts waits, unless another thread waits to cast."""

    def __init__(
        self, traffic: Traffic, labels: Sequence[int] = (VEHICLE,), cache: Cache | None = None
    ) -> None:
        """Begin without panoramas.

        labels: classes of the objects that count; cache: where strips are kept, None for nowhere.
        """
        self.traffic = traffic
        self._cache = cache
        self._unseen = Visibility.unseen(traffic, (), labels)  # without a sensor
        self._scored = ScoredItems.from_snapshots(traffic, traffic.snapshots, labels)
        self.surrounds = Bounded()
        self._max_bytes = DEFAULT_PANORAMA_BYTES
        self._reset_threads()

    def _reset_threads(self) -> None:
        """Set lock, queue and `hold` as in an object that no thread uses."""
        self.casting = Lock()  # held while rays are cast: others may look at what is there
        # an entry for each thread that waits to cast; a list, as threads may change it
        self._waiting: list[None] = []
        # asked before each frame of a panorama: True to wait
        self.hold: Callable[[], bool] = _never

    def __getstate__(self) -> dict[str, Any]:
        """Fields to pickle, without what serves threads."""
        with self.casting:  # no panorama is added meanwhile
            state = {**self.__dict__, "surrounds": self.surrounds.copy()}
        for name in ("casting", "_waiting", "hold"):
            del state[name]
        return state

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        self._reset_threads()

    def see(self, candidates: Candidates, *, reach: Reach = "mount") -> Visibility:
        """Return the visibility of all scored objects from candidates.

        Between two panoramas of a mount, points are interpolated by height.

        Args:
            candidates: Candidates whose sensors measure all of the detection area.
            reach: Panoramas to use. "mount" takes those at the half metres below and above each
                sensor; the first sensor of a mount makes panoramas at all of its half metres. "own"
                takes one at the sensor's height. "nearest" takes known ones at that height, or
                at the half metres below and above, or the nearest within `MAX_HEIGHT_GAP_M`; if
                there is none, it makes one at the nearest half metre.
        """
        sensors = candidates.sensors
        mounts = [candidates.mounts[index] for index in candidates.mount.tolist()]
        # panoramas of each sensor, with their weights
        shares = [
            self._share_places(sensor, mount, reach)
            for sensor, mount in zip(sensors, mounts, strict=True)
        ]
        places = [
            (share.place, mount)
            for sensor_shares, mount in zip(shares, mounts, strict=True)
            for share in sensor_shares
        ]
        surrounds = self._prepare(
            places, {sensor.model for sensor in sensors}, all_heights=reach == "mount"
        )
        points = np.zeros((len(sensors), self._scored.items))
        sent, far = np.zeros((2, len(sensors), self._scored.frames))
        for s, sensor in enumerate(sensors):
            lookup = Lookup.from_sensor(sensor)
            for place, weight in shares[s]:
                seen = surrounds[place].seen(lookup)
                points[s] += weight * seen.points
                sent[s] += weight * seen.sent
                far[s] += weight * seen.far
        return replace(
            self._unseen,
            distance=distances(sensors, self._unseen.boxes),
            points=points.astype(np.float32),
            sent=sent.astype(np.float32),
            far=far.astype(np.float32),
        )

    def _share_places(self, sensor: Sensor, mount: Mount, reach: Reach) -> list[_Share]:
        """Return the places of the panoramas to use for a sensor, each with its weight.

        A panorama has the objects of all frames seen from one place. The weights add up to 1.

        reach: "mount" for the half metres below and above the sensor on its mount, "own" for its
            exact place, "nearest" for panoramas in memory if possible."""
        shares = _find_half_metres(sensor.position, mount)
        if reach == "mount":
            return shares
        sensor_place = _round_place(*sensor.position.tolist())
        if reach == "own" or self.knows(sensor):
            return [_Share(sensor_place, 1.0)]
        if self._has_panoramas([share.place for share in shares], sensor.model):
            return shares
        near_place = self._find_near(sensor_place, sensor.model)
        if near_place is None:
            # the nearest half metre
            near_place = max(shares, key=lambda share: share.weight).place
        return [_Share(near_place, 1.0)]

    def _find_near(self, sensor_place: Place, model: SensorModel) -> Place | None:
        """Return the place of the nearest known panorama within `MAX_HEIGHT_GAP_M` above or below.

        A panorama is known if it is in memory with the static scene for this model. None
        without one."""
        x, y, z = sensor_place

        def height_gap(place: Place) -> float:
            """Height (m) from the sensor up or down to a place."""
            _, _, place_z = place
            return abs(place_z - z)

        # a list, as other threads may add panoramas meanwhile
        near_places = [
            place
            for place in list(self.surrounds)
            if place[:2] == (x, y) and height_gap(place) <= MAX_HEIGHT_GAP_M
        ]
        known_places = [place for place in near_places if self._has_panoramas([place], model)]
        return min(known_places, key=height_gap, default=None)

    def knows(self, sensor: Sensor) -> bool:
        """True if a panorama at the sensor's exact position is in memory, for its model."""
        place = _round_place(*sensor.position.tolist())
        return self._has_panoramas([place], sensor.model)

    def limit(self, max_bytes: int) -> None:
        """Limit the memory of panoramas to so many bytes, from the next one that is made on."""
        self._max_bytes = max_bytes

    @property
    def full(self) -> bool:
        """True if panoramas fill `FULL_SHARE` of their memory, so that another may drop one."""
        return self.surrounds.nbytes > FULL_SHARE * self._max_bytes

    def _has_panoramas(self, places: list[Place], model: SensorModel) -> bool:
        """Return True if panoramas at all of the places are in memory, for this model."""
        surrounds = [self.surrounds.get(place) for place in places]
        return all(surround is not None and model in surround.stills for surround in surrounds)

    def _prepare(
        self, mount_places: _MountPlaces, models: set[SensorModel], *, all_heights: bool
    ) -> dict[Place, Surround]:
        """Return the panorama of each place, from memory or made now under the lock `casting`.

        A panorama has the moving objects of all frames seen from one place.

        Args:
            mount_places: Requested places, each with its mount; repetitions do not matter.
            models: Sensor models that each panorama must serve.
            all_heights: Make missing panoramas at all half metres of the mount too."""
        requested = dict.fromkeys(place for place, _ in mount_places)
        # references keep these alive even if another thread drops them from memory
        kept_surrounds = {place: self.surrounds.get(place) for place in requested}
        surrounds = {
            place: surround for place, surround in kept_surrounds.items() if surround is not None
        }
        if len(surrounds) == len(requested) and all(
            models <= surround.stills.keys() for surround in surrounds.values()
        ):
            return surrounds
        self._waiting.append(None)  # a held thread goes on then, see `_iterate_frames`
        with self.casting:
            self._waiting.pop()
            return surrounds | self._make_surrounds(mount_places, models, all_heights=all_heights)

    def _iterate_frames(self) -> Iterator[int]:
        """Yield the indices of all frames, each when `hold` allows the next one.

        A thread that waits to cast overrides `hold`, so that it need not wait for a held one."""
        for k in range(len(self.traffic)):
            while self.hold() and not self._waiting:
                time.sleep(HOLD_PAUSE_S)
            yield k

    def _make_surrounds(
        self, mount_places: _MountPlaces, models: set[SensorModel], *, all_heights: bool
    ) -> dict[Place, Surround]:
        """Make missing panoramas, keep them in memory, and return the requested ones.

        The caller holds `casting`.

        Args:
            mount_places: Requested places, each with its mount.
            models: Sensor models that each panorama must serve.
            all_heights: Make missing panoramas at all half metres of the mount too."""

        def lacks(place: Place) -> bool:
            # True without a panorama there, or with one that does not serve all of the models
            return place not in self.surrounds or not models <= self.surrounds[place].stills.keys()

        requested = dict.fromkeys(place for place, _ in mount_places)
        renderer = build_renderer(self.traffic)
        other_heights = {
            height_place
            for place, mount in mount_places
            if all_heights and lacks(place)
            for height_place in _list_mount_places(place, mount)
        }
        missing_places = sorted(filter(lacks, {*requested, *other_heights}))
        for place, strips in zip(missing_places, self._find_strips(missing_places), strict=True):
            stills = dict(self.surrounds[place].stills) if place in self.surrounds else {}
            for model in models - stills.keys():
                stills[model] = Still.from_renderer(
                    renderer, self.traffic.site, np.array(place), model
                )
            self.surrounds[place] = Surround.from_strips(strips, self._scored, stills)
        surrounds = {place: self.surrounds[place] for place in requested}
        self.surrounds.keep(surrounds, self._max_bytes)  # may drop others
        return surrounds

    def _find_strips(self, places: list[Place]) -> list[Strips]:
        """Return the strips seen from each place in all frames, from the cache or made now."""

        def make(missing: list[int]) -> list[Strips]:
            """Strips seen from the places with these indices."""
            successive = successive_strips(self.traffic, np.array(places)[missing])
            return place_strips(successive, self.traffic, self._iterate_frames(), len(missing))

        keys = [b"" for _ in places]  # without a cache no keys, which take long to make
        if self._cache is not None:
            keys = [
                make_key("panorama", code_digest(__name__), self.traffic.digest(), place)
                for place in places
            ]
        return [Strips(*arrays) for arrays in recall(self._cache, keys, make)]


def _find_half_metres(position: Float64[np.ndarray, "3"], mount: Mount) -> list[_Share]:
    """Places of the panoramas below and above a position on a mount, each with its weight.

    Weights interpolate linearly by height. There is only one place if the position is a multiple of
    `HEIGHT_STEP_M` above the mount's foot."""
    x, y, z = position.tolist()
    foot_z = float(mount.position[2])
    steps = round((z - foot_z) / HEIGHT_STEP_M, 6)  # height above the foot
    below = int(np.floor(steps))
    weight_above = steps - below
    weighted_steps = [(below, 1 - weight_above), (below + 1, weight_above)]
    return [
        _Share(place=_round_place(x, y, foot_z + step * HEIGHT_STEP_M), weight=weight)
        for step, weight in weighted_steps
        if weight > 0
    ]


def _list_mount_places(place: Place, mount: Mount) -> list[Place]:
    """Places of panoramas at all heights of a mount (`list_heights`), at the x and y of a place."""
    x, y, _ = place
    foot_z = float(mount.position[2])
    return [_round_place(x, y, foot_z + height) for height in list_heights(mount)]


def list_heights(mount: Mount) -> list[float]:
    """Heights of panoramas above a mount's foot (m): multiples of `HEIGHT_STEP_M`, ascending.

    The first is at or below the lowest sensor of the mount, the last at or above the highest."""
    first_step = int(np.floor(mount.min_height / HEIGHT_STEP_M + 1e-6))  # 1e-6: rounding
    last_step = int(np.ceil(mount.max_height / HEIGHT_STEP_M - 1e-6))
    return [step * HEIGHT_STEP_M for step in range(first_step, last_step + 1)]


def _round_place(x: float, y: float, z: float) -> Place:
    # place as a key: rounded, so that equal places from different sums are equal
    return round(x, 6), round(y, 6), round(z, 6)
