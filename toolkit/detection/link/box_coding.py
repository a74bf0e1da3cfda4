"""Boxes as bytes and back: 2 cm, half a degree, 9 bits of score.

    count      uint16
    columns    for x, y, z, length, width, height (steps of 2 cm), yaw (steps of 0.5°, 0 to 719), score (0 to 511),
               label: width of its numbers (uint8, bits) and its least one (int32)
    numbers    column after column, each number less the least, filled with zeros to a whole byte after each column

The order of the boxes stays. Yaw arrives between -180° and 180°, a score below 0 as 0 and one above 1 as 1. A score s
is sent as 511 times the square root of 1 - s: sure ones lie close together, and say which of two boxes of an object
stays.
"""

from __future__ import annotations

import struct

import numpy as np

from toolkit.arrays import Int64
from toolkit.detection.link.bit_packing import read_fixed, write_fixed
from toolkit.objects import Detections

BOX_STEP = 0.02  # m
TURN = 720  # steps of yaw
SCORES = 511
_COUNT, _COLUMN = struct.Struct("<H"), struct.Struct("<Bi")
_COLUMNS = 9
_YAW, _SCORE = 6, 7
MOST_BOXES = 65535


def encode_boxes(detections: Detections) -> bytes:
    """Boxes, scores and labels as bytes. Raises ValueError for more than 65535, and numbers that are not finite or too
    large."""
    if len(detections) > MOST_BOXES:
        raise ValueError(f"a message holds at most {MOST_BOXES} boxes, got {len(detections)}")
    if not (np.isfinite(detections.boxes).all() and np.isfinite(detections.scores).all()):
        raise ValueError("boxes and scores must be finite to be sent: drop those that are not")
    columns = [*(detections.boxes[:, :6].T / BOX_STEP), detections.boxes[:, 6] / (2 * np.pi) * TURN]
    columns += [np.sqrt(1 - np.clip(detections.scores, 0, 1)) * SCORES, detections.labels]
    table = np.rint(np.column_stack(columns))
    table[:, _YAW] %= TURN
    if table.size and np.abs(table).max() >= 1 << 30:
        raise ValueError(
            f"boxes must lie within {(1 << 30) * BOX_STEP / 1000:.0f} km, got {np.abs(table).max() * BOX_STEP} m"
        )
    heads, bodies = [], []
    for column in table.astype(np.int64).T:
        least = int(column.min(initial=0) if not len(column) else column.min())
        width = int(column.max() - least).bit_length() if len(column) else 0
        heads.append(_COLUMN.pack(width, least))
        bodies.append(write_fixed(column - least, width))
    return _COUNT.pack(len(detections)) + (b"".join(heads + bodies) if len(detections) else b"")


def decode_boxes(content: bytes) -> Detections:
    """What `encode_boxes` wrote. Raises ValueError for other bytes."""
    if len(content) < _COUNT.size:
        raise ValueError("the content of boxes begins with their count: it is cut off")
    (count,) = _COUNT.unpack_from(content)
    start = _COUNT.size + _COLUMNS * _COLUMN.size
    if not count:
        if len(content) > _COUNT.size:
            raise ValueError(f"no boxes are followed by {len(content) - _COUNT.size} bytes")
        return Detections.empty()
    if len(content) < start:
        raise ValueError(f"{count} boxes have {start} bytes of columns, got {len(content)}: they are cut off")
    columns = []
    for place in range(_COLUMNS):
        width, least = _COLUMN.unpack_from(content, _COUNT.size + place * _COLUMN.size)
        if width > 31:
            raise ValueError(f"numbers of boxes have up to 31 bits, got {width}")
        numbers, start = read_fixed(content, start, count, width)
        columns.append(numbers + least)
    if start != len(content):
        raise ValueError(f"{count} boxes are followed by {len(content) - start} bytes")
    return _detections(np.column_stack(columns))


def _detections(table: Int64[np.ndarray, "n 9"]) -> Detections:
    scores, labels = table[:, _SCORE], table[:, -1]
    if not (scores.min() >= 0 and scores.max() <= SCORES):
        raise ValueError(f"scores are sent as 0 to {SCORES}, got {scores.min()} to {scores.max()}")
    yaw = (table[:, _YAW] + TURN // 2) % TURN - TURN // 2
    boxes = np.column_stack([table[:, :6] * BOX_STEP, yaw * (2 * np.pi / TURN)])
    return Detections(boxes, 1 - (scores / SCORES) ** 2, labels)
