"""Draw the pictures of the documentation that no command draws: `python docs/pictures/draw.py
[FOLDER]`."""

import sys
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import Polygon

from toolkit.boxes import footprints
from toolkit.calibration.empty_scene import learn_empty_scenes
from toolkit.datasets.dataset import CoopDataset
from toolkit.datasets.recording_views import read_frame
from toolkit.datasets.simulation import simulate_dataset
from toolkit.plots.canvas import blank_figure, house_style, write_figure
from toolkit.plots.palette import FAINT, INK, sensor_colour
from toolkit.points import frame_points
from toolkit.runtime.run import Run
from toolkit.sensors.error_profiles import find_profile

SENSOR = 1  # d1 looks at the middle of the T-junction
HEADING_DEG = 135.0
TILT_DEG = 25.0


def draw_foreground(recording: CoopDataset, out: Path) -> None:
    """Draw one range image, the empty scene, and the pixels that stand out from it."""
    scene = learn_empty_scenes(recording)[SENSOR]
    images = [
        np.asarray(read_frame(recording, k).measurements[SENSOR], float)
        for k in range(len(recording))
    ]
    measured = max(images, key=lambda image: int((~scene.shows(image) & (image > 0)).sum()))
    empty = np.asarray(scene.first, float)
    sent = ~scene.shows(measured) & (measured > 0)
    with house_style():
        figure = blank_figure(9.6, 2.9, constrained=True)
        axes = figure.subplots(1, 3, sharex=True, sharey=True)
        titles = ("Measured", "Empty scene", f"Sent: {sent.sum():,} of {sent.size:,} pixels")
        for place, image, title in zip(
            axes, (measured, empty, np.where(sent, measured, np.nan)), titles, strict=True
        ):
            shown = place.imshow(
                np.where(image > 0, image, np.nan), vmin=0.0, vmax=30.0, cmap="viridis_r"
            )
            place.set_title(title)
            place.set_xlabel("column")
        axes[0].set_ylabel("row")
        figure.colorbar(shown, ax=axes, label="depth (m)")
        write_figure(figure, out)


def draw_errors(recording: CoopDataset, out: Path) -> None:
    """Draw the points of one car as measured under three error profiles, seen from above."""
    profiles = ("paper", "typical", "poor")
    area = recording.site.area
    frames = [
        read_frame(recording, 0, errors=find_profile(name), noise_seed=3) for name in profiles
    ]
    boxes = frames[0].objects.boxes[frames[0].objects.labels == 0]
    together = np.concatenate(frame_points(frames[0], area=area))
    near = [int((np.abs(together[:, :2] - box[:2]).max(axis=1) < 3.5).sum()) for box in boxes]
    box = boxes[int(np.argmax(near))]
    with house_style():
        figure = blank_figure(9.6, 4.1, constrained=True)
        axes = figure.subplots(1, 3, sharex=True, sharey=True)
        for place, name, frame in zip(axes, profiles, frames, strict=True):
            for sensor, cloud in enumerate(frame_points(frame, area=area)):
                close = cloud[
                    (np.abs(cloud[:, :2] - box[:2]).max(axis=1) < 4.0) & (cloud[:, 2] > 0.2)
                ]
                if len(close):
                    label = frame.sensors[sensor].name
                    place.scatter(
                        *(close[:, :2] - box[:2]).T,
                        s=3.0,
                        linewidths=0,
                        color=f"C{sensor}",
                        label=label,
                    )
            place.add_patch(
                Polygon(
                    footprints(box[None])[0] - box[:2], fill=False, edgecolor=INK, label="true box"
                )
            )
            place.set(title=name, aspect="equal", xlim=(-4, 4), ylim=(-4, 4), xlabel="x (m)")
        axes[0].set_ylabel("y (m)")
        handles = {
            label: handle
            for place in axes
            for handle, label in zip(*place.get_legend_handles_labels(), strict=True)
        }
        figure.legend(
            handles.values(), handles.keys(), loc="outside lower center", ncols=7, markerscale=3
        )
        write_figure(figure, out)


def draw_directions(out: Path) -> None:
    """Draw one direction as bearing and heading from above, and a tilt from the side."""
    with house_style():
        figure = blank_figure(9.6, 4.4, constrained=True)
        above, beside = figure.subplots(1, 2)
        draw_compass(above)
        draw_tilt(beside)
        write_figure(figure, out)


