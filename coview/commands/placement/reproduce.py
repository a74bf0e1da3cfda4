"""`coview reproduce`: the paper's experiments, ours beside theirs."""

from __future__ import annotations

from functools import partial
from pathlib import Path

from tyro.conf import Positional

from coview.arguments import check_least
from coview.detectors import recording_detector
from coview.exits import OK
from coview.outputs import check_folder
from coview.printing import print_result
from coview.progress_bar import progress_bar


def reproduce(
    site: Positional[str],
    /,
    *,
    out: Path,
    frames: int = 1000,
    detector: str = "voxelnet",
    table: Path | None = None,
    workers: int = 1,
    json: bool = False,
) -> int:
    """Run the paper's experiments at one of its two sites: a page, CSV and SVG of our figures beside the paper's.

    Killed and started again it goes on where it was; started again when all is done it writes the page anew, from what
    was detected, within seconds.

    Example: coview reproduce tjunction --frames 100 --out out/paper_tjunction

    Args:
        site: tjunction or roundabout.
        out: Folder for index.html, the files of each experiment, the test recording and what was detected in it.
        frames: Test frames; the paper has 1000, 20 take minutes.
        detector: As in coview evaluate; one that is not the site's own makes a table of all sensor sets, which takes
            long: make one with coview table elsewhere and give it as --table.
        table: Table of all sensor sets (.npz of coview table) in place of the shipped one.
        workers: Processes.
        json: Print all figures as JSON.
    """
    from placement_env.report.paper.reproduction import PAGE, check_paper_site
    from placement_env.report.paper.reproduction import reproduce as run

    check_paper_site(site)
    check_least("--frames", frames, 1)
    check_least("--workers", workers, 1)
    check_folder(out, holds=PAGE, inputs=[] if table is None else [table], overwrite=True)
    with progress_bar("frame", hidden=json) as bar:
        made = run(
            site, out, frames=frames, detector=partial(recording_detector, detector), table=table, workers=workers,
            progress=bar.stage,
        )  # fmt: skip
    print_result(made.as_dict(), f"{made.summary}\nwritten to {made.page}", as_json=json)
    return OK
