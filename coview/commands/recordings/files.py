"""`coview convert`, `fuse` and `pack`: files of recordings."""

from collections.abc import Iterable, Sequence
from contextlib import AbstractContextManager, ExitStack, nullcontext
from dataclasses import dataclass, replace
from functools import partial
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Literal, cast

from tyro.conf import Positional

from coview.arguments import Label, check_ending, check_least, check_positive
from coview.outputs import OK, Writing, check_empty_folder, check_file, claim, print_result
from coview.progress_bar import progress_bar
from coview.recordings import Opening, count_passing, frame_count
from toolkit.bodies.fleet import fleet_named
from toolkit.calibration.level_frames import level_frames
from toolkit.calibration.place import Place
from toolkit.datasets.cloud_files import crop_area, fuse_files
from toolkit.datasets.layouts.argoverse import check_log
from toolkit.datasets.pose_files import load_poses
from toolkit.datasets.recording_views import Part, ReadRecording, Reads, filter_classes
from toolkit.datasets.recordings import find_layout
from toolkit.runtime.reading import check_links
from toolkit.runtime.run import Simulation
from toolkit.sensors.error_profiles import find_profile

if TYPE_CHECKING:
    from models.training.packing import PackedRecording
    from toolkit.datasets.dataset import CoopDataset
    from toolkit.frame import Recording


@dataclass(frozen=True)
class Contents:
    """Contents to write."""

    classes: tuple[Label, ...] | None = None
    """Classes of objects to write; all when left out."""
    frames: int | None = None
    """Number of first frames to write; all when left out."""
    errors: str | None = None
    """Error profile of sensors that measured images, as in coview evaluate; none when left out."""
    seed: int = 0
    """Seed of these errors."""


def convert_command(
    recording: Positional[Path],
    /,
    *,
    to: str,
    out: Path,
    contents: Contents = Contents(),
    opening: Opening = Opening(),
    writing: Writing = Writing(),
) -> int:
    """Write a recording in another layout: clouds, poses and labels.

    Example: coview convert tjunction.hdf5 --to kitti --out as-kitti

    Example: coview convert lidars.hdf5 --errors typical --to folder --out as-measured

    Example: coview convert my-log --layout argoverse --to hdf5 --out my-log.hdf5

    Args:
        recording: Recording in any layout.
        to: Layout to write: one that --layout takes, or one of a plug-in; rosbag has no labels,
            hdf5 keeps everything.
        out: Folder to write, or file for hdf5."""
    check_least("--frames", value=contents.frames, minimum=1, remedy="leave it out for all")
    if contents.errors is not None:
        find_profile(contents.errors)  # raises for an unknown name
    check_links(recording)
    target = find_layout(to)
    if to == "hdf5" and not out.is_dir():
        check_ending(out, (".hdf5", ".h5"), f"a recording in layout {to}")
    if not target.file and out.suffix.lower() in (".hdf5", ".h5", ".json", ".zip"):
        raise ValueError(
            f"layout {to} is a folder, which cannot be called {out.name}: name a folder, or pass "
            "--to hdf5"
        )
    write_frames = target.write
    problems = dict[str, int]()  # number of values that were left out, by kind
    with opening.open(recording) as opened:
        inputs = [recording, *opening.files]
        settings = (recording, to, contents, opening)
        file_claim: AbstractContextManager[object] = nullcontext()
        if target.file:
            check_out = partial(check_file, out, inputs=inputs)
            file_claim = claim(out, settings, check_out, overwrite=writing.overwrite)
        else:
            check_empty_folder(out, inputs=inputs, overwrite=writing.overwrite)
        errors = contents.errors
        measured = opened if errors is None else ReadRecording(opened, Reads(errors, contents.seed))
        part = Part(measured, contents.frames)
        with file_claim, progress_bar("frame", len(part), hidden=writing.json) as bar:
            frames = filter_classes(part, contents.classes)
            written_count = write_frames(count_passing(frames, problems, bar.to), out)
    problem_counts = "".join(f"; {number} {kind}" for kind, number in problems.items())
    summary = {"out": str(out), "samples": written_count, "problems": problems}
    text = f"{out}: {written_count} frames as {to}{problem_counts}"
    print_result(summary, text, as_json=writing.json)
    return OK


