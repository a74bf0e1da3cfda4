"""`coview stress`: what is left of the AP when messages are late or lost, poses wrong and sensors fail."""

from __future__ import annotations

from pathlib import Path

from tyro.conf import Positional

from coview.arguments import Label, check_ious, check_least, check_schemes, site_file
from coview.detectors import recording_detector
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
    iou: float = 0.7,
    frames: int | None = None,
    seed: int = 0,
    site: str | None = None,
    out: Path = Path("out/stress"),
    overwrite: bool = False,
    json: bool = False,
) -> int:
    """Put fusion schemes under stress: bytes, pose errors, sensors that are silent, blinded or frozen, and, where
    frames lie close together, delay, loss, lower rates and clocks that differ. AP with intervals, text, JSON and SVG.

    Example: coview stress sequence.hdf5 --detector voxelnet --schemes early foreground --kinds bytes pose delay

    Args:
        dataset: Recording; for delay, loss, rate and clock made by coview simulate --every 0.1.
        detector: As in coview evaluate.
        schemes: Which of early, late, hybrid, foreground, differences (of foregrounds) and adaptive fusion, the
            last within 3 kbit a sensor.
        kinds: Which of bytes, pose, silent, blinded, frozen, delay, loss, rate and clock; all that the recording can
            show when left out.
        label: Class of the road users to be found.
        iou: At which a detection counts.
        frames: Only the first so many frames.
        seed: Of noise, errors, channels and intervals.
        site: Name or file; needed for foreign recordings that show no built-in site.
        out: Folder for stress.json and stress.svg.
        overwrite: Replace those of another run.
        json: Print the rows as JSON.
    """
    from placement_env.report.stress.files import STRESS_FILES, format_stress, stress_content, write_stress
    from placement_env.report.stress.stressing import kinds_for
    from placement_env.report.stress.stressing import stress as put_under_stress
    from toolkit.detection.codec import PAPER
    from toolkit.detection.provenance import dataset_origin, detector_origin, settings_origin

    check_ious([iou])
    check_schemes(schemes)
    check_least("--seed", seed, 0)
    for name in STRESS_FILES:
        check_folder(out, holds=name, inputs=[dataset, *site_file(site)], overwrite=overwrite)
    with open_recording(dataset, site) as recording:
        total, chosen = frame_count(recording, frames), kinds_for(recording, kinds)
        detect = recording_detector(detector, recording)
        with progress_bar("frame", hidden=json) as bar:
            rows = put_under_stress(
                recording, detect, schemes=schemes, kinds=chosen, frames=total, label=label, iou=iou, seed=seed,
                progress=bar.of,
            )  # fmt: skip
        provenance = dataset_origin(recording) | detector_origin(detect)
        provenance |= settings_origin(PAPER, site=recording.site.name, frames=total, seed=seed, kinds=chosen)
    write_stress(rows, provenance, out)
    text = f"{format_stress(rows)}\nwritten to {out}: {', '.join(STRESS_FILES)}"
    print_result(stress_content(rows, provenance), text, as_json=json)
    return OK
