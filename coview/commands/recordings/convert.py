"""`coview convert`: write a recording in another layout."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from tyro.conf import Positional

from coview.arguments import Label, check_errors, check_least
from coview.outputs import OK, Writing, check_file, check_new_folder, print_result
from coview.progress_bar import progress_bar
from coview.recordings import Opening, count_passing


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


def convert(
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
        to: Layout to write: one of those of --layout, or of a plug-in; rosbag has no labels, hdf5 keeps everything.
        out: Folder to write, or file for hdf5.
    """
    from toolkit.datasets.readings import ReadRecording, Reads
    from toolkit.datasets.recordings import Part, filter_classes, find_layout

    check_least("--frames", contents.frames, 1, "leave it out for all")
    if contents.errors is not None:
        check_errors(contents.errors)
    target = find_layout(to)
    write, problems = target.write, dict[str, int]()
    with opening.open(recording) as opened:
        check = check_file if target.file else check_new_folder
        check(out, inputs=[recording, *opening.files], overwrite=writing.overwrite)
        errors = contents.errors
        read = opened if errors is None else ReadRecording(opened, Reads(errors, contents.seed))
        some = Part(read, contents.frames)
        with progress_bar("frame", len(some), hidden=writing.json) as bar:
            written = write(count_passing(filter_classes(some, contents.classes), problems, bar.to), out)
    met = "".join(f"; {number} {kind}" for kind, number in problems.items())
    summary = {"out": str(out), "samples": written, "problems": problems}
    print_result(summary, f"{out}: {written} frames as {to}{met}", as_json=writing.json)
    return OK