@dataclass(frozen=True)
class CropOptions:
    """Part of the fused cloud to keep."""

    area: tuple[float, float, float, float] | None = None
    """Keep points in xmin ymin xmax ymax (m)."""
    height: float = 4.0
    """Keep points below this height (m), with --area."""
    floor: float = 0.0
    """Keep points above this height (m), with --area."""
    voxel: float | None = None
    """Keep one point of each sensor in every cube of this size (m)."""


def fuse_command(
    clouds: Positional[tuple[Path, ...]] = (),
    /,
    *,
    poses: tuple[Path, ...] = (),
    inverted: bool = False,
    out: Path | None = None,
    argoverse: Path | None = None,
    crop: CropOptions = CropOptions(),
    writing: Writing = Writing(),
) -> int:
    """Fuse cloud files in the frame of their poses; or take an Argoverse 2 log apart, fuse it back
    and check it.

    Example: coview fuse north.ply south.pcd --poses poses.json --area -40 -20 40 20
        --out junction.ply

    Example: coview fuse --argoverse my-log

    Args:
        clouds: Cloud files: ply, pcd, xyz, txt, csv, npy, npz, KITTI bin, feather, las or laz.
        poses: One file with all poses, or one per cloud; pipes such as <(...) work too.
        inverted: Take the poses as world to sensor (extrinsics) instead of sensor to world.
        out: File for the fused cloud (ply, pcd or npz).
        argoverse: Log with two lidars; prints its points per labelled cuboid next to the recorded
            counts."""
    from toolkit.clouds import down_sample, save

    if argoverse is not None:
        rows = check_log(argoverse)
        lines = [
            f"{row.sweep}  {row.category:<24} {row.points:>6} {row.recorded:>6}" for row in rows
        ]
        agreeing_count = sum(row.points == row.recorded for row in rows)
        lines.append(f"{agreeing_count} of {len(rows)} cuboids agree")
        values = {"rows": [row._asdict() for row in rows]}
        print_result(values, "\n".join(lines), as_json=writing.json)
        return OK
    if not clouds or not poses:
        raise ValueError("give cloud files and --poses, or --argoverse LOG")
    check_positive("--voxel", crop.voxel)
    check_file(out, inputs=[*clouds, *poses], overwrite=writing.overwrite)
    cloud = fuse_files(clouds, load_poses(clouds, poses, inverted=inverted))
    if crop.area is not None:
        pose_remedy = "pass --inverted if the poses are world to sensor"
        if inverted:
            pose_remedy = "leave out --inverted"
        remedy = f"give another --area, --height or --floor, or {pose_remedy}"
        cloud = crop_area(cloud, crop.area, crop.height, floor=crop.floor, remedy=remedy)
    if crop.voxel is not None:
        cloud = down_sample(cloud, crop.voxel)
    if out is not None:
        out.parent.mkdir(parents=True, exist_ok=True)
        save(cloud, out)
    point_count = len(cloud.point.positions)
    summary = {"files": len(clouds), "points": point_count, "out": out and str(out)}
    text = f"{point_count} points of {len(clouds)} files"
    if out:
        text += f", written to {out}"
    print_result(summary, text, as_json=writing.json)
    return OK


@dataclass(frozen=True)
class RandomSites:
    """Random junctions to record instead of packing recordings."""

    random_sites: int = 0
    """Number of junctions to draw, with sensors and traffic."""
    at: tuple[Path, ...] = ()
    """Site files, such as imported ones, to record in turn with random sensors and traffic, instead
    of drawing any."""
    fleet: Literal["own", "even", "catalogue"] = "own"
    """Bodies of road users: all drawn afresh (own), with many prams and e-scooters (even), or our
    47, each a little stretched (catalogue)."""


