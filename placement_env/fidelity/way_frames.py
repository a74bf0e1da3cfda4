"""Frames of a continuous recording in which each road user counts once.

In frames that follow each other closely, one car in a queue is in hundreds of frames and outweighs
everybody who drives past it. So each road user counts in one frame, drawn at random from those in
which it is in the detection area, and only frames in which somebody counts are used."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from placement_env.fidelity.traffic import scored
from toolkit.arrays import Float64, Int64
from toolkit.objects import Objects
from toolkit.sites.site import Site

CONTINUOUS_S = 1.0  # from frames closer than this, traffic goes on from frame to frame


class WayFrame(NamedTuple):
    """Frame of a recording in which some road users count.

    Attributes:
        number: Its number in the recording, from 0.
        ids: Numbers of the road users that count, ascending."""

    number: int
    ids: tuple[int, ...]


def is_continuous(times: Float64[np.ndarray, " frames"] | None) -> bool:
    """Return True if half of the frames are less than `CONTINUOUS_S` apart.

    times: time of each frame (s), None if unknown."""
    if times is None or len(times) < 2:
        return False
    return bool(np.median(np.abs(np.diff(times))) < CONTINUOUS_S)


def draw_way_frames(
    frames: Sequence[Objects], site: Site, labels: Sequence[int], seed: int = 0
) -> tuple[WayFrame, ...]:
    """Draw for each road user one of the frames in which it is scored; it counts in that one only.

    Returns the frames in which somebody counts, in ascending order.

    Args:
        frames: Objects of each frame, with ids that last.
        site: Site, in whose area road users count.
        labels: Classes (numbers) that count.
        seed: Seed of the draws."""
    # pairs of a road user's id and the number of a frame in which it is scored
    id_parts: list[Int64[np.ndarray, " n"]] = [np.zeros(0, np.int64)]
    frame_parts: list[Int64[np.ndarray, " n"]] = [np.zeros(0, np.int64)]
    for number, objects in enumerate(frames):
        ids = np.unique(objects.ids[scored(objects, site, labels)])
        id_parts.append(ids)
        frame_parts.append(np.full(len(ids), number))
    ids = np.concatenate(id_parts)
    numbers = np.concatenate(frame_parts)
    rng = np.random.default_rng(seed)
    ids_by_frame: dict[int, list[int]] = {}
    for road_user in np.unique(ids).tolist():
        number = int(rng.choice(numbers[ids == road_user]))
        ids_by_frame.setdefault(number, []).append(road_user)
    return tuple(WayFrame(number, tuple(ids_by_frame[number])) for number in sorted(ids_by_frame))
