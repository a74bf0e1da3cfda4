"""`coview stress`: what is left of the AP when messages are late or lost, poses wrong and sensors fail."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from tyro.conf import Positional

from coview.arguments import Label, check_ious, check_least, check_schemes, site_file
from coview.detectors import check_digest, recording_detector
from coview.exits import OK
from coview.outputs import check_folder
from coview.printing import print_result
from coview.progress_bar import progress_bar
from coview.recordings import frame_count, open_recording


def stress(
    dataset: Positional[Path],
    /,
    *,
    detector: str = "cluster",
    schemes: tuple[str, ...] = ("early", "foreground", "hybrid", "late"),
    kinds: tuple[str, ...] = (),
    label: Label = "vehicle",
    iou: tuple[float, ...] = (0.7,),
    frames: int | None = None,
    seed: int = 0,
    site: str | None = None,
    cache: Path | None = None,
    table: str | None = None,
    out: Path = Path("out/stress"),
    overwrite: bool = False,
    json: bool = False,
) -> int:
    """Put fusion schemes under stress: bytes, pose errors, sensors that are silent, blinded or frozen, and, where
    frames lie close together, delay, loss, lower rates and clocks that differ. AP with intervals, text, JSON and SVG,
    where one scheme overtakes another, and how soon it is noticed that a sensor fails.

    Example: coview stress sequence.hdf5 --detector voxelnet --schemes early foreground --kinds bytes pose delay

    Args:
        dataset: Recording; for delay, loss, rate and clock made by coview simulate --every 0.1.
        detector: As in coview evaluate.
        schemes: Which of early, late, hybrid, foreground, differences (of foregrounds) and adaptive fusion, the last
            within 3 kbit a sensor, and where bytes are looked at, within 0.5 to 6.
        kinds: Which of bytes, pose, mounting, silent, pairs, blinded, frozen, delay, loss, rate and clock; all that the
            recording can show when left out.
        label: Class of the road users to be found.
        iou: At which a detection counts; several for rows of each.
        frames: Only the first so many frames.
        seed: Of noise, errors, channels and intervals.
        site: Name or file; needed for foreign recordings that show no built-in site.
        cache: File that keeps what the detector said: with it a run that was stopped goes on where it was, and another
            with other schemes, levels and IoUs asks only for what is new.
        table: Built-in site or .npz of coview table: what is left of all sensors when one or two fail, exactly.
        out: Folder for stress.json and stress.svg, written anew after each condition.
        overwrite: Replace those of another run.
        json: Print the rows as JSON.
    """
    from placement_env.fidelity.table import load_table
    from placement_env.report.stress.crossings import crossings
    from placement_env.report.stress.exact_failures import exact_failures
    from placement_env.report.stress.files import (
        STRESS_FILES,
        format_crossings,
        format_exact,
        format_noticed,
        format_stress,
        stress_content,
        write_rows,
        write_stress,
    )
    from placement_env.report.stress.kept_detections import KeptDetections
    from placement_env.report.stress.noticing import noticing
    from placement_env.report.stress.outcomes import StressRow
    from placement_env.report.stress.stressing import in_sequence, kinds_for
    from placement_env.report.stress.stressing import stress as put_under_stress
    from toolkit.detection.codec import PAPER
    from toolkit.detection.provenance import dataset_origin, detector_origin, settings_origin
    from toolkit.runtime.cache import Cache

    check_ious(iou)
    check_schemes(schemes)
    check_least("--seed", seed, 0)
    for name in STRESS_FILES:
        check_folder(out, holds=name, inputs=[dataset, *site_file(site)], overwrite=overwrite)
    beside: dict[str, Sequence[Any]] = {}
    if table is not None:
        beside["exact"] = exact_failures(load_table(table), ious=iou, label=label)
    with open_recording(dataset, site) as recording:
        total, chosen = frame_count(recording, frames), kinds_for(recording, kinds)
        detect = recording_detector(detector, recording)
        if cache is not None:
            check_digest(detector, detect, ", or leave --cache out")
        kept = KeptDetections(detect, None if cache is None else Cache(cache))
        provenance = dataset_origin(recording) | detector_origin(detect)
        provenance |= settings_origin(PAPER, site=recording.site.name, frames=total, seed=seed, kinds=chosen)
        rows: list[StressRow] = []

        def keep(more: Sequence[StressRow]) -> None:
            rows.extend(more)
            write_rows(rows, provenance, out)

        with progress_bar("frame", hidden=json) as bar:
            put_under_stress(
                recording, kept, schemes=schemes, kinds=chosen, frames=total, label=label, ious=iou, seed=seed,
                progress=bar.of, finished=keep,
            )  # fmt: skip
        if in_sequence(recording) and {"silent", "blinded", "frozen"} & {*chosen}:
            beside["noticed"], beside["false_alarms"] = noticing(recording, kept, frames=total, seed=seed)
    beside["crossings"] = crossings(rows, seed=seed)
    content = stress_content(rows, provenance, **beside)
    write_stress(rows, content, out)
    texts = [format_stress(rows), format_crossings(rows, beside["crossings"])]
    texts += [format_noticed(beside["noticed"], beside["false_alarms"])] if "noticed" in beside else []
    texts += [format_exact(beside["exact"])] if "exact" in beside else []
    texts.append(f"written to {out}: {', '.join(STRESS_FILES)}")
    print_result(content, "\n\n".join(filter(None, texts)), as_json=json)
    return OK
