"""`run_reproduction`: the paper's experiments at one of its sites, from recording to page.

Everything that takes long is kept in the folder, so that an interrupted run resumes: the recording
(`recording_1000.hdf5` and its blocks), detections (`detections.sqlite`), and a table of all sensor
sets if the shipped one does not fit (`table_….npz`). The figures are computed from these files each
time, without a detector."""

import json
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from examples.studies.paper.comparison import LARGE_AP_DIFFERENCE, Experiment, to_csv
from examples.studies.paper.detections import SchemeRun, StoredDetections, detect_runs
from examples.studies.paper.iou_densities import iou_experiment
from examples.studies.paper.page import paper_page
from examples.studies.paper.paper_tables import (
    CAUSES,
    DEPTH_NOISE_M,
    PAPER_SITES,
    PLACE_NAMES,
    REGION_TABLE,
    TEST_FRAMES,
)
from examples.studies.paper.point_densities import density_experiment
from examples.studies.paper.pr_curves import curve_experiment, curve_runs
from examples.studies.paper.region_tables import benchmark_experiment, region_experiment
from examples.studies.paper.scheme_table import scheme_experiment, scheme_runs
from examples.studies.paper.set_table import set_experiment
from placement_env.checks import check_whole
from placement_env.fidelity.renders import Recorded
from placement_env.fidelity.table import Table, hash_site, load_table, make_table
from toolkit.bodies.fleet import fleet_named
from toolkit.datasets.dataset import CoopDataset
from toolkit.datasets.simulation import simulate_dataset
from toolkit.detection.provenance import coview_version
from toolkit.objects import Detector
from toolkit.runtime.cache import Cache
from toolkit.runtime.run import Processes, Run
from toolkit.runtime.text_tables import align_columns
from toolkit.runtime.text_values import replace_infinite
from toolkit.runtime.writing import write_text, writing_together

GIVEN_DETECTOR = (
    "The detector is not the shipped one: what the causes say about the shipped network does not "
    "apply to it."
)
SEEDS = {"tjunction": 2001, "roundabout": 2002}  # for the test recordings, as in docs/figures.md
NOISE_SEED = 0
PAGE = "index.html"
FIGURES = "reproduction.json"


def all_runs(site: str, sensors: int) -> list[SchemeRun]:
    """List the runs that the experiments need. sensors: number of the site's sensors."""
    region_runs = [SchemeRun("early", row.sensors) for row in REGION_TABLE[site]]
    return scheme_runs(sensors) + curve_runs(site) + region_runs


def all_experiments(
    stored: StoredDetections, seen: StoredDetections, table: Table, site: str
) -> tuple[Experiment, ...]:
    """Compute every experiment, in the paper's order.

    stored: detections; seen: frames of the table of sensor sets, for its reasons; table: AP of
    every sensor set."""
    basis = f"{stored.frames} frames, {stored.vehicles} vehicles"
    return (
        scheme_experiment(stored, site, basis),
        set_experiment(table, seen, site),
        curve_experiment(stored, site, basis),
        region_experiment(stored, site, basis),
        density_experiment(stored, site, basis),
        iou_experiment(stored, site, basis),
        benchmark_experiment(stored, site, basis),
    )


