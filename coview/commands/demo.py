"""`coview demo`: what coview does, in a minute or two."""

from __future__ import annotations

from pathlib import Path

from coview.arguments import check_least
from coview.commands.evaluate import evaluate
from coview.commands.simulate import simulate
from coview.detectors import recording_detector
from coview.exits import OK
from coview.outputs import check_folder
from coview.recordings import open_recording

RECORDING = "tjunction.hdf5"
MADE = {RECORDING, f"{RECORDING}.parts", "table.json", "birds_eye.png", "pr_0.7.png", "pr_0.8.png", "pr_0.9.png"}


def demo(
    *,
    out: Path = Path("out/demo"),
    frames: int = 100,
    seed: int = 1,
    detector: str = "voxelnet",
    overwrite: bool = False,
) -> int:
    """What six sensors at a T-junction detect by early, late and hybrid fusion: table, pictures, PR curves.

    Args:
        out: Folder for the recording, the table and the pictures.
        frames: How many frames to record and score.
        seed: Of the traffic.
        detector: As in coview evaluate.
        overwrite: Replace what is in the folder; another demo's files are replaced anyway.
    """
    from toolkit.detection.example_picture import draw_example

    check_least("--frames", frames, 1)
    again = overwrite or (out.is_dir() and {each.name for each in out.iterdir()} <= MADE)
    for name in sorted(MADE - {f"{RECORDING}.parts"}):
        check_folder(out, holds=name, overwrite=again)
    simulate("tjunction", out=out / RECORDING, frames=frames, seed=seed, overwrite=again)
    evaluate(out / RECORDING, detector=detector, out=out, overwrite=again)
    with open_recording(out / RECORDING, None) as recording:
        draw_example(recording, recording_detector(detector, recording), out / "birds_eye.png", seed=seed)
    print(f"pictures in {out}: birds_eye.png, pr_0.7.png")
    return OK
