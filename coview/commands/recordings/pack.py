"""`coview pack`: recordings, or junctions drawn at random, as one small file to train from."""

from __future__ import annotations

from contextlib import ExitStack
from dataclasses import dataclass, replace
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Literal, cast

from tyro.conf import Positional

from coview.arguments import check_least, refuse_given
from coview.outputs import OK, Writing, check_file, print_result
from coview.progress_bar import progress_bar
from coview.recordings import Opening, frame_count
from toolkit.detection.place import Place
from toolkit.runtime.run import Run

if TYPE_CHECKING:
    from toolkit.datasets.dataset import CoopDataset


@dataclass(frozen=True)
class RandomSites:
    """Random junctions to record instead of packing recordings."""

    random_sites: int = 0
    """Number of junctions to draw, with sensors and traffic."""
    fleet: Literal["own", "catalogue"] = "own"
    """Bodies of road users: all drawn afresh (own), or our 47, each a little stretched (catalogue)."""


def pack(
    datasets: Positional[tuple[Path, ...]] = (),
    /,
    *,
    out: Path,
    packed: tuple[Path, ...] = (),
    sites: RandomSites = RandomSites(),
    opening: Opening = Opening(),
    place: Place = Place(),
    run: Run = Run(workers=None),
    writing: Writing = Writing(),
) -> int:
    """Pack recordings for training: one small file that needs no Open3D and no SUMO to be read.

    At a known site what differs from the empty site is kept; of other recordings their points, on level ground. If
    killed while drawing random sites, it resumes and writes the same bytes. Of each random site 20 frames are recorded
    when --frames is left out.

    Example: coview pack tjunction.hdf5 --out tjunction.packed

    Example: coview pack --random-sites 200 --frames 20 --seed 1 --out general.packed

    Example: coview pack my-clouds --packed general.packed --out mixed.packed

    Args:
        datasets: Recordings, at the same or different sites.
        out: Packed file to write.
        packed: Packed files whose frames are appended, to train on simulated and recorded frames together.
    """
    from models.training.packing import dataset_recording, drawn_file, join_packed, read_recordings, sample_recordings
    from models.training.packing import pack as write

    random_sites = sites.random_sites
    check_least("--random-sites", random_sites, 0)
    if bool(datasets) == bool(random_sites):
        raise ValueError("give recordings, or --random-sites N")
    check_file(out, inputs=[*datasets, *packed, *opening.files], overwrite=writing.overwrite)
    refuse_given({"--packed": bool(packed and random_sites)}, "is not for --random-sites")
    if random_sites:
        from toolkit.bodies.fleet import fleet_named
        from toolkit.datasets.random_recordings import random_recordings_file

        with progress_bar("site", random_sites, hidden=writing.json) as bar:
            total = random_recordings_file(
                random_sites,
                out,
                run=replace(run, progress=bar.stage),
                encode=drawn_file,
                join=join_packed,
                fleet=fleet_named(sites.fleet),
                overwrite=writing.overwrite,
            )
    else:
        from toolkit.datasets.recordings import Part
        from toolkit.detection.place import level_frames

        with ExitStack() as stack:
            opened = [stack.enter_context(opening.open(path)) for path in datasets]
            count = sum(frame_count(recording, run.frames) for recording in opened)
            bar = stack.enter_context(progress_bar("frame", count, hidden=writing.json))
            made = (
                [dataset_recording(cast("CoopDataset", recording), run.frames)]
                if place.at(recording.site)
                else sample_recordings(level_frames(Part(recording, run.frames), place))
                for recording in opened
            )
            total = write(chain(*made, *map(read_recordings, packed)), out, progress=bar.to)
    megabytes = out.stat().st_size / 1e6
    summary = {"file": str(out), "frames": total, "mb": megabytes}
    print_result(summary, f"{out}: {total} frames, {megabytes:.0f} MB", as_json=writing.json)
    return OK
