"""`LiveView`: immediate views of moving sensors.

Sensors may be turned, tilted, raised and lowered on their mounts. Panoramas of all frames are made at every half metre
of a mount's height when one of its sensors is first requested. Between two of these heights the view is interpolated;
heading and tilt are looked up.
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Iterable, Sequence
from functools import lru_cache
from itertools import pairwise

import numpy as np

from placement_env.candidates.candidates import Candidates
from placement_env.fidelity.panorama.looking import table_keys
from placement_env.fidelity.panorama.ray_table import ray_table
from placement_env.fidelity.panorama.still import Still
from placement_env.fidelity.panorama.surround import Packed, ScoredItems, Surround
from placement_env.fidelity.traffic import Traffic, build_renderer, scored
from placement_env.fidelity.visibility import Visibility, distances, list_objects
from toolkit.arrays import Float64
from toolkit.objects import VEHICLE
from toolkit.points import Crop, has_centre_inside
from toolkit.rendering.renderer import Moment
from toolkit.rendering.strips import Counted, Strips, SuccessiveStrips, concatenate_strips
from toolkit.runtime.cache import Cache, make_key
from toolkit.runtime.code_digest import code_digest
from toolkit.sensors.sensor import SensorModel
from toolkit.sites.site import Mount

HEIGHT_STEP = 0.5  # m between the panoramas of a mount
MOST_STRIPS = 20_000_000  # strips kept in memory over all places, about 60 bytes each
MOST_MOMENTS = 64  # frames whose scenes are kept

Place = tuple[float, float, float]


class LiveView:
    """Look at traffic from mounts.

    labels: classes (numbers) of the objects that count; cache: where panoramas are kept and shared with other
    processes, None for this object's memory. Sensors must measure all of the detection area, see
    `placement_env.fidelity.panorama.panoramas.far_sighted`.
    """

    def __init__(self, traffic: Traffic, labels: Sequence[int] = (VEHICLE,), cache: Cache | None = None) -> None:
        self.traffic, self._cache = traffic, cache
        self._renderer = build_renderer(traffic)
        self._frame, self._boxes, self._kinds = list_objects(traffic, labels)
        of_frames = [scored(each.objects, traffic.site, labels) for each in traffic.snapshots]
        counts = np.concatenate([np.zeros(0, np.bool_), *of_frames])
        frame = np.repeat(np.arange(len(traffic)), [len(each) for each in of_frames])
        place = np.where(counts, np.cumsum(counts) - 1, len(self._boxes))
        self._scored = ScoredItems(place, frame, len(self._boxes), len(traffic))
        self._kept: OrderedDict[Place, Surround] = OrderedDict()  # least recently used first
        self._moment = lru_cache(maxsize=MOST_MOMENTS)(self._moment_of)

    def see(self, candidates: Candidates) -> Visibility:
        """View of candidates. The first request for a mount makes its panoramas."""
        sensors = candidates.sensors
        models = {sensor.model for sensor in sensors}
        mounts = [candidates.mounts[index] for index in candidates.mount.tolist()]
        shares = [_between(sensor.position, mount) for sensor, mount in zip(sensors, mounts, strict=True)]
        self._prepare([(place, mount) for each, mount in zip(shares, mounts, strict=True) for place, _ in each], models)
        shape = (len(sensors), self._scored.items), (len(sensors), self._scored.frames)
        points, sent, far = (np.zeros(each) for each in (shape[0], shape[1], shape[1]))
        for s, (key, turned, more) in enumerate(zip(*table_keys(sensors), strict=True)):
            table = ray_table(*key)
            for place, share in shares[s]:
                seen = self._kept[place].seen(key[0], table, float(turned), float(more), self._scored)
                for total, figures in zip((points, sent, far), seen, strict=True):
                    total[s] += share * figures
        seen_of = [each.astype(np.float32) for each in (points, sent, far)]
        columns = (distances(sensors, self._boxes), self._frame, self._boxes, *seen_of[1:], self._kinds)
        return Visibility(seen_of[0], *columns)

    def _prepare(self, wanted: Iterable[tuple[Place, Mount]], models: set[SensorModel]) -> None:
        """Load or make panoramas of places. Those above and below on their mounts are included."""
        asked = dict.fromkeys(place for place, _ in wanted)
        missing = [(place, mount) for place, mount in wanted if self._lacks(place, models)]
        if missing:
            whole = {each for place, mount in missing for each in (place, *_places(place, mount))}
            places = sorted(place for place in whole if self._lacks(place, models))
            for place, packed in zip(places, self._panoramas(places), strict=True):
                self._kept[place] = Surround.of(packed, self._scored, self._stills(place, models))
        for place in asked:
            self._kept.move_to_end(place)
        while len(self._kept) > len(asked) and sum(len(each.item) for each in self._kept.values()) > MOST_STRIPS:
            self._kept.popitem(last=False)

    def _panoramas(self, places: list[Place]) -> list[Packed]:
        """Packed strips of places, from the cache or made."""
        code, digest = code_digest(__name__), self.traffic.digest()
        keys = [make_key("panorama", code, digest, place) for place in places]
        found = [None] * len(keys) if self._cache is None else self._cache.get(keys)
        missing = [k for k, arrays in enumerate(found) if arrays is None]
        made = dict(zip(missing, self._made([places[k] for k in missing]), strict=True))
        if self._cache is not None and made:
            self._cache.put({keys[k]: packed for k, packed in made.items()})
        return [made[k] if arrays is None else Packed(*arrays) for k, arrays in enumerate(found)]

    def _made(self, places: list[Place]) -> list[Packed]:
        if not places:
            return []
        site, first, parts = self.traffic.site, 0, []
        successive = SuccessiveStrips(self._renderer, np.array(places), Counted(Crop.of(site), site.hybrid_radius))
        for k, snapshot in enumerate(self.traffic.snapshots):
            fine = has_centre_inside(snapshot.objects.boxes, site.area)
            strips = successive.of(self._moment(k), fine)
            parts.append(strips._replace(item=strips.item + np.int32(first)))
            first += len(fine)
        whole = concatenate_strips(parts)
        order = np.argsort(whole.viewpoint, kind="stable")
        ends = np.searchsorted(whole.viewpoint[order], np.arange(len(places) + 1))
        return [Packed.of(Strips(*(each[order[begin:end]] for each in whole))) for begin, end in pairwise(ends)]

    def _stills(self, place: Place, models: set[SensorModel]) -> dict[SensorModel, Still]:
        known = self._kept[place].stills if place in self._kept else {}
        site, here = self.traffic.site, np.array([place])
        return known | {model: Still.of(self._renderer, site, here, model) for model in models - known.keys()}

    def _lacks(self, place: Place, models: set[SensorModel]) -> bool:
        return place not in self._kept or not models <= self._kept[place].stills.keys()

    def _moment_of(self, k: int) -> Moment:
        return self._renderer.moment(self.traffic.snapshots[k])


def _between(position: Float64[np.ndarray, "3"], mount: Mount) -> list[tuple[Place, float]]:
    """Panorama places below and above a position, with shares. The position is on a mount."""
    x, y, z = position.tolist()
    foot = float(mount.position[2])
    steps = round((z - foot) / HEIGHT_STEP, 6)
    below = int(np.floor(steps))
    share = steps - below
    each = [(below, 1 - share), (below + 1, share)]
    return [(_place(x, y, foot + step * HEIGHT_STEP), part) for step, part in each if part > 0]


def _places(place: Place, mount: Mount) -> list[Place]:
    """Panorama places for all heights of a sensor. They are above and below a place on its mount."""
    low, high = (h / HEIGHT_STEP for h in (mount.min_height, mount.max_height))
    steps = range(int(np.floor(low + 1e-6)), int(np.ceil(high - 1e-6)) + 1)
    return [_place(*place[:2], float(mount.position[2]) + step * HEIGHT_STEP) for step in steps]


def _place(x: float, y: float, z: float) -> Place:
    return round(x, 6), round(y, 6), round(z, 6)
