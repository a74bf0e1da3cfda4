"""Colours are told apart by readers of every colour vision and in grey; scales grow darker."""

import numpy as np
import pytest
from matplotlib.colors import to_rgb

from toolkit.objects import LABELS
from toolkit.plots import palette

# Machado, Oliveira and Fernandes 2009, severity 1.0, on linear RGB.
VISION = {
    "normal": np.eye(3),
    "protanopia": np.array(
        [
            [0.152286, 1.052583, -0.204868],
            [0.114503, 0.786281, 0.099216],
            [-0.003882, -0.048116, 1.051998],
        ]
    ),
    "deuteranopia": np.array(
        [
            [0.367322, 0.860646, -0.227968],
            [0.280085, 0.672501, 0.047413],
            [-0.011820, 0.042940, 0.968881],
        ]
    ),
    "tritanopia": np.array(
        [
            [1.255528, -0.076749, -0.178779],
            [-0.078411, 0.930809, 0.147602],
            [0.004733, 0.691367, 0.303900],
        ]
    ),
}
XYZ_OF_RGB = np.array(
    [
        [0.4124564, 0.3575761, 0.1804375],
        [0.2126729, 0.7151522, 0.0721750],
        [0.0193339, 0.1191920, 0.9503041],
    ]
)
WHITE = XYZ_OF_RGB.sum(axis=1)  # D65
MEANINGS = [
    *palette.SENSORS,
    *palette.CLASS.values(),
    *(palette.OUTCOME[name].colour for name in ("hit", "missed", "false alarm")),
]


def cielab(colours, vision=VISION["normal"]):
    srgb = np.array([to_rgb(colour) for colour in colours])
    linear = np.where(srgb <= 0.04045, srgb / 12.92, ((srgb + 0.055) / 1.055) ** 2.4)
    xyz = np.clip(linear @ vision.T, 0, 1) @ XYZ_OF_RGB.T / WHITE
    f = np.where(xyz > 216 / 24389, np.cbrt(xyz), (24389 / 27 * xyz + 16) / 116)
    return np.stack(
        [116 * f[:, 1] - 16, 500 * (f[:, 0] - f[:, 1]), 200 * (f[:, 1] - f[:, 2])], axis=1
    )


def distances(one, other, vision):
    return np.linalg.norm(cielab(one, vision)[:, None] - cielab(other, vision)[None], axis=2)


def test_outcomes_differ_by_more_than_colour():
    assert cielab(["#ffffff", "#000000", "#ff0000"]) == pytest.approx(
        np.array([[100, 0, 0], [0, 0, 0], [53.24, 80.09, 67.20]]), abs=0.02
    )
    shown = [palette.OUTCOME[name] for name in ("hit", "missed", "false alarm", "not scored")]
    assert len({str(style.line) for style in shown}) == len({style.colour for style in shown}) == 4
    assert [style.marker for style in shown] == ["", "X", "^", ""]


def test_classes_and_sensors_have_their_colours():
    assert tuple(palette.CLASS) == LABELS
    assert not set(palette.CLASS.values()) & set(palette.SENSORS)
    assert [palette.sensor_colour(k) for k in range(8)] == list(palette.SENSORS)
    assert len(set(palette.SENSORS)) == 8
    assert palette.sensor_colour(11) == palette.SENSORS[3]


def test_lines_differ_in_dashes():
    assert len({(colour, str(dashes)) for colour, dashes in palette.LINES}) == 16
    assert len({str(dashes) for _, dashes in palette.LINES[:4]}) >= 3


def test_counts_grow_darker():
    steps = palette.point_colours(np.array([0.0, *palette.POINT_STEPS]))
    lightness = cielab([tuple(colour) for colour in steps])[:, 0]
    assert (np.diff(lightness) <= -1.5).all()
    assert (np.diff(lightness[1:]) <= -8).all()
    assert lightness[0] - lightness[-1] > 70


@pytest.mark.parametrize("vision", VISION.values(), ids=VISION)
def test_sensors_stand_out_for_every_reader(vision):
    assert distances(MEANINGS, MEANINGS, vision)[np.triu_indices(len(MEANINGS), 1)].min() >= 18
    ground = [*palette.GROUND.values(), "#ffffff", palette.SOLID["island"]]
    assert distances(palette.SENSORS, ground, vision).min() >= 20
    assert (
        distances(
            [palette.OUTCOME["hit"].colour, palette.OUTCOME["missed"].colour], ground, vision
        ).min()
        >= 30
    )


@pytest.mark.parametrize("scale", [palette.VIEW_COLOURS, tuple(palette.BLIND.values())[::-1]])
def test_map_colours_grow_darker_in_grey(scale):
    assert (np.diff(cielab(scale)[:, 0]) <= -12).all()


@pytest.mark.parametrize(
    ("count", "step"),
    [(0, 0), (0.9, 0), (1, 1), (1.9, 1), (2, 2), (19.9, 4), (20, 5), (99, 6), (100, 7), (1e6, 7)],
)
def test_the_step_of_a_count(count, step):
    steps = palette.point_colours(np.array([0.0, *palette.POINT_STEPS]))
    assert palette.point_colours(np.array([float(count)]))[0].tolist() == steps[step].tolist()
    assert len(palette.point_names()) == len(steps)