@dataclass(frozen=True)
class Reproduction:
    """Experiments at a site.

    Attributes:
        site: Name of the site.
        frames: Number of frames.
        vehicles: Number of scored vehicles in all frames.
        experiments: Experiments in the paper's order.
        page: Path of the page.
    """

    site: str
    frames: int
    vehicles: int
    experiments: tuple[Experiment, ...]
    page: Path

    @property
    def summary(self) -> str:
        """Table of the AP differences from the paper, as text with a line for each experiment."""
        large = f"beyond {LARGE_AP_DIFFERENCE:g}"
        table = [["experiment", "AP compared", large, "mean difference", "greatest"]]
        for experiment in self.experiments:
            rows = [row for row in experiment.rows if row.unit == "AP"]
            differences = [row.difference for row in rows if row.difference is not None]
            if differences:
                large_count = sum(abs(value) > LARGE_AP_DIFFERENCE for value in differences)
                mean = f"{sum(differences) / len(differences):+.4f}"
                greatest = f"{max(differences, key=abs):+.4f}"
                counts = [str(len(differences)), str(large_count)]
                table.append([experiment.name, *counts, mean, greatest])
        head = f"{self.site}: {self.frames} frames, {self.vehicles} vehicles"
        return f"{head}\n{align_columns(table, texts=1)}"

    def as_dict(self) -> dict[str, object]:
        """Return the values for JSON."""
        about = {"site": self.site, "frames": self.frames, "vehicles": self.vehicles}
        return about | {"experiments": [experiment.as_dict() for experiment in self.experiments]}


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

    frames: number of frames to evaluate; detector: function that makes one for the recording, None
    for the site's shipped network; table: file of `coview table` with the AP of all sensor sets,
    None for the shipped table, or for a new one if that was not measured at this site with this
    detector; recorded: number of frames of the recording, at least `frames`. Raises ValueError for
    a site that the paper has no figures for, and for arguments that do not fit."""
    check_paper_site(site)
    check_whole("frames", frames, least=1)
    check_whole("recorded", recorded, least=1)
    given_table = None if table is None else load_table(table)
    out = Path(out)
    recorded = max(frames, recorded)
    path = out / f"recording_{recorded}.hdf5"
    run = Run(frames=recorded, seed=SEEDS[site], **vars(processes))
    try:
        simulate_dataset(site, path, run=run, fleet=fleet_named("catalogue"))
    except FileExistsError:
        raise FileExistsError(
            f"{path} is damaged or no test recording: remove it, or give another --out"
        ) from None
    with CoopDataset(path) as recording:
        if detector is None:
            from models.detector_loading import load_site_detector

            detect: Detector = load_site_detector(site, recording.site.area)
        else:
            detect = detector(recording)
        digest = getattr(detect, "digest", None)
        shipped = load_table(site)
        place = hash_site(recording.site, recording.sensors)
        if given_table is not None:
            _check_table(given_table, place, digest)
        set_table = shipped if given_table is None else given_table
        renders = Recorded(recording, NOISE_SEED)
        memo = Cache(out / "detections.sqlite")
        detect_in = partial(detect_runs, renders, detect, memo=memo, processes=processes)
        stored = detect_in(all_runs(site, len(recording.sensors)), frames=frames)
        if (set_table.origin.place, set_table.origin.detector) != (place, digest):
            path = out / f"table_{frames}_{str(digest)[:12]}_{renders.digest[:12]}.npz"
            try:
                set_table = load_table(path)
            except (ValueError, FileNotFoundError):  # damaged, or not made yet
                set_table = make_table(
                    renders, detect, path, frames=frames, seed=NOISE_SEED, processes=processes
                )
        table_frames = min(set_table.origin.frames, renders.frames)
        table_detections = detect_in((), frames=table_frames, stage="frames looked at")
    experiments = all_experiments(stored, table_detections, set_table, site)
    causes = CAUSES
    if detector is not None and stored.detector != shipped.origin.detector:
        causes = CAUSES | {"!": GIVEN_DETECTOR}
    conditions = _conditions(stored, set_table, site)
    write_experiments(out, experiments, site=site, conditions=conditions, causes=causes)
    return Reproduction(site, stored.frames, stored.vehicles, experiments, out / PAGE)


def _check_table(table: Table, place: str, digest: str | None) -> None:
    """Raise ValueError for a table of other sensors or of another detector.

    place: hash of site and sensors; digest: digest of the detector, None if it has none."""
    if table.origin.place != place:
        raise ValueError(
            f"the table is of {table.origin.site!r} with other sensors: make one with coview table"
        )
    if table.origin.detector != digest:
        raise ValueError("the table was measured with another detector: make one with coview table")


def check_paper_site(site: str) -> None:
    """Raise ValueError for a site that the paper has no figures for."""
    if site not in PAPER_SITES:
        raise ValueError(
            f"the paper has figures for {' and '.join(PAPER_SITES)}, not for {site!r}: choose one "
            "of them"
        )


def write_experiments(
    out: Path,
    experiments: tuple[Experiment, ...],
    *,
    site: str,
    conditions: dict[str, str],
    causes: dict[str, str],
) -> None:
    """Write the page, all figures as JSON, and CSV and SVG of each experiment.

    All files appear together at the end. conditions: how the figures were computed, by name;
    causes: causes of differences, by letter."""
    with writing_together(out) as folder:
        pictures = {}
        for experiment in experiments:
            experiment.draw(folder / f"{experiment.name}.svg")
            pictures[experiment.name] = (folder / f"{experiment.name}.svg").read_bytes()
            write_text(folder / f"{experiment.name}.csv", experiment.csv)
            for name, rows in experiment.curves:
                write_text(folder / f"{name}.csv", to_csv(rows))
        figures = {
            "site": site,
            "conditions": conditions,
            "experiments": [experiment.as_dict() for experiment in experiments],
        }
        text = json.dumps(replace_infinite(figures), indent=1, allow_nan=False)
        write_text(folder / FIGURES, text)
        title = (
            f"The paper's experiments at the {PLACE_NAMES[site]}, our figures beside the paper's"
        )
        page = paper_page(title, experiments, pictures, conditions=conditions, causes=causes)
        write_text(folder / PAGE, page)


def _conditions(stored: StoredDetections, table: Table, site: str) -> dict[str, str]:
    # how the figures were computed, as texts by name
    origin = table.origin
    return {
        "test recording": (
            f"{stored.frames} frames, seed {SEEDS[site]}, {stored.vehicles} vehicles (no heavy "
            f"ones) centred in the area; the paper's has {TEST_FRAMES} frames"
        ),
        "sensors": (
            f"{len(stored.sensors)}, exact poses; noise of {DEPTH_NOISE_M * 100:g} cm at every "
            "depth"
        ),
        "detector": f"digest {stored.detector[:12]}",
        "sensor sets": f"exact table of {origin.frames} frames, {origin.objects} vehicles",
        "protocol": (
            "exact (toolkit.detection.metrics): all-point interpolated AP, IoU of volumes, 0.7 "
            "unless stated"
        ),
        "milliseconds": (
            "of this machine under its load at the time; only the order of magnitude can be "
            "compared"
        ),
        "coview": coview_version(),
        "made by": f"coview reproduce {site} --frames {stored.frames}",
    }
