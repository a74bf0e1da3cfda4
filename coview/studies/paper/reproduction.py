"""`run_reproduction`: the paper's experiments at one of its sites, from simulating the test recording to the page.

Everything that takes long is kept in the folder, so that an interrupted run resumes: the recording
(`recording_1000.hdf5`, its blocks beside it), detections (`detections.sqlite`), and a table of all sensor sets if the
shipped one does not fit (`table_….npz`). The figures are computed from these each time, without a detector.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from coview.studies.paper.comparison import (
    CAUSES,
    DEPTH_NOISE,
    GIVEN,
    LARGE,
    PAPER_SITES,
    PLACE_NAMES,
    TEST_FRAMES,
    Experiment,
    to_csv,
)
from coview.studies.paper.detections import StoredDetections, detect_runs
from coview.studies.paper.experiments import all_experiments, all_runs
from coview.studies.paper.page import paper_page
from placement_env.checks import check_whole
from placement_env.fidelity.renders import Recorded
from placement_env.fidelity.table import Table, hash_site, load_table, make_table
from toolkit.bodies.fleet import fleet_named
from toolkit.datasets.dataset import CoopDataset
from toolkit.datasets.simulation import simulate_dataset
from toolkit.detection.provenance import coview_version
from toolkit.objects import Detector
from toolkit.runtime.cache import Cache
from toolkit.runtime.files import replace_infinite, write_text, writing_together
from toolkit.runtime.run import Processes, Run
from toolkit.runtime.text_tables import align_columns

SEEDS = {"tjunction": 2001, "roundabout": 2002}  # of the test recordings, as in docs/figures.md
NOISE_SEED = 0
PAGE, FIGURES = "index.html", "reproduction.json"


@dataclass(frozen=True)
class Reproduction:
    """Experiments at a site, and the path of the page."""

    site: str
    frames: int
    vehicles: int
    experiments: tuple[Experiment, ...]
    page: Path

    @property
    def summary(self) -> str:
        """Table of AP differences from the paper's."""
        table = [["experiment", "AP compared", f"beyond {LARGE:g}", "mean difference", "greatest"]]
        for each in self.experiments:
            differences = [row.difference for row in each.rows if row.unit == "AP" and row.difference is not None]
            if differences:
                far = sum(abs(difference) > LARGE for difference in differences)
                mean, greatest = sum(differences) / len(differences), max(differences, key=abs)
                table.append([each.name, str(len(differences)), str(far), f"{mean:+.4f}", f"{greatest:+.4f}"])
        return f"{self.site}: {self.frames} frames, {self.vehicles} vehicles\n{align_columns(table, texts=1)}"

    def as_dict(self) -> dict[str, object]:
        """Return the values for JSON."""
        about = {"site": self.site, "frames": self.frames, "vehicles": self.vehicles}
        return about | {"experiments": [each.as_dict() for each in self.experiments]}


