"""`reproduce`: the paper's experiments at one of its sites, from simulating the test recording to the page.

Everything long is kept in the folder and goes on where it was killed: the recording (`recording_1000.hdf5`, its blocks
beside it), what was detected (`detections.sqlite`), and a table of all sensor sets where the shipped one does not fit
(`table_….npz`). From these the figures are computed anew each time, without a detector.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from placement_env.analysis.tables import columns
from placement_env.checks import check_whole
from placement_env.fidelity.renders import Recorded, Renders
from placement_env.fidelity.table import Table, digest_of, load_table, make_table
from placement_env.report.paper.comparison import LARGE, Compared, Experiment, as_csv
from placement_env.report.paper.curves import curve_experiment, curve_runs
from placement_env.report.paper.density import density_experiment
from placement_env.report.paper.iou_density import iou_experiment
from placement_env.report.paper.page import paper_page
from placement_env.report.paper.published import DEPTH_NOISE, PAPER_SITES, PLACE_NAMES, TEST_FRAMES
from placement_env.report.paper.reasons import CAUSES, GIVEN
from placement_env.report.paper.regions import benchmark_experiment, region_experiment, region_runs
from placement_env.report.paper.scheme_table import scheme_experiment, scheme_runs
from placement_env.report.paper.set_table import set_experiment
from placement_env.report.paper.stored import StoredDetections, detect_runs
from toolkit.bodies.fleet import fleet_named
from toolkit.datasets.dataset import CoopDataset
from toolkit.datasets.simulation import simulate_dataset
from toolkit.detection.provenance import coview_version
from toolkit.objects import Detector
from toolkit.runtime.cache import Cache
from toolkit.runtime.files import finite, write_text, writing_together
from toolkit.sites.files import load_site

SEEDS = {"tjunction": 2001, "roundabout": 2002}  # of the test recordings, as in docs/figures.md
NOISE_SEED = 0
PAGE, FIGURES = "index.html", "reproduction.json"
StageProgress = Callable[[str, int, int | None], None]


@dataclass(frozen=True)
class Reproduction:
    """The experiments at a site, and where the page is."""

    site: str
    frames: int
    vehicles: int
    experiments: tuple[Experiment, ...]
    page: Path

    @property
    def large(self) -> tuple[tuple[str, Compared], ...]:
        """The AP that differ much from the paper's, each with the name of its experiment."""
        return tuple((each.name, row) for each in self.experiments for row in each.rows if row.large)

    @property
    def summary(self) -> str:
        """For terminals: how far the AP of each experiment are from the paper's."""
        table = [["experiment", "AP compared", f"beyond {LARGE:g}", "mean difference", "greatest"]]
        for each in self.experiments:
            differences = [row.difference for row in each.rows if row.unit == "AP" and row.difference is not None]
            if differences:
                far = sum(abs(difference) > LARGE for difference in differences)
                mean, greatest = sum(differences) / len(differences), max(differences, key=abs)
                table.append([each.name, str(len(differences)), str(far), f"{mean:+.4f}", f"{greatest:+.4f}"])
        return f"{self.site}: {self.frames} frames, {self.vehicles} vehicles\n{columns(table)}"

    def as_dict(self) -> dict[str, Any]:
        """For JSON."""
        about = {"site": self.site, "frames": self.frames, "vehicles": self.vehicles}
        return about | {"experiments": [each.as_dict() for each in self.experiments]}


def reproduce(
    site: str,
    out: str | Path,
    *,
    frames: int = TEST_FRAMES,
    detector: Callable[[CoopDataset], Detector] | None = None,
    table: str | Path | None = None,
    recorded: int = TEST_FRAMES,
    workers: int = 1,
    progress: StageProgress | None = None,
) -> Reproduction:
    """Run the paper's experiments at one of its sites and write them into a folder.

    frames: of the test recording that are evaluated; detector: makes it for the recording, None for the site's shipped
    network; table: file of `coview table` for the sensor sets, None for the shipped one, or one made anew where that
    was not measured at this site with this detector; recorded: frames of the recording, at least `frames`; workers:
    processes; progress: called with the name of a stage, how much of it is done and how much there is.
    Raises ValueError for a site that the paper has no figures of, and for arguments that do not fit.
    """
    check_paper_site(site)
    check_whole("frames", frames, least=1)
    check_whole("recorded", recorded, least=1)
    given = None if table is None else load_table(table)
    out, recorded = Path(out), max(frames, recorded)
    with test_recording(site, out, recorded, workers=workers, progress=progress) as recording:
        detect = _shipped(site, recording) if detector is None else detector(recording)
        if given is not None:
            _check_table(given, recording, detect)
        renders, memo = Renders.of(recording, NOISE_SEED), Cache(out / "detections.sqlite")
        stored = detect_runs(
            renders, detect, [*scheme_runs(len(recording.sensors)), *curve_runs(site), *region_runs(site)],
            memo=memo, frames=frames, workers=workers,
            progress=_staged(progress, "frames detected"),
        )  # fmt: skip
        sets = given or _fitting(site, recording, detect)
        if sets is None:
            sets = _made(renders, detect, out, frames, workers, _staged(progress, "frames of all sensor sets"))
        shipped = detector is None or stored.detector == load_table(site).origin.detector
        seen = detect_runs(
            renders, detect, (), memo=memo, frames=min(sets.origin.frames, renders.frames), workers=workers,
            progress=_staged(progress, "frames looked at"),
        )  # fmt: skip
    experiments = all_experiments(stored, seen, sets, site)
    write_experiments(out, experiments, stored, sets, site=site, shipped=shipped)
    return Reproduction(site, stored.frames, stored.vehicles, experiments, out / PAGE)


