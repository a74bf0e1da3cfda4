"""`see`: visibility of traffic from candidates. It uses rays or panoramas, whichever is quicker and accurate enough."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from placement_env.candidates.candidates import Candidates
from placement_env.fidelity.blocks import Block, see_blocks
from placement_env.fidelity.occlusion import Seen, look_at
from placement_env.fidelity.panorama.panoramas import choose_quick, look_round
from placement_env.fidelity.traffic import Traffic, build_renderer
from placement_env.fidelity.visibility import Visibility
from placement_env.setting import Rendering, check_rendering
from toolkit.objects import VEHICLE
from toolkit.runtime.cache import make_key
from toolkit.runtime.code_digest import code_digest
from toolkit.runtime.run import Run
from toolkit.sensors.sensor import Sensor

BLOCK_PIXELS = 4_000_000  # pixels of the sensors handled at once, about 40 bytes each


def see(
    traffic: Traffic,
    candidates: Candidates,
    *,
    labels: Sequence[int] = (VEHICLE,),
    run: Run = Run(),
    rendering: Rendering = "auto",
) -> Visibility:
    """View of the candidates on the traffic.

    rendering: "full" casts every ray of every candidate. "panorama" looks once from each place and counts the rays of
    all its sensors in that view; this is much faster where many candidates share a place, and nearly always agrees
    within 3 % or 8 points of an object. "auto" uses panoramas where places have at least four candidates on average, as
    in a pool. A candidate whose range ends within the site is always rendered in full. labels: classes (numbers) of the
    objects that count; run: its cache keeps the finished blocks of candidates, so an interrupted run resumes there.
    Raises ValueError without candidates and for an unknown rendering.
    """
    if not len(candidates):
        raise ValueError("there must be a candidate to see, got none")
    check_rendering(rendering)
    labels, sensors = tuple(sorted(labels)), candidates.sensors
    quick = choose_quick(sensors, traffic, rendering)
    whole = Visibility.unseen(traffic, sensors, labels)
    for look, some in ((look_round, quick), (_look_in_full, ~quick)):
        if some.any():
            seen = look(traffic, [sensors[c] for c in np.flatnonzero(some)], labels, run)
            whole.points[some], whole.sent[some], whole.far[some] = seen
    return whole


def _look_in_full(traffic: Traffic, sensors: Sequence[Sensor], labels: tuple[int, ...], run: Run) -> Seen:
    """Cast each ray of the sensors, in blocks of at most `BLOCK_PIXELS` pixels, or one sensor."""
    blocks, first, pixels = list[Block](), 0, 0
    for c, sensor in enumerate(sensors):
        size = math.prod(sensor.model.shape)
        if pixels and pixels + size > BLOCK_PIXELS:
            blocks.append((first, c))
            first, pixels = c, 0
        pixels += size
    blocks.append((first, len(sensors)))
    look = _FullLook(traffic, tuple(sensors), labels)
    seen = see_blocks(look, look.key, blocks, run, run.stage("poses rendered", len(sensors)))
    return Seen(*(np.concatenate(parts) for parts in zip(*seen, strict=True)))


@dataclass(frozen=True, eq=False)
class _FullLook:
    """View of all frames from a block of sensors."""

    traffic: Traffic
    sensors: tuple[Sensor, ...]
    labels: tuple[int, ...]

    def __call__(self, block: Block, /) -> Seen:
        return look_at(self.traffic, build_renderer(self.traffic), self.sensors[slice(*block)], self.labels)

    def key(self, block: Block) -> bytes:
        sensors = self.sensors[slice(*block)]
        code = code_digest(__name__, *sorted({type(sensor.model).__module__ for sensor in sensors}))
        return make_key("seen", code, self.traffic.digest(), [sensor.digest for sensor in sensors], self.labels)