def run_reproduction(
    site: str,
    out: str | Path,
    *,
    frames: int = TEST_FRAMES,
    detector: Callable[[CoopDataset], Detector] | None = None,
    table: str | Path | None = None,
    recorded: int = TEST_FRAMES,
    processes: Processes = Processes(),
) -> Reproduction:
    """Run the paper's experiments at one of its sites and write them into a folder.

    frames: of the test recording that are evaluated; detector: makes one for the recording, None for the site's shipped
    network; table: file of `coview table` with the AP of all sensor sets, None for the shipped table, or for a new one
    if that was not measured at this site with this detector; recorded: frames of the recording, at least `frames`.
    Raises ValueError for a site that the paper has no figures for, and for arguments that do not fit.
    """
    check_paper_site(site)
    check_whole("frames", frames, least=1)
    check_whole("recorded", recorded, least=1)
    given = None if table is None else load_table(table)
    out, recorded = Path(out), max(frames, recorded)
    path = out / f"recording_{recorded}.hdf5"
    run = Run(frames=recorded, seed=SEEDS[site], **vars(processes))
    try:
        simulate_dataset(site, path, run=run, fleet=fleet_named("catalogue"))
    except FileExistsError:
        raise FileExistsError(
            f"{path} is damaged or not the test recording: remove it, or give another --out"
        ) from None
    with CoopDataset(path) as recording:
        if detector is None:
            from models.detector import load_site_detector

            detect: Detector = load_site_detector(site, recording.site.area)
        else:
            detect = detector(recording)
        digest, shipped = getattr(detect, "digest", None), load_table(site)
        place = hash_site(recording.site, recording.sensors)
        sets = shipped if given is None else given
        if given is not None and given.origin.place != place:
            raise ValueError(f"the table is of {given.origin.site!r} with other sensors: make one with coview table")
        if given is not None and given.origin.detector != digest:
            raise ValueError("the table was measured with another detector: make one with coview table")
        renders, memo = Recorded(recording, NOISE_SEED), Cache(out / "detections.sqlite")
        detect_in = partial(detect_runs, renders, detect, memo=memo, processes=processes)
        stored = detect_in(all_runs(site, len(recording.sensors)), frames=frames)
        if (sets.origin.place, sets.origin.detector) != (place, digest):
            path = out / f"table_{frames}_{str(digest)[:12]}_{renders.digest[:12]}.npz"
            try:
                sets = load_table(path)
            except (ValueError, FileNotFoundError):  # damaged, or not made yet
                sets = make_table(renders, detect, path, frames=frames, seed=NOISE_SEED, processes=processes)
        seen = detect_in((), frames=min(sets.origin.frames, renders.frames), stage="frames looked at")
    experiments = all_experiments(stored, seen, sets, site)
    causes = CAUSES if detector is None or stored.detector == shipped.origin.detector else CAUSES | {"!": GIVEN}
    write_experiments(out, experiments, site=site, conditions=_conditions(stored, sets, site), causes=causes)
    return Reproduction(site, stored.frames, stored.vehicles, experiments, out / PAGE)


def check_paper_site(site: str) -> None:
    """Raise ValueError where the paper has no figures for a site."""
    if site not in PAPER_SITES:
        raise ValueError(f"the paper has figures for {' and '.join(PAPER_SITES)}, not for {site!r}: choose one of them")


def write_experiments(
    out: Path, experiments: tuple[Experiment, ...], *, site: str, conditions: dict[str, str], causes: dict[str, str]
) -> None:
    """Write the page, all figures as JSON, and CSV and SVG of each experiment."""
    with writing_together(out) as folder:
        pictures = {}
        for each in experiments:
            each.draw(folder / f"{each.name}.svg")
            pictures[each.name] = (folder / f"{each.name}.svg").read_bytes()
            write_text(folder / f"{each.name}.csv", each.csv)
            for name, rows in each.curves:
                write_text(folder / f"{name}.csv", to_csv(rows))
        figures = {"site": site, "conditions": conditions, "experiments": [each.as_dict() for each in experiments]}
        write_text(folder / FIGURES, json.dumps(replace_infinite(figures), indent=1, allow_nan=False))
        title = f"The paper's experiments at the {PLACE_NAMES[site]}, our figures beside the paper's"
        write_text(folder / PAGE, paper_page(title, experiments, pictures, conditions=conditions, causes=causes))


def _conditions(stored: StoredDetections, table: Table, site: str) -> dict[str, str]:
    origin = table.origin
    return {
        "test recording": f"{stored.frames} frames, seed {SEEDS[site]}, {stored.vehicles} vehicles (no heavy ones) "
        f"centred in the area; the paper's has {TEST_FRAMES} frames",
        "sensors": f"{len(stored.sensors)}, exact poses; noise of {DEPTH_NOISE * 100:g} cm at every depth",
        "detector": f"digest {stored.detector[:12]}",
        "sensor sets": f"exact table of {origin.frames} frames, {origin.objects} vehicles",
        "protocol": "exact (toolkit.detection.metrics): all-point interpolated AP, IoU of volumes, 0.7 unless stated",
        "milliseconds": "of this machine under its load at the time; only the order of magnitude can be compared",
        "coview": coview_version(),
        "made by": f"coview reproduce {site} --frames {stored.frames}",
    }
