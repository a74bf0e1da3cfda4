"""`coview train`: train VoxelNet and draw its curves."""

from __future__ import annotations

from tyro.conf import Positional

from coview.outputs import OK, print_result
from coview.progress_bar import progress_bar
from models.training.options import TrainingOptions


def train(site: Positional[str | None] = None, /, *, training: TrainingOptions, json: bool = False) -> int:
    """Train VoxelNet on a packed file.

    If killed and started again, it resumes and ends with the same weights. The same arguments train on a bare machine,
    without pictures: python -m models.train.

    Example: coview train tjunction --preset fast --data tjunction.packed --out runs/tjunction --validate test.packed

    Args:
        site: Area to train for: tjunction, roundabout, a site file, or general for any place; the data's when left out.
        json: Print the summary as JSON.
    """
    from models.train import run
    from models.training.loop import LOG, read_curves
    from toolkit.plots.curves import draw_training

    with progress_bar("step", hidden=json) as bar:

        def report(step: int, total: int, figures: dict[str, float]) -> None:
            bar.of(step, total)
            if "AP@0.7" in figures:
                bar.line("  ".join(f"{name} {value:.4f}" for name, value in figures.items()))
            else:
                bar.figures(figures)

        weights, measured = run(site, training, progress=report)
    draw_training(read_curves(training.out / LOG), training.out)
    pictures = "losses.png, ap.png" if training.validate else "losses.png"
    text = f"{training.out}: {weights.name}, {LOG}, {pictures}"
    print_result({"weights": str(weights), "ap": measured}, text, as_json=json)
    return OK
