"""`coview pack`: recordings, or junctions drawn at random, as one small file to train from."""

from __future__ import annotations

from contextlib import ExitStack
from itertools import chain
from pathlib import Path
from typing import Literal

from tyro.conf import Positional

from coview.arguments import check_least, refuse_given, site_file
from coview.clouds import cloud_recordings, open_clouds
from coview.exits import OK
from coview.outputs import check_file
from coview.printing import print_result
from coview.progress_bar import progress_bar
from coview.recordings import check_frames, frame_count, open_recording

FRAMES = 20  # of each random site


def pack(
    datasets: Positional[tuple[Path, ...]] = (),
    /,
    *,
    out: Path,
    random_sites: int = 0,
    frames: int | None = None,
    seed: int = 0,
    fleet: Literal["own", "catalogue"] = "own",
    workers: int | None = None,
    site: str | None = None,
    drop_invalid: bool = False,
    layout: str | None = None,
    level: Literal["map", "plane", "none"] = "map",
    still: bool = False,
    area: tuple[float, float, float, float] | None = None,
    packed: tuple[Path, ...] = (),
    overwrite: bool = False,
    json: bool = False,
) -> int:
    """Pack recordings for training: one small file that needs no Open3D and no SUMO to be read.

    Killed while it draws random sites and started again it goes on where it was, to the same bytes.

    Example: coview pack tjunction.hdf5 --out tjunction.packed

    Example: coview pack --random-sites 200 --frames 20 --seed 1 --out general.packed

    Example: coview pack my-clouds --layout folder --packed general.packed --out mixed.packed

    Args:
        datasets: Recordings; their sites may differ.
        out: Packed file to write.
        random_sites: Draw so many junctions with sensors and traffic instead, and record each.
        frames: Only the first so many of each recording; of each random site, 20 when left out.
        seed: Of the random sites.
        fleet: Bodies at random sites; own: everyone drawn afresh; catalogue: our 47, each a little stretched.
        workers: Processes for random sites; one per core when left out.
        site: As in coview evaluate.
        drop_invalid: As in coview evaluate.
        layout: Of recordings of clouds, as in coview detect; their points are kept as they are, on level ground.
        level: With --layout, as in coview detect.
        still: With --layout, as in coview detect.
        area: With --layout, as in coview detect.
        packed: Packed files whose frames are put behind these, to train on simulated and recorded ones together.
        overwrite: Replace a file that is there.
        json: Print the summary as JSON.
    """
    from models.training.packing import dataset_recording, drawn_file, join_packed, read_recordings
    from models.training.packing import pack as write

    check_frames(frames)
    check_least("--workers", workers, 1, "leave it out for one per core")
    check_least("--random-sites", random_sites, 0)
    if bool(datasets) == bool(random_sites):
        raise ValueError("give recordings, or --random-sites N")
    check_file(out, inputs=[*datasets, *packed, *site_file(site)], overwrite=overwrite)
    if layout is None:
        refuse_given({"--level": level != "map", "--still": still, "--area": area is not None}, "needs --layout")
    refuse_given({"--packed": bool(packed and random_sites)}, "is not for --random-sites")
    if random_sites:
        from toolkit.bodies.fleet import fleet_named
        from toolkit.datasets.random_recordings import random_recordings_file

        with progress_bar("site", random_sites, hidden=json) as bar:
            total = random_recordings_file(
                random_sites, frames or FRAMES, seed, out, encode=drawn_file, join=join_packed, workers=workers,
                progress=bar.to, fleet=fleet_named(fleet), overwrite=overwrite,
            )  # fmt: skip
    elif layout is not None:
        opened = [open_clouds(path, layout) for path in datasets]
        with progress_bar("sample", sum(min(len(each), frames or len(each)) for each in opened), hidden=json) as bar:
            recordings = cloud_recordings(opened, frames, level=level, still=still, area=area)
            total = write(chain(recordings, *map(read_recordings, packed)), out, progress=bar.to)
    else:
        with ExitStack() as stack:
            simulated = [
                stack.enter_context(open_recording(path, site, drop_invalid=drop_invalid)) for path in datasets
            ]
            count = sum(frame_count(recording, frames) for recording in simulated)
            bar = stack.enter_context(progress_bar("frame", count, hidden=json))
            made = (dataset_recording(recording, frames) for recording in simulated)
            total = write(chain(made, *map(read_recordings, packed)), out, progress=bar.to)
    megabytes = out.stat().st_size / 1e6
    summary = {"file": str(out), "frames": total, "mb": megabytes}
    print_result(summary, f"{out}: {total} frames, {megabytes:.0f} MB", as_json=json)
    return OK
