"""Turning-movement diagram: bands from entry to exit, as wide as their counts.

A panel for each kind of road user has the arms on a circle, in their compass directions, north up.
Next to each arm are the numbers of road users who came in and who left."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from toolkit.arrays import Float64
from toolkit.counting.counts import GROUPS, MovementCount
from toolkit.plots.canvas import (
    blank_figure,
    house_style,
    replace_unprintable,
    shorten,
    write_figure,
)
from toolkit.plots.line_style import PlotStyle
from toolkit.plots.palette import FAINT, INK, SENSORS

if TYPE_CHECKING:
    from matplotlib.axes import Axes

PANEL_INCHES = 4.0
HEAD_INCHES = 0.75
MAX_BAND = 0.2  # width of the widest band; the radius of the circle is 1
MIN_BAND = 0.008
SIDE = 0.21  # from the middle of an arm to the middle of its entries or exits
LIMIT = 1.72  # half of the axes' width
ARM_TEXT = 1.4  # from the middle to an arm's name and sums
CURVE_POINTS = 40


class ArmBearing(NamedTuple):
    """Arm of a diagram.

    Attributes:
        name: its name.
        bearing_deg: compass bearing from the middle of the junction."""

    name: str
    bearing_deg: float


def draw_turning_diagram(
    movements: Sequence[MovementCount],
    arms: Sequence[ArmBearing],
    out: Path | str,
    *,
    title: str,
    subtitle: str = "",
    lefthand: bool = False,
) -> None:
    """Draw the counts of turning movements, as PNG or SVG by the suffix.

    Args:
        movements: Counts by class, entry and exit.
        arms: Arms of the junction.
        out: Picture to write.
        title: Title.
        subtitle: Line below it, "" for none.
        lefthand: True if traffic keeps left."""
    counts_by_panel = {name: _sum_counts(movements, labels) for name, labels in GROUPS.items()}
    panels = {name: counts for name, counts in counts_by_panel.items() if counts}
    if not panels:
        panels = {"vehicles": {}}
    width = PANEL_INCHES * max(2, len(panels))
    height = PANEL_INCHES + HEAD_INCHES
    with house_style():
        figure = blank_figure(width, height)
        heading: PlotStyle = {"fontsize": 12, "fontweight": "bold", "va": "center"}
        figure.text(0.2 / width, 1 - 0.24 / height, shorten(title, 88), **heading)
        figure.text(
            0.2 / width, 1 - 0.5 / height, replace_unprintable(subtitle), fontsize=9, va="center"
        )
        for number, (name, counts) in enumerate(panels.items()):
            bounds = (
                PANEL_INCHES * number / width,
                0.0,
                PANEL_INCHES / width,
                PANEL_INCHES / height,
            )
            axes = figure.add_axes(bounds)
            _draw_panel(axes, f"{sum(counts.values())} {name}", counts, (arms, lefthand))
        write_figure(figure, out)


def _sum_counts(
    movements: Sequence[MovementCount], labels: Sequence[str]
) -> dict[tuple[str, str], int]:
    """Sum the counts of some classes, by names of the entry and the exit.

    movements: counts by class and movement; labels: names of the classes to sum."""
    counts: dict[tuple[str, str], int] = {}
    for movement in movements:
        if movement.label in labels:
            key = movement.entry, movement.exit
            counts[key] = counts.get(key, 0) + movement.count
    return counts


def _draw_panel(
    axes: "Axes",
    heading: str,
    counts: Mapping[tuple[str, str], int],
    layout: tuple[Sequence[ArmBearing], bool],
) -> None:
    """Draw one kind of road user.

    Args:
        axes: Axes to draw in.
        heading: Text above the circle.
        counts: Counts by entry and exit.
        layout: Arms, and whether traffic keeps left."""
    arms, lefthand = layout
    axes.set_axis_off()
    axes.set(xlim=(-LIMIT, LIMIT), ylim=(-LIMIT, LIMIT), aspect="equal")
    axes.text(-LIMIT + 0.08, LIMIT - 0.1, heading, fontsize=10, fontweight="bold", va="center")
    _draw_compass(axes)
    colours = {arm.name: SENSORS[number % len(SENSORS)] for number, arm in enumerate(arms)}
    outwards = {arm.name: _direction(arm.bearing_deg) for arm in arms}
    # the driver's right is to the left of the direction out of the junction
    side = -SIDE if lefthand else SIDE
    begins = _spread(counts, outwards, by_entry=True, side=side)
    ends = _spread(counts, outwards, by_entry=False, side=-side)
    widths = _band_widths(counts)
    # largest first, so that thinner bands are drawn over wider ones
    for key in sorted(counts, key=lambda key: -counts[key]):
        entry, leave = key  # names of arms
        middle = _curve(begins[key], ends[key], outwards[entry], outwards[leave])
        _draw_band(axes, middle, widths[key], colours[entry])
        _write_count(axes, middle, counts[key], colours[entry])
    for arm in arms:
        in_count = sum(count for (entry, _), count in counts.items() if entry == arm.name)
        out_count = sum(count for (_, leave), count in counts.items() if leave == arm.name)
        _write_arm(axes, arm, f"in {in_count}\nout {out_count}", colours[arm.name])


def _direction(bearing: float) -> Float64[np.ndarray, "2"]:
    """Unit vector of a compass bearing (degrees), north up."""
    angle = np.deg2rad(bearing)
    return np.array([np.sin(angle), np.cos(angle)])


def _band_widths(counts: Mapping[tuple[str, str], int]) -> dict[tuple[str, str], float]:
    """Width of each band, in proportion to its count."""
    max_count = max(counts.values(), default=1)
    return {key: max(MIN_BAND, MAX_BAND * count / max_count) for key, count in counts.items()}


def _spread(
    counts: Mapping[tuple[str, str], int],
    outwards: Mapping[str, Float64[np.ndarray, "2"]],
    *,
    by_entry: bool,
    side: float,
) -> dict[tuple[str, str], Float64[np.ndarray, "2"]]:
    """Place at which each band begins or ends, as x, y by names of its entry and exit.

    A band is the stripe of one movement, as wide as its count. The arms end on a circle of radius 1
    about the junction's middle; the bands of an arm are side by side there.

    Args:
        counts: Counts by names of entry and exit.
        outwards: Unit vector x, y from the middle to each arm, by its name.
        by_entry: True for begins, at the entry; False for ends, at the exit.
        side: Distance from the arm's middle line to the middle of its bands, positive to the left
            when looking out of the junction."""
    widths = _band_widths(counts)
    # places of the arm itself and of the other arm in a key (entry, exit)
    arm_place = 0 if by_entry else 1
    other_place = 1 - arm_place
    places = {}
    for arm, outward in outwards.items():
        left = np.array([-outward[1], outward[0]])
        keys = [key for key in counts if key[arm_place] == arm]
        # clockwise by the other arm, so that bands of one arm do not cross
        keys.sort(key=lambda key: _measure_turn(outward, outwards[key[other_place]]))
        # distance to the left of the middle line, at the right edge of the next band
        offset = side - sum(widths[key] for key in keys) / 2
        for key in keys:
            places[key] = outward + (offset + widths[key] / 2) * left
            offset += widths[key]
    return places


def _measure_turn(outward: Float64[np.ndarray, "2"], target: Float64[np.ndarray, "2"]) -> float:
    """Turn from `outward` counter-clockwise to `target` (rad, 0 to 2 pi), with the sign -.

    Both are directions x, y."""
    cross = outward[0] * target[1] - outward[1] * target[0]
    return -float(np.arctan2(cross, outward @ target) % (2 * np.pi))


def _curve(
    begin: Float64[np.ndarray, "2"],
    end: Float64[np.ndarray, "2"],
    begin_outward: Float64[np.ndarray, "2"],
    end_outward: Float64[np.ndarray, "2"],
) -> Float64[np.ndarray, "k 2"]:
    """Points of a cubic curve between two places on the circle, straight at both.

    begin, end: x, y of the places; begin_outward, end_outward: unit vectors from the middle of the
    junction outwards along their roads."""
    # control points go less far in, the shorter the way is
    reach = 0.35 + 0.25 * float(np.hypot(*(end - begin))) / 2
    controls = [begin, begin - reach * begin_outward, end - reach * end_outward, end]
    share = np.linspace(0, 1, CURVE_POINTS)[:, None]
    remainder = 1 - share
    # shares of the four control points at each point of the curve, as for any Bézier curve
    factors = [remainder**3, 3 * remainder**2 * share, 3 * remainder * share**2, share**3]
    return np.sum([factor * point for factor, point in zip(factors, controls, strict=True)], axis=0)


def _draw_band(axes: "Axes", middle: Float64[np.ndarray, "k 2"], width: float, colour: str) -> None:
    """Draw a band along a curve, with an arrow head at its end.

    middle: x, y of the curve's points; width: of the band, in the same units."""
    # unit vectors along the curve at each point, and to its left
    along = np.gradient(middle, axis=0)
    along /= np.hypot(along[:, 0], along[:, 1])[:, None]
    normals = np.stack([-along[:, 1], along[:, 0]], axis=1)
    sides = [middle + width / 2 * normals, (middle - width / 2 * normals)[::-1]]
    half_head = width / 2 + 0.03  # half the width of the head, which is wider than the band
    # a head longer than its half width
    tip = middle[-1] + 1.6 * half_head * along[-1]
    arrow = [middle[-1] + half_head * normals[-1], tip, middle[-1] - half_head * normals[-1]]
    for outline in (np.concatenate(sides), np.array(arrow)):
        axes.fill(*outline.T, facecolor=colour, edgecolor="white", linewidth=0.4, alpha=0.75)