def check_paper_site(site: str) -> None:
    """Raises ValueError for a site that the paper has no figures of."""
    if site not in PAPER_SITES:
        raise ValueError(f"the paper has figures of {' and '.join(PAPER_SITES)}, none of {site!r}: take one of these")


@contextmanager
def test_recording(
    site: str, out: Path, frames: int, *, workers: int, progress: StageProgress | None
) -> Iterator[CoopDataset]:
    """The test recording, simulated where it is not there yet."""
    path = out / f"recording_{frames}.hdf5"
    tell = None if progress is None else partial(_simulated, progress, frames)
    try:
        simulate_dataset(
            load_site(site), frames=frames, seed=SEEDS[site], out=path, workers=workers, progress=tell,
            fleet=fleet_named("catalogue"),
        )  # fmt: skip
    except FileExistsError:
        raise FileExistsError(
            f"{path} is not the test recording, or damaged: remove it, or give another --out"
        ) from None
    with CoopDataset(path) as recording:
        yield recording


def all_experiments(
    stored: StoredDetections, seen: StoredDetections, table: Table, site: str
) -> tuple[Experiment, ...]:
    """Every experiment, in the paper's order. seen: the frames of the table, without runs."""
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


def write_experiments(
    out: Path,
    experiments: tuple[Experiment, ...],
    stored: StoredDetections,
    table: Table,
    *,
    site: str,
    shipped: bool,
) -> None:
    """CSV and SVG of each experiment, all figures as JSON, and the page: all of them, or where that fails none."""
    conditions = _conditions(stored, table, site)
    with writing_together(out) as folder:
        pictures = {}
        for each in experiments:
            each.draw(folder / f"{each.name}.svg")
            pictures[each.name] = (folder / f"{each.name}.svg").read_bytes()
            write_text(folder / f"{each.name}.csv", each.csv)
            for name, rows in each.curves:
                write_text(folder / f"{name}.csv", as_csv(list(rows)))
        figures = {"site": site, "conditions": conditions, "experiments": [each.as_dict() for each in experiments]}
        write_text(folder / FIGURES, json.dumps(finite(figures), indent=1, allow_nan=False))
        causes = CAUSES if shipped else CAUSES | {"!": GIVEN}
        title = f"The paper's experiments at the {PLACE_NAMES[site]}, ours beside theirs"
        write_text(folder / PAGE, paper_page(title, experiments, pictures, conditions=conditions, causes=causes))


def _conditions(stored: StoredDetections, table: Table, site: str) -> dict[str, str]:
    origin = table.origin
    return {
        "test recording": f"{stored.frames} frames, seed {SEEDS[site]}, {stored.vehicles} vehicles (no heavy ones) "
        f"centred in the area; the paper's has {TEST_FRAMES} frames",
        "sensors": f"{len(stored.sensors)}, exact poses; noise of {DEPTH_NOISE * 100:g} cm at every depth",
        "detector": f"digest {stored.detector[:12]}",
        "sensor sets": f"exact table of {origin.frames} frames, {origin.objects} vehicles",
        "protocol": "exact (toolkit.detection.metrics): all-point interpolated AP, IoU of volumes, 0.7 unless said",
        "milliseconds": "of the machine and its load at the time of detection; only the order of magnitude compares",
        "coview": coview_version(),
        "made by": f"coview reproduce {site} --frames {stored.frames}",
    }


def _shipped(site: str, recording: CoopDataset) -> Detector:
    from models.detector import load_site_detector

    return load_site_detector(site, recording.site.area)


def _fitting(site: str, recording: CoopDataset, detector: Detector) -> Table | None:
    """The shipped table, if it was measured at this site with this detector."""
    table = load_table(site)
    place = digest_of(recording.site, recording.sensors)
    fits = table.origin.place == place and table.origin.detector == getattr(detector, "digest", None)
    return table if fits else None


def _check_table(table: Table, recording: CoopDataset, detector: Detector) -> None:
    if table.origin.place != digest_of(recording.site, recording.sensors):
        raise ValueError(f"the table is of {table.origin.site!r} with other sensors: make one with coview table")
    if table.origin.detector != getattr(detector, "digest", None):
        raise ValueError("the table was measured with another detector: make one with coview table")


def _made(
    renders: Recorded,
    detector: Detector,
    out: Path,
    frames: int,
    workers: int,
    progress: Callable[[int, int], None] | None,
) -> Table:
    """The table of all sensor sets over these frames, made where it is not there yet."""
    path = out / f"table_{frames}_{getattr(detector, 'digest', '')[:12]}_{renders.digest[:12]}.npz"
    with suppress(ValueError, FileNotFoundError):  # damaged, or not made yet
        return load_table(path)
    return make_table(renders, detector, path, frames=frames, seed=NOISE_SEED, workers=workers, progress=progress)


def _staged(progress: StageProgress | None, stage: str) -> Callable[[int, int], None] | None:
    return None if progress is None else partial(progress, stage)


def _simulated(progress: StageProgress, frames: int, done: int) -> None:
    progress("frames simulated", done, frames)
