"""`coview stress`: what is left of the AP when messages are late or lost, poses are wrong and sensors fail."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from tyro.conf import Positional

from coview.arguments import Label, check_ious, check_schemes, site_file
from coview.detectors import check_digest, recording_detector
from coview.exits import OK
from coview.outputs import check_folder
from coview.printing import print_result
from coview.progress_bar import progress_bar
from coview.recordings import frame_count, open_recording
from toolkit.runtime.run import Run


def stress(
    dataset: Positional[Path],
    /,
    *,
    detector: str = "cluster",
    schemes: tuple[str, ...] = ("early", "foreground", "hybrid", "late"),
    kinds: tuple[str, ...] = (),
    label: Label = "vehicle",
    iou: tuple[float, ...] = (0.7,),
    site: str | None = None,
    table: str | None = None,
    out: Path = Path("out/stress"),
    overwrite: bool = False,
    json: bool = False,
    run: Run = Run(),
) -> int:
    """Put fusion schemes under stress: pose errors, sensors that are silent, blinded or frozen, and, where frames lie
    close together, delay, loss, lower rates and clocks that differ. Prints and writes AP with intervals, where one
    scheme overtakes another, and how soon the failure of a sensor is noticed.

    Example: coview stress sequence.hdf5 --detector voxelnet --schemes early foreground --kinds bytes pose delay

    Args:
        dataset: Recording; for delay, loss, rate and clock one made with coview simulate --every 0.1.
        detector: As in coview evaluate.
        schemes: Any of early, late, hybrid, foreground and differences (of foregrounds).
        kinds: Any of bytes, pose, mounting, silent, pairs, blinded, frozen, delay, loss, rate and clock; all that the
            recording can show by default.
        label: Class of the road users to find.
        iou: Thresholds at which a detection counts; rows for each.
        site: Name or file; needed for foreign recordings that show no built-in site.
        table: Built-in site or .npz of coview table: adds what is left exactly when one or two sensors fail.
        out: Folder for stress.json and stress.svg; rewritten after each condition.
        overwrite: Replace the files of another run.
        json: Print the rows as JSON.
        run: With a cache an interrupted run resumes, and another one detects only what is new.
    """
    from coview.studies.stress.crossings import find_crossings
    from coview.studies.stress.noticing import time_faults
    from coview.studies.stress.outputs import STRESS_FILES, StressResults, exact_failures, write_rows, write_stress
    from coview.studies.stress.stressing import (
        KeptDetections,
        StressQuestion,
        StressRow,
        choose_kinds,
        is_sequence,
        run_stress,
    )
    from placement_env.fidelity.table import load_table
    from toolkit.detection.codec import PAPER
    from toolkit.detection.provenance import dataset_origin, detector_origin, settings_origin

    check_ious(iou)
    check_schemes(schemes)
    for name in STRESS_FILES:
        check_folder(out, holds=name, inputs=[dataset, *site_file(site)], overwrite=overwrite)
    exact = None if table is None else exact_failures(load_table(table), ious=iou, label=label)
    with open_recording(dataset, site) as recording:
        total = frame_count(recording, run.frames)
        question = StressQuestion(schemes=schemes, kinds=choose_kinds(recording, kinds), label=label, ious=iou)
        detect = recording_detector(detector, recording)
        if run.cache is not None:
            check_digest(detector, detect, ", or leave --cache out")
        kept = KeptDetections.of(detect, run.memo)
        provenance = dataset_origin(recording) | detector_origin(detect)
        provenance |= settings_origin(
            PAPER, site=recording.site.name, frames=total, seed=run.seed, kinds=question.kinds
        )
        rows: list[StressRow] = []

        def keep(more: Sequence[StressRow]) -> None:
            rows.extend(more)
            write_rows(rows, provenance, out)

        with progress_bar("frame", hidden=json) as bar:
            run_stress(recording, kept, question, replace(run, progress=bar.stage), finished=keep)
        results = StressResults(tuple(rows), find_crossings(rows, seed=run.seed), exact=exact)
        if is_sequence(recording) and {"silent", "blinded", "frozen"} & {*question.kinds}:
            noticed, alarms = time_faults(recording, kept, run)
            results = replace(results, noticed=noticed, false_alarms=alarms)
    write_stress(results, provenance, out)
    text = f"{results.as_text()}\n\nwritten to {out}: {', '.join(STRESS_FILES)}"
    print_result(results.as_dict(provenance), text, as_json=json)
    return OK
