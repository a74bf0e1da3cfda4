"""`coview reproduce`: the paper's experiments, our figures next to the paper's."""

from dataclasses import replace
from functools import partial
from pathlib import Path

from tyro.conf import Positional

from coview.arguments import check_least
from coview.detector_spec import DetectorSpec
from coview.detectors import check_detector, open_detector
from coview.outputs import OK, check_folder, claim, print_result
from coview.progress_bar import progress_bar
from toolkit.runtime.run import Processes


def reproduce_command(
    site: Positional[str],
    /,
    *,
    out: Path,
    frames: int = 1000,
    detector: str = "voxelnet",
    table: Path | None = None,
    json: bool = False,
    processes: Processes = Processes(),
) -> int:
    """Run the paper's experiments at one of its sites, our figures next to the paper's.

    Results are a page, CSV and SVG. An interrupted run resumes; a finished one rewrites its page
    within seconds.

    Example: coview reproduce tjunction --frames 100 --out out/paper_tjunction

    Args:
        site: tjunction or roundabout.
        out: Folder for the page, the files of each experiment, the test recording and its
            detections.
        frames: Number of test frames; the paper has 1000, 20 take minutes.
        detector: Detector, as in coview evaluate; any but the site's own makes a new table, which
            takes long.
        table: Table of all sensor sets (.npz of coview table) in place of the shipped one.
        json: Print all figures as JSON."""
    from examples.studies.paper.reproduction import PAGE, check_paper_site, run_reproduction

    check_paper_site(site)
    check_least("--frames", frames, 1)
    spec = DetectorSpec.from_name(detector)
    check_detector(spec)
    check = partial(check_folder, out, holds=PAGE, inputs=[] if table is None else [table])
    with (
        claim(out, (site, frames, detector, table), check, overwrite=True),
        progress_bar("frame", hidden=json) as bar,
    ):
        reproduction = run_reproduction(
            site,
            out,
            frames=frames,
            detector=partial(open_detector, spec),
            table=table,
            processes=replace(processes, progress=bar.stage),
        )
    text = f"{reproduction.summary}\nwritten to {reproduction.page}"
    print_result(reproduction.as_dict(), text, as_json=json)
    return OK
