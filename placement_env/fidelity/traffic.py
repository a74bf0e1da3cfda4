"""`Traffic`: the frames that judge every sensor set."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from hashlib import sha256
from typing import TYPE_CHECKING

import numpy as np

from placement_env.checks import check_whole
from toolkit.arrays import Mask
from toolkit.bodies.body import Body
from toolkit.bodies.fleet import fleet_named
from toolkit.frozen import set_cached
from toolkit.objects import VEHICLE, Objects
from toolkit.points import has_centre_inside
from toolkit.runtime.sent_once import SentOnce
from toolkit.sites.files import format_site
from toolkit.sites.site import Site
from toolkit.traffic.snapshots import Mix, Snapshot, simulate
from toolkit.traffic.spawner import LIFE
from toolkit.traffic.sumo import FINE_STEP_S

if TYPE_CHECKING:
    from toolkit.rendering.renderer import Renderer

FRAMES = 200  # frames of traffic unless a run has another number
MAX_KEPT_TRAFFIC = 4  # simulations held in memory
_KEPT: "dict[tuple[str, int, int], Traffic]" = {}  # by text of the site's file, frames and seed


@dataclass(frozen=True, eq=False)
class Traffic(SentOnce):
    """Frames of traffic on a site, which all sensor sets are scored on.

    Attributes:
        site: Site of the traffic.
        bodies: Bodies whose indices the frames give for their objects.
        snapshots: The frames in order of time."""

    site: Site
    bodies: tuple[Body, ...]
    snapshots: tuple[Snapshot, ...]

    def __len__(self) -> int:
        return len(self.snapshots)

    def every(self, stride: int) -> "Traffic":
        """Same traffic with only every stride-th frame, from the first on."""
        return self if stride == 1 else self._of(self.snapshots[::stride])

    def part(self, first: int, end: int) -> "Traffic":
        """Same traffic with only the frames from `first` to before `end` (indices)."""
        return self._of(self.snapshots[first:end])

    def _of(self, snapshots: tuple[Snapshot, ...]) -> "Traffic":
        """Traffic with other frames; site and bodies are the same, so their digest is shared."""
        traffic = replace(self, snapshots=snapshots)
        set_cached(traffic, _scene=self._scene)
        return traffic

    def digest(self) -> str:
        """SHA-256 (hexadecimal) over site, bodies and frames.

        Equal digests mean that everything a sensor might see is equal."""
        return self._digest

    @cached_property
    def _scene(self) -> bytes:
        """SHA-256 (bytes) over site and bodies, shared by parts of the same traffic."""
        sha = sha256(format_site(self.site).encode())
        for body in self.bodies:
            description = body.name, body.label, body.vertices.shape, body.triangles.shape
            sha.update(repr(description).encode())
            sha.update(b"" if body.truth is None else repr(body.truth).encode())
            sha.update(body.vertices.tobytes() + body.triangles.tobytes())
        return sha.digest()

    @cached_property
    def _digest(self) -> str:
        """SHA-256 (hexadecimal) over site, bodies and frames, computed once."""
        sha = sha256(self._scene)
        for snapshot in self.snapshots:
            objects = snapshot.objects
            description = len(objects), snapshot.bodies.tolist(), objects.labels.tolist()
            sha.update(repr(description).encode())
            sha.update(objects.boxes.tobytes())
        return sha.hexdigest()


def simulate_traffic(site: Site, frames: int = FRAMES, seed: int = 0) -> Traffic:
    """Simulate frames of traffic, the same for the same seed.

    The last `MAX_KEPT_TRAFFIC` results are kept in memory. Bodies are drawn for each simulation.
    Parked vehicles stay for `LIFE` frames, as other road users do. A van parked in all frames would
    be in every block of frames, and the bootstrap over blocks by which sets are compared would not
    show its influence.

    Raises ValueError for fewer frames than one, and errors of
    `toolkit.traffic.snapshots.simulate`."""
    check_whole("frames", frames, least=1)
    key = format_site(site), frames, seed
    if key not in _KEPT:
        bodies = fleet_named().bodies(frames, np.random.default_rng([seed, 1]))
        # `once`: no body is used again before all others of its class have been
        snapshots = simulate(site, bodies, frames=frames, seed=seed, once=True, mix=Mix(stay=LIFE))
        _KEPT[key] = Traffic(site, bodies, tuple(snapshots))
        if len(_KEPT) > MAX_KEPT_TRAFFIC:
            del _KEPT[next(iter(_KEPT))]  # the oldest
    return _KEPT[key]


def simulate_continuous_traffic(
    site: Site, frames: int, seed: int = 0, *, interval_s: float = FINE_STEP_S
) -> Traffic:
    """Simulate frames of traffic that goes on, as `coview simulate --every` does with this seed.

    Road users come in at the border of the view and leave there; parked vehicles stay.

    interval_s: time between frames, below 1 s. Raises `NoPassage` for a site without a way through,
    and the errors of `toolkit.traffic.snapshots.simulate`."""
    check_whole("frames", frames, least=1)
    rng = np.random.default_rng([seed, 2])  # the seeds of `toolkit.datasets.simulation`
    bodies = fleet_named().bodies(frames, rng)
    snapshots = simulate(site, bodies, frames=frames, interval=interval_s, seed=rng, once=True)
    return Traffic(site, bodies, tuple(snapshots))


@lru_cache(maxsize=2)
def build_renderer(traffic: Traffic) -> "Renderer":
    """Renderer of the traffic's site and bodies, built once."""
    from toolkit.rendering.renderer import Renderer

    return Renderer(traffic.site, traffic.bodies, (), threads=1)


def scored(objects: Objects, site: Site, labels: Sequence[int] = (VEHICLE,)) -> Mask:
    """Mask of the objects that are scored, as in `toolkit.detection.evaluation`.

    These have one of the classes `labels` (numbers) and are centred in the area of the site."""
    return np.isin(objects.labels, labels) & has_centre_inside(objects.boxes, site.area)
