"""`coview convert`: write a recording of clouds in another layout."""

from __future__ import annotations

from pathlib import Path

from tyro.conf import Positional

from coview.arguments import Label, check_least
from coview.clouds import first_of, open_clouds, open_with_errors, passing
from coview.exits import OK
from coview.outputs import check_file, check_new_folder
from coview.printing import print_result
from coview.progress_bar import progress_bar


def convert(
    recording: Positional[Path],
    /,
    *,
    layout: str,
    to: str,
    out: Path,
    classes: tuple[Label, ...] | None = None,
    frames: int | None = None,
    errors: str | None = None,
    seed: int = 0,
    overwrite: bool = False,
    json: bool = False,
) -> int:
    """Write a recording of clouds, ours included, in another layout: clouds, poses and labels.

    Example: coview convert tjunction.hdf5 --layout hdf5 --to kitti --out as-kitti

    Example: coview convert lidars.hdf5 --layout hdf5 --errors typical --to folder --out as-measured

    Example: coview convert my-log --layout argoverse --to hdf5 --out my-log.hdf5

    Args:
        recording: As in coview detect, or a file of coview simulate with --layout hdf5.
        layout: It has this layout.
        to: Write this one: folder, kitti, openlabel, dair, opv2v, v2xset, v2xreal, nuscenes, argoverse, sustech,
            rosbag, which has no place for labels, or hdf5, one file of clouds as they are, with all that is known.
        out: Folder to write, of hdf5 the file.
        classes: Only objects of these.
        frames: Only the first so many.
        errors: Of sensors in --layout hdf5, as in coview evaluate, crooked poses among them; none when left out.
        seed: Of these errors.
        overwrite: Write into a folder that holds something.
        json: Print the summary as JSON.
    """
    from toolkit.datasets.recordings import layout_named, of_classes, write_samples

    check_least("--frames", frames, 1, "leave it out for all")
    target = layout_named(to)
    if target.write is None:
        raise ValueError(f"layout {to} is only read: write another, such as folder")
    samples = open_clouds(recording, layout) if errors is None else open_with_errors(recording, layout, errors, seed)
    (check_file if target.file else check_new_folder)(out, inputs=[recording], overwrite=overwrite)
    problems: dict[str, int] = {}
    with progress_bar("sample", min(len(samples), frames or len(samples)), hidden=json) as bar:
        chosen = of_classes(first_of(samples, frames), classes)
        written = write_samples(passing(chosen, problems, bar.to), out, to)
    met = "".join(f"; {number} {kind}" for kind, number in problems.items())
    summary = {"out": str(out), "samples": written, "problems": problems}
    print_result(summary, f"{out}: {written} samples as {to}{met}", as_json=json)
    return OK
