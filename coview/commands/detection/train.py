"""`coview train` and `coview export`: train a network, write one as ONNX."""

from pathlib import Path

from tyro.conf import Positional

from coview.arguments import check_ending
from coview.outputs import CARD_KIND, OK, Writing, check_file, print_result
from coview.progress_bar import progress_bar
from models.training.options import TrainingOptions
from toolkit.calibration.place import Corners


def train_command(
    site: Positional[str | None] = None, /, *, training: TrainingOptions, json: bool = False
) -> int:
    """Train VoxelNet on a packed file.

    If killed and started again, it resumes and ends with the same weights. The same arguments train
    on a bare machine, without pictures: python -m models.train.

    Example: coview train tjunction --preset fast --data tjunction.packed --out runs/tjunction
        --validate test.packed

    Args:
        site: Area to train for: tjunction, roundabout, a site file, or general for any place; the
            data's when left out.
        json: Print the summary as JSON."""
    from models.train import run_training
    from models.training.training_log import LOG, read_curves
    from toolkit.plots.curves import draw_training

    with progress_bar("step", hidden=json) as bar:
        weights, measured = run_training(site, training, progress=bar.step)
    draw_training(read_curves(training.out / LOG), training.out)
    pictures = "losses.png, ap.png" if training.validate else "losses.png"
    text = f"{training.out}: {weights.name}, {LOG}, {pictures}"
    print_result({"weights": str(weights), "ap": measured}, text, as_json=json)
    return OK


def export_command(
    weights: Positional[str],
    out: Positional[Path],
    /,
    *,
    area: Corners | None = None,
    writing: Writing = Writing(),
) -> int:
    """Write a network as ONNX, and a card of its area, voxels, anchors, classes, thresholds and
    calibration.

    Every command takes the file in place of a detector's name.

    Example: coview export general junction.onnx --area -40 -20 40 20

    Args:
        weights: Shipped weights, or a weights file.
        out: ONNX file to write; the card is NAME.onnx.json next to it.
        area: Area xmin ymin xmax ymax (m), for weights that go anywhere; the area of the
            weights when left out."""
    from models.detector_loading import weights_file
    from models.onnx_files import card_file, export_onnx

    check_ending(out, (".onnx",), "a network in ONNX")
    inputs = [weights_file(weights)]
    check_file(out, inputs=inputs, overwrite=writing.overwrite)
    unfinished = not out.exists()  # a killed export may have left its card
    check_file(
        card_file(out), inputs=inputs, overwrite=writing.overwrite or unfinished, kind=CARD_KIND
    )
    out.parent.mkdir(parents=True, exist_ok=True)
    export_onnx(weights, out, area)
    print_result(
        {"out": str(out), "card": str(card_file(out))},
        f"{out}, card {card_file(out)}",
        as_json=writing.json,
    )
    return OK
