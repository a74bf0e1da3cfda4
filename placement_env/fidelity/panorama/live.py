"""`LiveView`: immediate views of moving sensors.

Sensors may be turned, tilted, raised and lowered on their mounts. Panoramas of all frames are made at every half metre
of a mount's height when one of its sensors is first requested. Between two of these heights the view is interpolated;
heading and tilt are looked up.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from threading import Lock
from typing import Literal

import numpy as np

from placement_env.candidates.candidates import Candidates
from placement_env.fidelity.panorama.bounded import Bounded
from placement_env.fidelity.panorama.ray_table import Lookup
from placement_env.fidelity.panorama.surround import ScoredItems, Still, Surround, find_place_strips, successive_strips
from placement_env.fidelity.traffic import Traffic, build_renderer
from placement_env.fidelity.visibility import Visibility, distances
from toolkit.arrays import Float64
from toolkit.objects import VEHICLE
from toolkit.rendering.strips import Strips
from toolkit.runtime.cache import Cache, make_key, recall
from toolkit.runtime.code_digest import code_digest
from toolkit.sensors.sensor import Sensor, SensorModel
from toolkit.sites.site import Mount

HEIGHT_STEP = 0.5  # m between the panoramas of a mount
MOST_BYTES = 600_000_000  # of the panoramas kept in memory

Place = tuple[float, float, float]
Reach = Literal["mount", "own", "nearest"]


class LiveView:
    """Look at traffic from mounts, with sensors that measure all of the detection area (`seeing.choose_quick`).

    labels: classes (numbers) of the objects that count; cache: where panoramas are kept and shared with other
    processes, None for this object's memory.
    """

    def __init__(self, traffic: Traffic, labels: Sequence[int] = (VEHICLE,), cache: Cache | None = None) -> None:
        self.traffic, self._cache = traffic, cache
        self._unseen = Visibility.unseen(traffic, (), labels)
        self._scored = ScoredItems.of(traffic, traffic.snapshots, labels)
        self._kept, self._most = Bounded(), MOST_BYTES  # surrounds by place
        self.casting = Lock()  # held while rays are cast: others may look at what is there

    def see(self, candidates: Candidates, *, reach: Reach = "mount") -> Visibility:
        """View of candidates. The first from a mount makes panoramas of all its heights.

        reach: "own" makes one at each sensor's own height alone, "nearest" one at the nearest half metre, for a sensor
        whose own height has none and that none below and above are known of.
        """
        sensors = candidates.sensors
        mounts = [candidates.mounts[index] for index in candidates.mount.tolist()]
        shares = [_between(sensor.position, mount) for sensor, mount in zip(sensors, mounts, strict=True)]
        if reach != "mount":
            own = [[(_place(*sensor.position.tolist()), 1.0)] for sensor in sensors]
            for s, sensor in enumerate(sensors):
                if reach == "own" or self.knows(sensor):
                    shares[s] = own[s]
                elif not self._knows(shares[s], sensor.model):
                    shares[s] = [(max(shares[s], key=lambda each: each[1])[0], 1.0)]
        wanted = [(place, mount) for each, mount in zip(shares, mounts, strict=True) for place, _ in each]
        surrounds = self._prepare(wanted, {sensor.model for sensor in sensors}, whole=reach == "mount")
        points = np.zeros((len(sensors), self._scored.items))
        sent, far = np.zeros((2, len(sensors), self._scored.frames))
        for s, sensor in enumerate(sensors):
            lookup = Lookup.of(sensor)
            for place, share in shares[s]:
                for total, figures in zip((points, sent, far), surrounds[place].seen(lookup), strict=True):
                    total[s] += share * figures
        seen = {"points": points.astype(np.float32), "sent": sent.astype(np.float32), "far": far.astype(np.float32)}
        return replace(self._unseen, distance=distances(sensors, self._unseen.boxes), **seen)

    def knows(self, sensor: Sensor) -> bool:
        """True where the view from a sensor's own height needs no panorama."""
        return self._knows([(_place(*sensor.position.tolist()), 1.0)], sensor.model)

    def limit(self, most: int) -> None:
        """Keep panoramas of at most so many bytes in memory."""
        self._most = most

    @property
    def full(self) -> bool:
        """True where memory has hardly room for another panorama."""
        return self._kept.nbytes > 0.9 * self._most

    def _knows(self, shares: list[tuple[Place, float]], model: SensorModel) -> bool:
        return all(place in self._kept and model in self._kept[place].stills for place, _ in shares)

    def _prepare(
        self, wanted: list[tuple[Place, Mount]], models: set[SensorModel], *, whole: bool
    ) -> dict[Place, Surround]:
        """Views from places, made where they lack."""
        asked = dict.fromkeys(place for place, _ in wanted)
        found = {place: self._kept[place] for place in asked if place in self._kept}  # held, whatever is dropped
        if len(found) == len(asked) and all(models <= each.stills.keys() for each in found.values()):
            return found
        with self.casting:
            return found | self._make(wanted, models, whole=whole)

    def _make(
        self, wanted: list[tuple[Place, Mount]], models: set[SensorModel], *, whole: bool
    ) -> dict[Place, Surround]:

        def lacks(place: Place) -> bool:
            return place not in self._kept or not models <= self._kept[place].stills.keys()

        asked, renderer = dict.fromkeys(place for place, _ in wanted), build_renderer(self.traffic)
        more = {each for place, mount in wanted if whole and lacks(place) for each in _places(place, mount)}
        places = sorted(filter(lacks, {*asked, *more}))
        for place, strips in zip(places, self._panoramas(places), strict=True):
            stills = dict(self._kept[place].stills) if place in self._kept else {}
            for model in models - stills.keys():
                stills[model] = Still.of(renderer, self.traffic.site, np.array(place), model)
            self._kept[place] = Surround.of(strips, self._scored, stills)
        found = {place: self._kept[place] for place in asked}
        self._kept.keep(found, self._most)
        return found

    def _panoramas(self, places: list[Place]) -> list[Strips]:

        def make(missing: list[int]) -> list[Strips]:
            successive = successive_strips(self.traffic, np.array(places)[missing])
            return find_place_strips(successive, self.traffic, range(len(self.traffic)), len(missing))

        keys = [make_key("panorama", code_digest(__name__), self.traffic.digest(), place) for place in places]
        return [Strips(*arrays) for arrays in recall(self._cache, keys, make)]


def _between(position: Float64[np.ndarray, "3"], mount: Mount) -> list[tuple[Place, float]]:
    """Panorama places below and above a position on a mount."""
    x, y, z = position.tolist()
    foot = float(mount.position[2])
    steps = round((z - foot) / HEIGHT_STEP, 6)
    below = int(np.floor(steps))
    share = steps - below
    each = [(below, 1 - share), (below + 1, share)]
    return [(_place(x, y, foot + step * HEIGHT_STEP), part) for step, part in each if part > 0]


def _places(place: Place, mount: Mount) -> list[Place]:
    """Panorama places for all heights of a sensor on a mount."""
    low, high = (h / HEIGHT_STEP for h in (mount.min_height, mount.max_height))
    steps = range(int(np.floor(low + 1e-6)), int(np.ceil(high - 1e-6)) + 1)
    return [_place(*place[:2], float(mount.position[2]) + step * HEIGHT_STEP) for step in steps]


def _place(x: float, y: float, z: float) -> Place:
    return round(x, 6), round(y, 6), round(z, 6)
