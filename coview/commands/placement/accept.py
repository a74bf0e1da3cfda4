"""`coview accept`: compare a built street with its plan."""

import json
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from tyro.conf import Positional

from coview.detector_spec import DetectorSpec
from coview.detectors import check_detector, open_detector
from coview.outputs import OK, SUSPECTED, Writing, check_folder, claim, print_result
from coview.progress_bar import progress_bar
from coview.recordings import Opening, frame_count
from toolkit.sensors.error_profiles import find_profile

if TYPE_CHECKING:
    from placement_env.acceptance.acceptance import Acceptance
    from placement_env.report.planning.plan_folder import PlanFolder, StatedResults
    from toolkit.doctor.findings import Finding
    from toolkit.frame import Recording

PLAN_FILE = "plan.json"
SITE = "site.json"
ACCEPTANCE_FILES = ("acceptance.json", "acceptance.html", "acceptance.txt")


@dataclass(frozen=True, kw_only=True)
class Checking:
    """Use of the recording."""

    detector: str | None = None
    """Detector, as in coview evaluate; the plan's when left out."""
    reference: str | None = None
    """Site, survey cloud or recording by which poses are found, as in coview calibrate; the planned
    site when left out."""
    frames: int | None = None
    """Number of first frames to use; all when left out."""
    errors: str = "paper"
    """Error profile of simulated sensors, as in coview evaluate."""
    seed: int = 0
    """Seed of the sensors' noise and errors."""


def accept_command(
    recording: Positional[Path],
    /,
    *,
    plan: Path,
    out: Path = Path("out/acceptance"),
    checking: Checking = Checking(),
    opening: Opening = Opening(),
    writing: Writing = Writing(),
) -> int:
    """Compare a built street with its plan: poses, returns, range and noise of each sensor, and AP,
    recall and HOTA of each class. Exit code 1 if the street does not keep the promise.

    Without labels, two halves of the sensors are compared with each other instead. Sensors in the
    recording must have the names of the plan.

    Example: coview accept monday.hdf5 --plan out/plan

    Example: coview accept junction.bag --plan out/plan --layout rosbag --reference survey.ply

    Args:
        recording: Recording of the street in any layout, of 7 minutes or more to compare AP.
        plan: Folder of the plan.
        out: Folder for acceptance.json, acceptance.html and acceptance.txt."""
    from placement_env.acceptance.page import describe_acceptance
    from placement_env.report.planning.plan_folder import read_plan_folder, read_stated_results
    from toolkit.doctor.diagnosis import diagnose
    from toolkit.runtime.text_values import replace_infinite

    find_profile(checking.errors)  # raises for an unknown name, before any work
    planned = read_plan_folder(plan)
    stated = read_stated_results(plan)
    spec = DetectorSpec.from_name(checking.detector or stated.detector)
    check_detector(spec)
    promise = _Promised(planned, stated, spec)
    inputs = [recording, plan / PLAN_FILE, plan / SITE, *opening.files]
    main_file, *other_files = ACCEPTANCE_FILES
    check = partial(check_folder, out, holds=main_file, inputs=inputs, writes=other_files)
    settings = (recording, plan, checking, opening)
    with (
        _name_site(opening, recording, plan).open(recording) as opened,
        claim(out, settings, check, overwrite=writing.overwrite),
    ):
        frames = frame_count(opened, checking.frames)
        if not frames:
            raise ValueError("there is no frame in the recording: check the path and the layout")
        with progress_bar("frame", frames, hidden=writing.json) as bar:
            faults = diagnose(recording, opening.layout, site=planned.setting.place).findings
            acceptance = _accept(
                opened,
                promised=promise,
                checking=checking,
                findings=faults,
                frames=frames,
                progress=bar.to,
            )
        _write(acceptance, out, plan, recording)
    text = describe_acceptance(acceptance)
    figures = replace_infinite(acceptance.as_dict())
    print_result(figures, f"{text}\nwritten to {out}", as_json=writing.json)
    return SUSPECTED if acceptance.faults else OK


class _Promised(NamedTuple):
    """Plan as it was read, and the detector by which the street is judged.

    Attributes:
        planned: setting and site of the plan.
        stated: results that the plan states for each class.
        spec: name of the detector, the plan's unless another was asked for."""

    planned: "PlanFolder"
    stated: "StatedResults"
    spec: DetectorSpec


def _accept(
    opened: "Recording",
    promised: _Promised,
    checking: Checking,
    findings: "list[Finding]",
    frames: int,
    progress: Callable[[int], None],
) -> "Acceptance":
    """Compare an open recording with a plan.

    Poses are found by the planned site, unless `checking` names another reference.

    Args:
        opened: Open recording.
        promised: The plan.
        checking: Options of the command.
        findings: Faults that the doctor found in the recording.
        frames: Number of first frames to use.
        progress: Called with the number of frames done.

    Raises the errors of `accept_street` and of an unusable reference or detector."""
    from placement_env.acceptance.acceptance import Promise, accept_street
    from placement_env.acceptance.street_detections import PlannedDetection
    from toolkit.calibration.reference_surface import read_surface, site_surface
    from toolkit.datasets.recording_views import ReadRecording, Reads

    setting = promised.planned.setting
    site = setting.place
    surface = site_surface(site)
    if checking.reference is not None:
        surface = read_surface(checking.reference)
    recall = _combine_recall(promised.planned, promised.stated)
    detector = open_detector(promised.spec, site)
    return accept_street(
        recording=ReadRecording(opened, Reads(checking.errors, checking.seed)),
        promise=Promise(site, promised.stated.classes, recall),
        planned=PlannedDetection(site, detector, scheme=setting.fusion, codec=setting.codec),
        surface=surface,
        frames=frames,
        findings=findings,
        progress=progress,
    )


def _write(acceptance: "Acceptance", out: Path, plan: Path, recording: Path) -> None:
    """Write `ACCEPTANCE_FILES` into a folder, all or none.

    plan, recording: paths that the page names."""
    from placement_env.acceptance.page import build_page, describe_acceptance
    from placement_env.report.pages.typesetting import to_html
    from toolkit.runtime.text_values import replace_infinite
    from toolkit.runtime.writing import write_text, writing_together

    figures = json.dumps(replace_infinite(acceptance.as_dict()), indent=1)
    page = to_html(build_page(acceptance, str(plan), recording.name), scene=None)
    texts = (f"{figures}\n", page, f"{describe_acceptance(acceptance)}\n")
    with writing_together(out) as folder:
        for name, text in zip(ACCEPTANCE_FILES, texts, strict=True):
            write_text(folder / name, text)


def _name_site(opening: Opening, recording: Path, plan: Path) -> Opening:
    """Return the options with the planned site, for an HDF5 file, which may not state its own.

    opening: options by which the recording is opened; plan: folder of the plan."""
    from toolkit.datasets.recordings import guess_layout

    layout = opening.layout or guess_layout(recording)
    if layout != "hdf5" or opening.site is not None:
        return opening
    return replace(opening, site=str(plan / SITE))


def _combine_recall(planned: "PlanFolder", stated: "StatedResults") -> float:
    """Return the recall that a plan promises, combined over the classes that count.

    Classes without a result in the plan are left out; NaN if all are, which nothing falls short
    of."""
    import numpy as np

    counted = planned.setting.counted
    recall_by_class = {result.label: result.judged.recall for result in stated.classes}
    recalls = [recall_by_class.get(name, np.nan) for name in counted.names]
    return float(counted.combined(np.array([recalls]))[0])