def draw_compass(axes: Axes) -> None:
    """Draw the bearing and the heading of one sensor at a site whose x axis points east."""
    for x, y, name in (
        (0.0, 1.25, "north, +y\nbearing 0°, heading 90°"),
        (1.25, 0.0, "east, +x\nbearing 90°\nheading 0°"),
    ):
        axes.annotate("", (x, y), (0.0, 0.0), arrowprops={"arrowstyle": "->", "color": FAINT})
        below = {"ha": "center", "va": "bottom"} if y else {"ha": "left", "va": "center"}
        axes.text(1.03 * x, 1.03 * y, name, color=FAINT, **below)
    heading = np.deg2rad(HEADING_DEG)
    tip = np.array([np.cos(heading), np.sin(heading)])
    axes.annotate(
        "", 1.3 * tip, (0.0, 0.0), arrowprops={"arrowstyle": "-|>", "color": INK, "lw": 2.5}
    )
    axes.text(
        *(1.36 * tip), "sensor looks here", ha="center", va="bottom", color=INK, weight="bold"
    )
    bearing = 90.0 - HEADING_DEG + 360.0
    draw_turn(axes, 0.55, (90.0, 90.0 - bearing), sensor_colour(0))
    draw_turn(axes, 0.9, (0.0, HEADING_DEG), sensor_colour(1))
    axes.text(
        0.0,
        -0.72,
        f"bearing {bearing:g}°\nclockwise from north",
        ha="center",
        va="top",
        color=sensor_colour(0),
    )
    axes.text(
        0.75,
        0.68,
        f"heading {HEADING_DEG:g}°\ncounter-clockwise\nfrom +x",
        ha="left",
        va="bottom",
        color=sensor_colour(1),
    )
    axes.set(xlim=(-1.7, 1.9), ylim=(-1.15, 1.75), aspect="equal", title="From above")
    axes.axis("off")


def draw_turn(axes: Axes, radius: float, ends_deg: tuple[float, float], colour: str) -> None:
    """Draw an arc with an arrow at its end. ends_deg: counter-clockwise from +x."""
    angles = np.deg2rad(np.linspace(*ends_deg, 200))
    x, y = radius * np.cos(angles), radius * np.sin(angles)
    axes.plot(x[:-4], y[:-4], color=colour, lw=2.0)
    arrow = {"arrowstyle": "-|>", "color": colour, "lw": 2.0}
    axes.annotate("", (x[-1], y[-1]), (x[-8], y[-8]), arrowprops=arrow)


def draw_tilt(axes: Axes) -> None:
    """Draw a sensor on its pole from the side, its height and its tilt below the horizon."""
    foot = np.array([0.0, 0.0])
    top = np.array([0.0, 5.0])
    reach = 9.0
    tilt = np.deg2rad(TILT_DEG)
    axes.plot([-1.0, 11.5], [0.0, 0.0], color=FAINT)
    axes.plot(*np.stack([foot, top]).T, color=INK, lw=4.0)
    axes.plot([0.0, 10.5], [5.0, 5.0], color=FAINT, ls="--")
    axes.text(10.5, 5.1, "horizon: tilt 0°", ha="right", va="bottom", color=FAINT)
    ahead = top + reach * np.array([np.cos(tilt), -np.sin(tilt)])
    axes.annotate("", ahead, top, arrowprops={"arrowstyle": "-|>", "color": INK, "lw": 2.5})
    angles = np.linspace(0.0, -tilt, 60)
    axes.plot(4.0 * np.cos(angles), 5.0 + 4.0 * np.sin(angles), color=sensor_colour(2), lw=2.0)
    axes.text(
        4.3,
        4.1,
        f"tilt {TILT_DEG:g}°, below the horizon",
        ha="left",
        va="center",
        color=sensor_colour(2),
    )
    axes.text(-0.3, 2.5, "height\nabove the foot\nof the pole", ha="right", va="center", color=INK)
    axes.set(xlim=(-4.0, 12.0), ylim=(-1.0, 7.0), aspect="equal", title="From the side")
    axes.axis("off")


def main(folder: Path) -> None:
    """Record two minutes of the T-junction and draw every picture into the folder."""
    draw_directions(folder / "directions.png")
    with TemporaryDirectory() as scratch:
        path = Path(scratch) / "tjunction.hdf5"
        simulate_dataset("tjunction", path, run=Run(frames=60, seed=992))
        with CoopDataset(path) as recording:
            draw_foreground(recording, folder / "foreground.png")
            draw_errors(recording, folder / "error-profiles.png")


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).parent)