def _write_count(axes: "Axes", middle: Float64[np.ndarray, "k 2"], count: int, colour: str) -> None:
    """Write a count on its band, near the entry; middle: x, y of the points of the band's curve."""
    from matplotlib.patheffects import withStroke

    x, y = middle[CURVE_POINTS // 4]
    style: PlotStyle = {"fontsize": 8, "ha": "center", "va": "center", "zorder": 5}
    halo = [withStroke(linewidth=2.2, foreground="white")]
    axes.text(x, y, str(count), color=colour, fontweight="bold", path_effects=halo, **style)


def _write_arm(axes: "Axes", arm: ArmBearing, sums: str, colour: str) -> None:
    """Write an arm's name and sums outside the circle."""
    x, y = ARM_TEXT * _direction(arm.bearing_deg)
    style: PlotStyle = {"ha": "center", "va": "center"}
    axes.text(x, y + 0.14, shorten(arm.name, 16), color=colour, fontweight="bold", **style)
    axes.text(x, y - 0.06, sums, color=INK, fontsize=8, **style)


def _draw_compass(axes: "Axes") -> None:
    """Draw a small arrow to the north in the upper right corner."""
    x, y = LIMIT - 0.14, LIMIT - 0.2
    style = {"arrowstyle": "-|>", "color": FAINT, "linewidth": 1.0}
    axes.annotate("", xy=(x, y + 0.1), xytext=(x, y - 0.13), arrowprops=style)
    axes.text(x, y + 0.14, "N", fontsize=8, color=FAINT, ha="center", va="center")
