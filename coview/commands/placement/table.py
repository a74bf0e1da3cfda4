"""`coview table`: the AP of every set of a recording's sensors."""

from __future__ import annotations

from pathlib import Path

from tyro.conf import Positional

from coview.arguments import Combine, Label, check_errors, check_least, check_ray, counted_classes, site_file
from coview.detectors import check_digest, recording_detector
from coview.exits import OK
from coview.outputs import check_file
from coview.printing import print_result
from coview.progress_bar import progress_bar
from coview.recordings import frame_count, open_recording


def table(
    dataset: Positional[Path],
    /,
    *,
    out: Path,
    detector: str = "voxelnet",
    classes: tuple[Label, ...] = ("vehicle",),
    class_weights: tuple[float, ...] | None = None,
    combine: Combine = "mean",
    small_iou: float = 0.5,
    errors: str = "paper",
    frames: int | None = None,
    site: str | None = None,
    drop_invalid: bool = False,
    workers: int = 1,
    ray: str | None = None,
    overwrite: bool = False,
    json: bool = False,
) -> int:
    """Score every set of a recording's sensors, in every scheme, with a detector; killed and started again it goes on.

    Example: coview table tj_test.hdf5 --frames 200 --workers 2 --out tjunction.npz

    Args:
        dataset: Recording of at most 16 sensors.
        out: Table to write (.npz); placement_env loads it by its path.
        detector: As in coview evaluate.
        classes: Of road users, of each of which the table holds the AP.
        class_weights: Of each class where the best sets are printed, as combine; the table itself knows neither.
        combine: As in coview search.
        small_iou: As in coview search; the table holds cyclists and pedestrians at this one.
        errors: As in coview evaluate.
        frames: Only the first so many frames.
        site: As in coview evaluate.
        drop_invalid: As in coview evaluate.
        workers: Processes.
        ray: Address of a Ray cluster instead.
        overwrite: Replace a table that is there.
        json: Print the best sets as JSON.
    """
    from models.train import commit
    from placement_env.fidelity.renders import Renders
    from placement_env.fidelity.table import best_sets, make_table
    from toolkit.detection.schemes import PAPER_SCHEMES
    from toolkit.sensors.error_profiles import find_profile

    check_least("--workers", workers, 1)
    check_ray(ray)
    check_errors(errors)
    counted = counted_classes(classes, class_weights, combine, small_iou)
    check_file(out, inputs=[dataset, *site_file(site)], overwrite=overwrite)
    if out.suffix != ".npz":
        raise ValueError(f"a table's file must end in .npz, by which it is loaded, got {out}")
    opened = open_recording(dataset, site, drop_invalid=drop_invalid)
    with opened as recording, progress_bar("frame", hidden=json) as bar:
        count = frame_count(recording, frames)
        detect = recording_detector(detector, recording)
        check_digest(detector, detect, ": what is detected is kept until the table is whole")
        measured = Renders.of(recording, errors=find_profile(errors))
        made = make_table(
            measured, detect, out, frames=count, commit=commit(), workers=workers, ray=ray, progress=bar.of,
            classes=counted,
        )  # fmt: skip
    best = {scheme: best_sets(made, scheme, classes=counted) for scheme in PAPER_SCHEMES}
    lines = [
        f"{scheme:<7} {size} sensors  " + "  ".join(f"{','.join(map(str, s))}: {ap:.4f}" for s, ap in sets)
        for scheme, sizes in best.items()
        for size, sets in sizes.items()
    ]
    print_result(best, "\n".join(lines), as_json=json)
    return OK
