"""`coview stress`: AP under late or lost messages, wrong poses and failing sensors."""

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

from tyro.conf import Positional

from coview.arguments import check_each_once, site_file
from coview.detector_spec import DetectorSpec
from coview.detectors import check_detector, check_digest, open_detector
from coview.outputs import OK, Writing, check_folder, claim, print_result
from coview.progress_bar import progress_bar
from coview.recordings import frame_count, open_recording
from examples.studies.stress import noticing, outputs, stressing
from examples.studies.stress.conditions import StressQuestion
from placement_env.fidelity.table import load_table
from toolkit.datasets.dataset import CoopDataset
from toolkit.detection.codec import PAPER
from toolkit.detection.provenance import dataset_origin, detector_origin, settings_origin
from toolkit.runtime.run import Run

FAULT_KINDS = frozenset(("silent", "blinded", "frozen"))  # whose notice is timed in sequences


def stress_command(
    dataset: Positional[Path],
    /,
    *,
    detector: str = "cluster",
    site: str | None = None,
    table: str | None = None,
    out: Path = Path("out/stress"),
    question: StressQuestion = StressQuestion(),
    run: Run = Run(),
    writing: Writing = Writing(),
) -> int:
    """Stress fusion schemes: wrong poses, failing sensors, late or lost messages.

    Prints and writes AP with intervals, where one scheme overtakes another, and how soon the
    failure of a sensor is noticed. Delay, loss, rate and clock need frames that lie close together
    (coview simulate --every 0.1). With --cache an interrupted run resumes, and another one detects
    only what is new.

    Example: coview stress sequence.hdf5 --detector voxelnet --schemes early foreground
        --kinds bytes pose delay

    Args:
        dataset: Recording of a known site.
        detector: Detector, as in coview evaluate.
        site: Name or file of the site, for recordings that show no built-in one.
        table: Built-in site or .npz of coview table, to add exact figures for one or two failing
            sensors.
        out: Folder for stress.json and stress.svg, rewritten after each condition."""
    check = partial(_check_outputs, out, [dataset, *site_file(site)])
    settings = (dataset, detector, site, table, question, run)
    exact_figures = None
    if table is not None:
        loaded_table = load_table(table)
        exact_figures = outputs.exact_failures(
            loaded_table, ious=question.iou, label=question.label
        )
    spec = DetectorSpec.from_name(detector)
    check_detector(spec)
    for name in ("schemes", "kinds", "iou"):
        check_each_once(f"--{name}", getattr(question, name))
    stressing.check_stress_kinds(question.kinds or ())
    with (
        open_recording(dataset, site) as recording,
        claim(out, settings, check, overwrite=writing.overwrite),
    ):
        question = replace(question, kinds=stressing.choose_kinds(recording, question.kinds))
        if _times_faults(recording, question):
            noticing.check_stretches(recording, run)
        detect = open_detector(spec, recording)
        if run.cache is not None:
            check_digest(detector, detect, ", or leave --cache out")
        kept_detections = stressing.KeptDetections.from_detector(detect, run.memo)
        provenance = dataset_origin(recording) | detector_origin(detect)
        frames = frame_count(recording, run.frames)
        provenance |= settings_origin(
            PAPER, site=recording.site.name, frames=frames, seed=run.seed, kinds=question.kinds
        )
        results = _run(recording, kept_detections, question, run, out, provenance, writing.json)
        results = replace(results, exact=exact_figures)
        outputs.write_stress(results, provenance, out)
    text = f"{results.as_text()}\n\nwritten to {out}: {', '.join(outputs.STRESS_FILES)}"
    print_result(results.as_dict(provenance), text, as_json=writing.json)
    return OK


def _check_outputs(out: Path, inputs: Sequence[Path], overwrite: bool) -> None:
    """Check that the results may be written."""
    for name in outputs.STRESS_FILES:
        check_folder(out, holds=name, inputs=inputs, overwrite=overwrite)


def _times_faults(recording: CoopDataset, question: StressQuestion) -> bool:
    """True if the notice of failing sensors is timed: in sequences, if faults are asked for."""
    return stressing.is_sequence(recording) and bool(FAULT_KINDS & {*(question.kinds or ())})


def _run(
    recording: CoopDataset,
    detector: stressing.KeptDetections,
    question: StressQuestion,
    run: Run,
    out: Path,
    provenance: dict[str, object],
    hidden: bool,
) -> outputs.StressResults:
    """Test all conditions, and time the faults of sequences.

    Rows are written after each condition. hidden: show no progress."""
    rows: list[stressing.StressRow] = []

    def keep(condition_rows: Sequence[stressing.StressRow]) -> None:
        rows.extend(condition_rows)
        outputs.write_rows(rows, provenance, out)

    with progress_bar("frame", hidden=hidden) as bar:
        shown_run = replace(run, progress=bar.stage)
        stressing.run_stress(recording, detector, question, shown_run, finished=keep)
    crossings = outputs.find_crossings(rows, seed=run.seed)
    results = outputs.StressResults(tuple(rows), crossings)
    if _times_faults(recording, question):
        noticed, alarms = noticing.time_faults(recording, detector, run)
        results = replace(results, noticed=noticed, false_alarms=alarms)
    return results
