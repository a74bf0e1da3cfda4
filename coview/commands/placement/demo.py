"""`coview demo`: what coview does, in a minute or two."""

from pathlib import Path

from coview.arguments import check_least
from coview.commands.detection.evaluate import evaluate_command
from coview.commands.detection.evaluation_options import Subject
from coview.commands.placement.plan import Goal, StockOptions, plan_command
from coview.commands.recordings.simulate import simulate_command
from coview.detector_spec import DetectorSpec
from coview.detectors import check_detector, open_detector
from coview.options import Output
from coview.outputs import OK, Writing, check_folder, say
from coview.recordings import open_recording
from toolkit.objects import LABELS
from toolkit.runtime.run import USUAL_WORKERS, Run
from toolkit.runtime.writing import UNFINISHED

RECORDING = "tjunction.hdf5"
PLAN = "plan"  # folder
CACHE = "cache"  # folder
PLAN_SENSORS = 3  # from the site's six


def demo_command(
    *,
    out: Path = Path("out/demo"),
    frames: int = 100,
    plan_frames: int = 24,
    seed: int = 1,
    detector: str = "voxelnet",
    overwrite: bool = False,
) -> int:
    """Show what six sensors at a T-junction detect, and plan which to build.

    Makes a table, pictures, PR curves, and a report to open in a browser.

    Args:
        out: Folder for the recording, the table, the pictures and the plan.
        frames: Number of frames to record and score.
        plan_frames: Number of frames of each part of the plan's traffic; 0 for no plan.
        seed: Seed of the traffic.
        detector: Detector, as in coview evaluate.
        overwrite: Replace existing files; files of another demo are replaced anyway."""
    from toolkit.detection.evaluation_files import curve_files, draw_example

    check_least("--frames", frames, 1)
    check_least("--plan-frames", plan_frames, 0)
    spec = DetectorSpec.from_name(detector)
    check_detector(spec)
    files = {RECORDING, "table.json", "birds_eye.png", *curve_files(LABELS)}
    demo_names = files | {f"{RECORDING}.parts", PLAN, CACHE}
    may_overwrite = overwrite
    if out.is_dir():
        names = {path.name for path in out.iterdir() if UNFINISHED not in path.name}
        may_overwrite = overwrite or names <= demo_names
    for name in sorted(files):
        check_folder(out, holds=name, overwrite=may_overwrite)
    writing = Writing(overwrite=may_overwrite)
    simulate_command(
        "tjunction",
        out=out / RECORDING,
        run=Run(frames=frames, seed=seed, workers=None),
        writing=writing,
    )
    evaluate_command(out / RECORDING, subject=Subject(detector), out=out, writing=writing)
    with open_recording(out / RECORDING, site=None) as recording:
        draw_example(recording, open_detector(spec, recording), out / "birds_eye.png", seed=seed)
    say(f"pictures in {out}: birds_eye.png, pr_0.7.png")
    if plan_frames:
        plan_command(
            "tjunction",
            goal=Goal(budget=PLAN_SENSORS),
            stock=StockOptions(candidates="paper"),
            run=Run(seed=seed, frames=plan_frames, cache=out / CACHE, workers=USUAL_WORKERS),
            output=Output(out=out / PLAN, overwrite=True),
        )
        say(f"open {out / PLAN / 'report.html'} in a browser")
    return OK
