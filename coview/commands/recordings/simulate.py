"""`coview simulate`: record a site."""

from dataclasses import dataclass, replace
from pathlib import Path
from time import perf_counter
from typing import Literal

from tyro.conf import Positional

from coview.arguments import check_ending, site_file
from coview.outputs import OK, Writing, check_file, print_result, say
from coview.progress_bar import progress_bar
from toolkit.runtime.run import Simulation


@dataclass(frozen=True, kw_only=True)
class Bodies:
    """Bodies of the traffic."""

    fleet: Literal["own", "even", "catalogue", "meshes", "both"] | None = None
    """Bodies: all drawn (own), with many prams and e-scooters to train on (even), your --meshes,
    both, or our 47 and yours (catalogue); own when left out."""
    meshes: Path | None = None
    """Folder of your own meshes, in any format that Open3D reads, for fleet meshes."""
    mirrors_in_boxes: bool = False
    """Include wing mirrors in the boxes of vehicles."""
    held_out: bool = False
    """Use only our cars that no shipped detector was trained on."""
    strays: float = 0.0
    """Share of road users that are anywhere: people on lanes, cyclists on footways, groups, beside
    walls and cars."""


def simulate_command(
    site: Positional[str],
    /,
    *,
    out: Path,
    every: float = 5.0,
    flow: str | None = None,
    bodies: Bodies = Bodies(),
    run: Simulation = Simulation(frames=1000, workers=None),
    writing: Writing = Writing(),
) -> int:
    """Record a site: SUMO moves the traffic, rays are cast, HDF5 in the paper's layout is written.

    If killed and started again, it resumes and writes the same bytes.

    Example: coview simulate tjunction --frames 1000 --seed 7 --out tjunction.hdf5

    Args:
        site: tjunction, roundabout, or a site file.
        out: HDF5 file to write.
        every: Seconds between frames: 5, or 0.1 for sensors at 10 Hz. Below 1 s traffic goes on:
            road users come in at the border of the map and leave there.
        flow: Demand of traffic that goes on: a table (CSV) with the columns kind (vehicle, cyclist
            or pedestrian), entry, exit and per_hour, or drawn; drawn when left out, below 1 s
            between frames."""
    from toolkit.bodies.fleet import fleet_named
    from toolkit.datasets.simulation import DEFAULT_FRAMES, simulate_dataset
    from toolkit.sites.files import load_site
    from toolkit.traffic.flow import Flow
    from toolkit.traffic.snapshots import Mix

    demand: Flow | Literal["drawn"] | None = None
    if flow is not None:
        demand = "drawn" if flow == "drawn" else Flow.read(flow)
    fleet = fleet_named(
        bodies.fleet, bodies.meshes, held_out=bodies.held_out, mirrors=bodies.mirrors_in_boxes
    )
    if not writing.json:
        for note in fleet.notes:
            say(note)
    loaded_site = load_site(site)
    started = perf_counter()
    frames = run.frames_or(DEFAULT_FRAMES)
    # simulate_dataset checks whether the file holds the same recording
    check_file(out, inputs=site_file(site), overwrite=True)
    check_ending(out, (".hdf5", ".h5"), "a recording")
    with progress_bar("frame", frames, hidden=writing.json) as bar:
        run = replace(run, progress=bar.stage)
        new_frames = simulate_dataset(
            loaded_site,
            out,
            run=run,
            fleet=fleet,
            interval=every,
            mix=Mix(strays=bodies.strays, flow=demand),
            overwrite=writing.overwrite,
        )
    seconds = perf_counter() - started
    summary = {
        "file": str(out),
        "site": loaded_site.name,
        "frames": frames,
        "frames_made_now": new_frames,
        "seconds": seconds,
    }
    text = (
        f"{out}: {frames} frames at {loaded_site.name}, {new_frames} of them made now, "
        f"{new_frames / seconds:.1f} a second"
    )
    print_result({**summary, "meshes": list(fleet.notes)}, text, as_json=writing.json)
    return OK
