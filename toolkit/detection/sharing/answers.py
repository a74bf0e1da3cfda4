"""The two ends of a request: which places the centre asks a sensor for, what the sensor answers, and the points that
the centre makes of it."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from toolkit.arrays import Bool, Float32
from toolkit.boxes import count_points
from toolkit.calibration.empty_scene import SIGMAS, EmptyScene
from toolkit.detection.link.foreground import decode_foreground, encode_foreground, restored_points
from toolkit.detection.link.range_images import STEPS
from toolkit.detection.link.standing_out import standing_out
from toolkit.detection.sharing.foreground_groups import fitting, foreground_groups, ranked
from toolkit.detection.sharing.requests import Request, decode_request, encode_request
from toolkit.detection.sharing.wants import Wants
from toolkit.detection.view import Captured
from toolkit.objects import Detections

STEP_WORTH = dict(zip(STEPS, (1.0, 0.99, 0.98), strict=True))  # of points in these steps: by judgement, not measured
LEAST_ANSWER = 400  # bits: of a foreground of a few pixels
MANY = 2.0  # times what is left, for which places are asked by what is expected of them
MOST_ASKING = 0.25  # of what is left, that a request may take


def whole_foreground(captured: Captured, scene: EmptyScene, most_bits: int, sigmas: float = SIGMAS) -> bytes | None:
    """All that stands out, in the finest step in which it fits so many bits; None where it does not."""
    out = standing_out(captured, scene, sigmas)
    image = captured.sending(out.pixels)
    for step in STEPS:
        message = encode_foreground(image, scene, out.missing, step=step)
        if 8 * len(message) <= most_bits:
            return message
    return None


def requested(wants: Wants, sensor: int, most_bits: int, captured: Captured) -> bytes | None:
    """The request to a sensor (its place among those that were asked), which with its answer takes so many bits at
    most: the places it may see, as many as its answer can hold by what is expected. None where an answer does not
    fit."""
    own = np.flatnonzero(wants.of[sensor])
    hold = np.cumsum(wants.bits[sensor, own]) <= MANY * most_bits
    own = own[: max(int(hold.sum()), 1)]
    while True:
        asked = Request(0, wants.places[own], wants.gains[own])
        about: dict[str, Any] = {"time": captured.frame.time, "number": captured.frame.index}
        bits = 8 * len(encode_request(asked, captured.sensor.name, **about))
        if bits <= most_bits * MOST_ASKING or not len(own):
            break
        own = own[: len(own) // 2]
    if most_bits - bits < LEAST_ANSWER:
        return None
    return encode_request(replace(asked, grant=most_bits - bits), captured.sensor.name, **about)


def answered(
    captured: Captured, scene: EmptyScene, request: bytes, own: Detections, sigmas: float = SIGMAS
) -> bytes | None:
    """What a sensor answers to a request, given the boxes it sent; None where not one piece fits."""
    asked = decode_request(request, captured.sensor.name)
    pixels, missing = standing_out(captured, scene, sigmas)
    points = captured.points(captured.sending(pixels).measurement)
    groups = foreground_groups(pixels, points, captured.measurement.shape, own.boxes)
    ranks = ranked(groups, asked, own)
    best, most = None, 0.0
    for step, worth in STEP_WORTH.items():

        def encode(taken: Bool[np.ndarray, " n"], step: float = step) -> bytes:
            return encode_foreground(captured.sending(pixels[taken[groups.of]]), scene, missing, step=step)

        found = fitting(ranks.order, groups.sizes, encode, asked.grant)
        if found is None:
            continue
        message, taken = found
        total = worth * float(ranks.worth[taken].sum())
        if total > most:
            best, most = message, total
        if taken.all():
            break
    return best


def restored(
    captured: Captured, scene: EmptyScene, answer: bytes | None
) -> tuple[Float32[np.ndarray, "n 3"], Float32[np.ndarray, "m 3"]]:
    """The cloud of a sensor at the centre, the empty scene where nothing arrived, and of it the points that did."""
    return restored_points(captured, scene, None if answer is None else decode_foreground(answer, scene))


def unanswered(own: Detections, measured: Float32[np.ndarray, "m 3"]) -> Detections:
    """The boxes of a sensor in which none of the points lies that it sent: of the others points speak."""
    return own[count_points(measured, own.boxes) == 0]
