"""`coview convert`: write a recording in another layout."""

from __future__ import annotations

from pathlib import Path

from tyro.conf import Positional

from coview.arguments import Label, check_errors, check_least
from coview.exits import OK
from coview.outputs import check_file, check_new_folder
from coview.printing import print_result
from coview.progress_bar import progress_bar
from coview.recordings import Opening, count_passing


def convert(
    recording: Positional[Path],
    /,
    *,
    to: str,
    out: Path,
    classes: tuple[Label, ...] | None = None,
    frames: int | None = None,
    errors: str | None = None,
    seed: int = 0,
    overwrite: bool = False,
    json: bool = False,
    opening: Opening = Opening(),
) -> int:
    """Write a recording in another layout: clouds, poses and labels.

    Example: coview convert tjunction.hdf5 --to kitti --out as-kitti

    Example: coview convert lidars.hdf5 --errors typical --to folder --out as-measured

    Example: coview convert my-log --layout argoverse --to hdf5 --out my-log.hdf5

    Args:
        recording: As in coview detect.
        to: Layout to write: folder, kitti, openlabel, dair, opv2v, v2xset, v2xreal, nuscenes, argoverse, sustech,
            rosbag, which has no place for labels, hdf5, one file of clouds with all that is known, or a plug-in's.
        out: Folder to write, of hdf5 the file.
        classes: Only objects of these.
        frames: Only the first frames.
        errors: Of sensors that measured images, as in coview evaluate, crooked poses among them; none by default.
        seed: Of these errors.
        overwrite: Write into a folder that holds something.
        json: Print the summary as JSON.
        opening: How the recording is opened.
    """
    from toolkit.datasets.readings import ReadRecording, Reads
    from toolkit.datasets.recordings import Part, filter_classes, find_layout

    check_least("--frames", frames, 1, "leave it out for all")
    if errors is not None:
        check_errors(errors)
    target = find_layout(to)
    write, problems = target.write, dict[str, int]()
    with opening.open(recording) as opened:
        (check_file if target.file else check_new_folder)(out, inputs=[recording, *opening.files], overwrite=overwrite)
        some = Part(opened if errors is None else ReadRecording(opened, Reads(errors, seed)), frames)
        with progress_bar("frame", len(some), hidden=json) as bar:
            written = write(count_passing(filter_classes(some, classes), problems, bar.to), out)
    met = "".join(f"; {number} {kind}" for kind, number in problems.items())
    summary = {"out": str(out), "samples": written, "problems": problems}
    print_result(summary, f"{out}: {written} frames as {to}{met}", as_json=json)
    return OK
