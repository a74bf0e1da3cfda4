"""Draw the pictures of the documentation that no command draws: `python docs/pictures/draw.py [FOLDER]`."""

import sys
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from matplotlib.patches import Polygon

from toolkit.boxes import footprints
from toolkit.calibration.empty_scene import learn_empty_scenes
from toolkit.datasets.dataset import CoopDataset
from toolkit.datasets.recordings import read_frame
from toolkit.datasets.simulation import simulate_dataset
from toolkit.plots.canvas import blank_figure, house_style, write_figure
from toolkit.points import frame_points
from toolkit.runtime.run import Run
from toolkit.sensors.error_profiles import find_profile

SENSOR = 1  # d1 looks at the middle of the T-junction
INK = "#1b1b1b"


def draw_foreground(recording: CoopDataset, out: Path) -> None:
    """Draw one range image, the empty scene, and the pixels that stand out from it."""
    scene = learn_empty_scenes(recording)[SENSOR]
    images = [np.asarray(read_frame(recording, k).measurements[SENSOR], float) for k in range(len(recording))]
    measured = max(images, key=lambda image: int((~scene.shows(image) & (image > 0)).sum()))
    empty = np.asarray(scene.first, float)
    sent = ~scene.shows(measured) & (measured > 0)
    with house_style():
        figure = blank_figure(9.6, 2.9, constrained=True)
        axes = figure.subplots(1, 3, sharex=True, sharey=True)
        titles = ("Measured", "Empty scene", f"Sent: {sent.sum():,} of {sent.size:,} pixels")
        for place, image, title in zip(axes, (measured, empty, np.where(sent, measured, np.nan)), titles, strict=True):
            shown = place.imshow(np.where(image > 0, image, np.nan), vmin=0.0, vmax=30.0, cmap="viridis_r")
            place.set_title(title)
            place.set_xlabel("column")
        axes[0].set_ylabel("row")
        figure.colorbar(shown, ax=axes, label="depth (m)")
        write_figure(figure, out)


def draw_errors(recording: CoopDataset, out: Path) -> None:
    """Draw the points of one car as measured under three error profiles, seen from above."""
    profiles = ("paper", "typical", "poor")
    area = recording.site.area
    frames = [read_frame(recording, 0, errors=find_profile(name), noise_seed=3) for name in profiles]
    boxes = frames[0].objects.boxes[frames[0].objects.labels == 0]
    together = np.concatenate(frame_points(frames[0], area=area))
    near = [int((np.abs(together[:, :2] - box[:2]).max(axis=1) < 3.5).sum()) for box in boxes]
    box = boxes[int(np.argmax(near))]
    with house_style():
        figure = blank_figure(9.6, 4.1, constrained=True)
        axes = figure.subplots(1, 3, sharex=True, sharey=True)
        for place, name, frame in zip(axes, profiles, frames, strict=True):
            for sensor, cloud in enumerate(frame_points(frame, area=area)):
                close = cloud[(np.abs(cloud[:, :2] - box[:2]).max(axis=1) < 4.0) & (cloud[:, 2] > 0.2)]
                if len(close):
                    label = frame.sensors[sensor].name
                    place.scatter(*(close[:, :2] - box[:2]).T, s=3.0, linewidths=0, color=f"C{sensor}", label=label)
            place.add_patch(Polygon(footprints(box[None])[0] - box[:2], fill=False, edgecolor=INK, label="true box"))
            place.set(title=name, aspect="equal", xlim=(-4, 4), ylim=(-4, 4), xlabel="x (m)")
        axes[0].set_ylabel("y (m)")
        handles = {
            label: handle for place in axes for handle, label in zip(*place.get_legend_handles_labels(), strict=True)
        }
        figure.legend(handles.values(), handles.keys(), loc="outside lower center", ncols=7, markerscale=3)
        write_figure(figure, out)


def main(folder: Path) -> None:
    """Record two minutes of the T-junction and draw every picture into the folder."""
    with TemporaryDirectory() as scratch:
        path = Path(scratch) / "tjunction.hdf5"
        simulate_dataset("tjunction", path, run=Run(frames=60, seed=992))
        with CoopDataset(path) as recording:
            draw_foreground(recording, folder / "foreground.png")
            draw_errors(recording, folder / "error-profiles.png")


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).parent)
