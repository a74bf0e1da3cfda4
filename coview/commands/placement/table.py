"""`coview table`: the AP of every sensor set of a recording."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from tyro.conf import Positional

from coview.arguments import site_file
from coview.detector_spec import DetectorSpec
from coview.detectors import check_detector, check_digest, open_detector
from coview.options import ClassOptions
from coview.outputs import OK, Writing, check_file, claim, print_result
from coview.progress_bar import progress_bar
from coview.recordings import frame_count, open_recording
from placement_env.fidelity.table import Best, best_sets, make_table
from toolkit.detection.schemes import PAPER_SCHEMES
from toolkit.display import describe_count, format_share
from toolkit.runtime.run import Processes
from toolkit.sensors.error_profiles import find_profile

if TYPE_CHECKING:
    from placement_env.classes import Classes
    from placement_env.fidelity.way_frames import WayFrame
    from toolkit.datasets.dataset import CoopDataset


@dataclass(frozen=True, kw_only=True)
class TableData:
    """Recording and detector."""

    detector: str = "voxelnet"
    """Detector, as in coview evaluate."""
    errors: str = "paper"
    """Error profile of the sensors, as in coview evaluate."""
    frames: int | None = None
    """Number of frames, from the first; all when left out."""
    site: str | None = None
    """Site of the recording, as in coview evaluate."""
    drop_invalid: bool = False
    """Leave out invalid objects, as in coview evaluate."""

    def __post_init__(self) -> None:
        find_profile(self.errors)  # raises for an unknown name


def table_command(
    dataset: Positional[Path],
    /,
    *,
    out: Path,
    data: TableData = TableData(),
    classes: ClassOptions = ClassOptions(),
    processes: Processes = Processes(),
    writing: Writing = Writing(),
) -> int:
    """Score every set of a recording's sensors, in every scheme, with a detector.

    An interrupted run resumes. The table holds the AP of each class; --class-weights and --combine
    are for the best sets that are printed. In a recording with frames less than 1 s apart, each
    road user counts in one frame of its way, or those in queues would outweigh all others.

    Example: coview table tj_test.hdf5 --frames 200 --workers 2 --out tjunction.npz

    Args:
        dataset: Recording of at most 16 sensors.
        out: Table to write (.npz)."""
    from models.train import commit
    from placement_env.fidelity.renders import Recorded

    counted = classes.build()
    check = partial(check_file, out, inputs=[dataset, *site_file(data.site)])
    if out.suffix != ".npz":
        raise ValueError(f"a table's file must end in .npz, by which it is loaded, got {out}")
    spec = DetectorSpec.from_name(data.detector)
    check_detector(spec)
    with (
        open_recording(dataset, data.site, drop_invalid=data.drop_invalid) as recording,
        claim(out, (dataset, data, classes), check, overwrite=writing.overwrite),
        progress_bar("frame", hidden=writing.json) as bar,
    ):
        count = frame_count(recording, data.frames)
        detect = open_detector(spec, recording)
        check_digest(data.detector, detect, ": what is detected is kept until the table is whole")
        ways = _draw_ways(recording, counted, count)
        scored_table = make_table(
            Recorded(recording, errors=find_profile(data.errors), ways=ways),
            detect,
            out,
            frames=count if ways is None else None,
            commit=commit(),
            classes=counted,
            processes=replace(processes, progress=bar.stage),
        )
    best = {scheme: best_sets(scored_table, scheme, classes=counted) for scheme in PAPER_SCHEMES}
    lines = []
    if ways is not None:
        lines.append(
            f"continuous recording: each road user counts once, in {len(ways)} of "
            f"{describe_count(count, 'frame')}"
        )
    for scheme, sizes in best.items():
        for size, sets in sizes.items():
            objects = scored_table.origin.objects
            lines.append(_describe_best(f"{scheme:<7} {size} sensors", sets, objects))
    print_result(best, "\n".join(lines), as_json=writing.json)
    return OK


def _draw_ways(
    recording: "CoopDataset", classes: "Classes", count: int
) -> "tuple[WayFrame, ...] | None":
    """Draw the frame in which each road user counts; None for a recording that is not continuous.

    classes: classes that count; count: number of first frames to use. Raises ValueError for a
    continuous recording without ids, and for one in which nobody counts."""
    from placement_env.fidelity.way_frames import draw_way_frames, is_continuous

    times = None if recording.times is None else recording.times[:count]
    if not is_continuous(times):
        return None
    if not recording.has_ids:
        raise ValueError(
            f"{recording.path} has frames less than 1 s apart and no ids, so nobody can be counted "
            "once: give a recording with ids, or with frames 5 s apart"
        )
    objects = [recording.read_objects(k) for k in range(count)]
    ways = draw_way_frames(objects, recording.site, classes.labels)
    if not ways:
        raise ValueError(
            f"no {' and no '.join(classes.names)} is in the area in "
            f"{describe_count(count, 'frame')} of {recording.path}: increase --frames, or give "
            "other --classes"
        )
    return ways


def _describe_best(title: str, sets: Sequence[Best], objects: int) -> str:
    """Line of the best sets of one size with their AP, as exact as a number of objects supports."""
    texts = [
        f"{','.join(map(str, best.sensors))}: {format_share(best.ap, objects)}" for best in sets
    ]
    return "  ".join([title, *texts])