def pack_command(
    datasets: Positional[tuple[Path, ...]] = (),
    /,
    *,
    out: Path,
    packed: tuple[Path, ...] = (),
    sites: RandomSites = RandomSites(),
    opening: Opening = Opening(),
    place: Place = Place(),
    run: Simulation = Simulation(workers=None),
    writing: Writing = Writing(),
) -> int:
    """Pack recordings for training: one small file that needs no Open3D and no SUMO to be read.

    At a known site what differs from the empty site is kept; from other recordings their points,
    on level ground. If killed while drawing random sites, it resumes and writes the same bytes. Of
    each random site 20 frames are recorded when --frames is left out.

    Example: coview pack tjunction.hdf5 --out tjunction.packed

    Example: coview pack --random-sites 200 --frames 20 --seed 1 --out general.packed

    Example: coview pack my-clouds --packed general.packed --out mixed.packed

    Args:
        datasets: Recordings, at the same or different sites.
        out: Packed file to write.
        packed: Packed files whose frames are appended, to train on simulated and recorded frames
            together."""
    recording_count = sites.random_sites
    check_least("--random-sites", recording_count, 0)
    if not (datasets or packed or recording_count):
        raise ValueError("give recordings, --packed files to join, or --random-sites N")
    if recording_count and (datasets or packed):
        raise ValueError("give recordings and --packed files, or --random-sites N, not both")
    if sites.at and not recording_count:
        raise ValueError("--at needs --random-sites N: give the number of recordings to make there")
    check_out = partial(check_file, out, inputs=[*datasets, *packed, *sites.at, *opening.files])
    if recording_count:
        was_interrupted = Path(f"{out}.parts").is_dir()  # a run that was killed while it cleaned up
        check_out(overwrite=writing.overwrite or was_interrupted)
        frame_total = _pack_random_sites(sites, out, run, writing)
    else:
        for path in datasets:
            check_links(path)
        settings = (datasets, packed, opening, place, run)
        with claim(out, settings, check_out, overwrite=writing.overwrite), ExitStack() as stack:
            recordings = [stack.enter_context(opening.open(path)) for path in datasets]
            frame_total = _pack_recordings(
                recordings, packed, out, place=place, max_frames=run.frames, writing=writing
            )
    megabytes = out.stat().st_size / 1e6
    summary = {"file": str(out), "frames": frame_total, "mb": megabytes}
    print_result(summary, f"{out}: {frame_total} frames, {megabytes:.0f} MB", as_json=writing.json)
    return OK


def _pack_random_sites(sites: RandomSites, out: Path, run: Simulation, writing: Writing) -> int:
    """Simulate recordings of random junctions, or of the given sites in turn, into one packed file.

    Each recording is packed in the process that made it; the packed files are then joined. Returns
    the number of frames.

    sites: number of junctions, site files (none for random ones) and fleet; out: file to write;
    run: seed, frames and processes; writing: options on progress and overwriting."""
    from models.training.packing import encode_packed_file, join_packed_files
    from toolkit.datasets.simulation import random_recordings_file

    recording_count = sites.random_sites
    with progress_bar("site", recording_count, hidden=writing.json) as bar:
        return random_recordings_file(
            recording_count,
            out,
            run=replace(run, progress=bar.stage),
            encode=encode_packed_file,
            join=join_packed_files,
            fleet=fleet_named(sites.fleet),
            sites=sites.at,
            overwrite=writing.overwrite,
        )


def _pack_recordings(
    recordings: "Sequence[Recording]",
    packed_files: Sequence[Path],
    out: Path,
    *,
    place: Place,
    max_frames: int | None,
    writing: Writing,
) -> int:
    """Pack recordings and the frames of packed files, and return the number of frames.

    packed_files: files that are packed already; out: file to write; place: area and ground of
    recordings of unknown sites; max_frames: number of first frames of each recording, None for all;
    writing: options, of which `json` hides the progress."""
    from models.training.packing import dataset_recording, pack, read_recordings, sample_recordings

    total = sum(frame_count(recording, max_frames) for recording in recordings)
    with progress_bar("frame", total, hidden=writing.json) as bar:
        # one iterable of packed recordings for each recording and file, in their order
        streams = list[Iterable["PackedRecording"]]()
        for recording in recordings:
            # only recordings of the simulator have a site that is known, with its ground and area
            if place.uses_site(recording.site):
                dataset = cast("CoopDataset", recording)
                streams.append([dataset_recording(dataset, max_frames)])
            else:
                frames = level_frames(Part(recording, max_frames), place)
                streams.append(sample_recordings(frames))
        streams += map(read_recordings, packed_files)
        return pack(chain.from_iterable(streams), out, progress=bar.to)
