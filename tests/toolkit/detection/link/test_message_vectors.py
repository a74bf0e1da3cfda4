"""Test vectors of docs/reference/message-format.md, by a second reader and by ours."""

import re
import zlib
from pathlib import Path

import numpy as np
import pytest

from tests.toolkit.detection.link import page_reader
from toolkit.detection.link import image_coding, range_images
from toolkit.detection.link.message import read_message
from toolkit.geometry import pose
from toolkit.sensors.models import DepthCamera
from toolkit.sensors.sensor import Sensor

PAGE = (Path(__file__).parents[4] / "docs/reference/message-format.md").read_text("utf-8")
BLOCKS = re.findall(r"```text (.+?)\n(.+?)\n```", PAGE, re.DOTALL)
MESSAGES = {name: bytes.fromhex(text) for name, text in BLOCKS if name != "values"}
PICTURES = [text.split() for name, text in BLOCKS if name == "values"]
IMAGES = dict(zip(("range image", "foreground"), PICTURES, strict=True))
HEADERS = {"range image": (1, 125, 12_500_000, 20), "foreground": (2, 126, 12_600_000, 40)}
NORTH = Sensor("north", DepthCamera(width=16, height=8), pose(0.0, 0.0, 5.0))


@pytest.mark.parametrize("name", IMAGES)
def test_a_second_reader_finds_the_pixels_of_the_page(name):
    fields = page_reader.read_header(MESSAGES[name])
    keys = ("kind", "number", "time_us", "step_mm")
    assert tuple(fields[key] for key in keys) == HEADERS[name]
    assert (fields["sensor"], fields["rows"], fields["columns"]) == (zlib.crc32(b"north"), 4, 8)
    assert fields["scene"] == (0 if name == "range image" else 0xE0512663)
    values, missing = page_reader.read_image(MESSAGES[name])
    marks = dict(enumerate(IMAGES[name]))
    assert values == {pixel: int(mark) for pixel, mark in marks.items() if mark.isdigit()}
    assert missing == {pixel for pixel, mark in marks.items() if mark == "x"}


@pytest.mark.parametrize("name", IMAGES)
def test_our_reader_finds_the_same_pixels(name):
    _, content = read_message(MESSAGES[name])
    pixels = image_coding.read_pixels(content, 0, (4, 8))
    values, missing = page_reader.read_image(MESSAGES[name])
    assert set(np.flatnonzero(pixels.mask)) == set(values)
    assert pixels.steps[pixels.mask].tolist() == [values[pixel] for pixel in sorted(values)]
    if missing:
        mask, _ = image_coding.decode_mask(content, pixels.end, (4, 8))
        assert set(np.flatnonzero(mask)) == missing


def test_both_readers_find_the_boxes_of_the_page():
    rows = re.findall(r"^\| steps \| (.+) \|$", PAGE, re.MULTILINE)
    stated = [[int(cell) for cell in row.split(" | ")] for row in rows]
    assert page_reader.read_boxes(MESSAGES["boxes"]) == stated
    _, content = read_message(MESSAGES["boxes"])
    boxes = range_images.decode_boxes(content, NORTH)
    steps = np.array(stated)
    np.testing.assert_allclose(boxes.boxes[:, :6], steps[:, :6] * 0.02)
    np.testing.assert_allclose(np.rad2deg(boxes.boxes[:, 6]) % 360, steps[:, 6] / 2)
    np.testing.assert_allclose(boxes.scores, 1 - (steps[:, 7] / 511) ** 2)
    assert boxes.labels.tolist() == steps[:, 8].tolist()
