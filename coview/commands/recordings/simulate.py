"""`coview simulate`: record a site."""

from __future__ import annotations

from pathlib import Path
from time import perf_counter
from typing import Literal

from tyro.conf import Positional

from coview.arguments import check_least, site_file
from coview.exits import OK
from coview.outputs import check_file
from coview.printing import print_result
from coview.progress_bar import progress_bar


def simulate(
    site: Positional[str],
    /,
    *,
    out: Path,
    frames: int = 1000,
    seed: int = 0,
    every: float = 5.0,
    workers: int | None = None,
    fleet: Literal["own", "catalogue", "meshes", "both"] | None = None,
    meshes: Path | None = None,
    mirrors_in_boxes: bool = False,
    held_out: bool = False,
    overwrite: bool = False,
    json: bool = False,
) -> int:
    """Record a site: SUMO moves the traffic, rays are cast, HDF5 in the paper's layout is written.

    Killed at any moment and started again it goes on where it was, to the same bytes.

    Example: coview simulate tjunction --frames 1000 --seed 7 --out tjunction.hdf5

    Args:
        site: tjunction, roundabout, or a site file.
        out: HDF5 file to write.
        frames: How many frames.
        seed: Same seed, same machine: same bytes.
        every: Seconds between frames: 5, or 0.1 for sensors at 10 Hz, 50 frames without a break.
        workers: Processes; one per core when left out.
        fleet: own: everyone drawn afresh; meshes: yours, and drawn ones of classes you have none of; both: half
            drawn, half yours; catalogue: our 47 bodies and your meshes. Left out: own, or meshes with --meshes.
        meshes: Folder of your own meshes, anything Open3D reads; how each was taken is printed.
        mirrors_in_boxes: Let the boxes of vehicles hold their wing mirrors; they end at the body otherwise.
        held_out: Of our own cars take those that no shipped detector was trained on, to test one.
        overwrite: Replace a file that holds another recording.
        json: Print the summary as JSON.
    """
    from toolkit.bodies.fleet import fleet_named
    from toolkit.datasets.simulation import simulate_dataset
    from toolkit.sites.files import load_site

    check_least("--frames", frames, 1)
    check_least("--workers", workers, 1, "leave it out for one per core")
    chosen = fleet_named(fleet, meshes, held_out=held_out, mirrors=mirrors_in_boxes)
    if not json:
        for note in chosen.notes:
            print(note)
    place, started = load_site(site), perf_counter()
    check_file(out, inputs=site_file(site), overwrite=True)  # whether it holds the same recording is seen later
    with progress_bar("frame", frames, hidden=json) as bar:
        new = simulate_dataset(
            place, frames=frames, seed=seed, out=out, workers=workers, fleet=chosen,
            overwrite=overwrite, progress=bar.to, interval=every,
        )  # fmt: skip
    seconds = perf_counter() - started
    summary = {"file": str(out), "site": place.name, "frames": frames, "frames_made_now": new, "seconds": seconds,
               "meshes": list(chosen.notes)}  # fmt: skip
    text = f"{out}: {frames} frames at {place.name}, {new} of them made now, {new / seconds:.1f} a second"
    print_result(summary, text, as_json=json)
    return OK
