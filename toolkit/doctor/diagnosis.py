"""Diagnosis of a recording: everything that the doctor suspects."""

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from toolkit.datasets import problem_kinds
from toolkit.datasets.layouts.hdf5 import holds_clouds
from toolkit.datasets.recording_views import Part
from toolkit.datasets.recordings import guess_layout, open_recording
from toolkit.datasets.stored_site import UnknownSite
from toolkit.doctor.box_fits import GroundView
from toolkit.doctor.buried_points import suspect_buried_points
from toolkit.doctor.cloud_times import diagnose_times
from toolkit.doctor.findings import Finding
from toolkit.doctor.frame_times import suspect_times
from toolkit.doctor.labels import diagnose_boxes
from toolkit.doctor.sensors import diagnose_sensors
from toolkit.doctor.stored_file import diagnose_file
from toolkit.frame import AWAY, Frame
from toolkit.sites.site import Site

_CHECK_UNIT = "check their unit, metres are read"
_REMEDIES = {  # remedy by the words for a problem that no sound recording has
    problem_kinds.STRAY: "name clouds and labels alike, times in the same unit",
    problem_kinds.NOT_FINITE: "restore them, or remove them",
    problem_kinds.NO_SIZE: _CHECK_UNIT,
    problem_kinds.TOO_LARGE: _CHECK_UNIT,
    AWAY: "check their unit, and the frame they are in",
    problem_kinds.TILTED: "check the order of quaternions, w first or last, and of angles",
    problem_kinds.EMPTY: "check their sensor, or leave these frames out",
    problem_kinds.FAR_POINTS: _CHECK_UNIT,
}


@dataclass(frozen=True)
class Diagnosis:
    """Findings of the doctor in a recording.

    Attributes:
        findings: suspected mistakes, none for a healthy recording.
        healthy: words to show if there are no findings."""

    findings: list[Finding]
    healthy: str = "nothing suspected"


def diagnose(
    path: str | Path, layout: str | None = None, *, site: Site | None = None, frames: int = 20
) -> Diagnosis:
    """Check a recording for the classic mistakes.

    Files of images are checked as they are stored (`toolkit.doctor.stored_file`). Labels of clouds
    are checked by the fit of their boxes to the points of the first frames.

    Args:
        path: file or folder of the recording.
        layout: name of its layout, guessed from the path if None.
        site: site of the recording, None if the recording names it or shows a built-in one.
        frames: number of first frames to check.

    Raises whatever opening a recording of clouds raises."""
    if (layout or guess_layout(path)) == "hdf5":
        try:
            has_clouds = Path(path).is_file() and holds_clouds(path)
        except (OSError, ValueError):
            has_clouds = False  # `diagnose_file` names the damage
        if not has_clouds:
            file_findings = diagnose_file(path, site)
            return Diagnosis(file_findings or diagnose_images(path, site, frames))
    samples = list(Part(open_recording(path, layout, site=site), frames))
    time_findings = diagnose_times(samples)
    findings = [*find_impossible(samples), *time_findings]
    views = [GroundView.from_frame(sample) for sample in samples]
    if not any(len(sample.objects) for sample in samples):
        return Diagnosis(
            findings=[*findings, *suspect_buried_points(views)],
            healthy=f"{len(samples)} frames without a label: there is nothing to be checked",
        )
    label_findings = diagnose_boxes(views)
    # wrong labels cannot show faults of sensors
    sensor_findings = (
        [] if label_findings else diagnose_sensors(views, has_sound_times=not time_findings)
    )
    return Diagnosis([*findings, *label_findings, *sensor_findings])


def diagnose_images(path: str | Path, site: Site | None, frames: int) -> list[Finding]:
    """Return faults of the sensors in a file of images, compared with each other.

    site: site of the file, None if it names its site or shows a built-in one; for an unknown site,
    nothing is compared. frames: number of first frames to check."""
    try:
        recording = open_recording(path, "hdf5", site=site)
    except UnknownSite:  # points are compared with boxes in the site's frame
        return []
    samples = list(Part(recording, frames))
    return diagnose_sensors(
        [GroundView.from_frame(sample) for sample in samples],
        has_sound_times=not diagnose_times(samples),
    )


def find_impossible(samples: Sequence[Frame]) -> Iterator[Finding]:
    """Find labels and clouds with impossible values, and times that cannot follow each other.

    samples: consecutive frames, with the problems that reading them counted."""
    # numbers of labels or clouds with each problem, by words for the problem
    problems = sum((Counter(sample.problems) for sample in samples), Counter[str]())  # 0 by default
    label_count = sum(len(sample.objects) for sample in samples)
    if all(len(sample.objects) for sample in samples):
        # labels of other frames are no fault: they are the whole recording's, and only a part of
        # the clouds is here
        problems.pop(problem_kinds.STRAY, None)
    for kind, remedy in _REMEDIES.items():
        if problems[kind]:
            subject = "labels"
            context = f"beside {label_count} labels that are read"
            if kind in (problem_kinds.EMPTY, problem_kinds.FAR_POINTS):
                subject = "clouds"
                context = f"in {len(samples)} frames"
            yield Finding(
                severity="error",
                where=subject,
                suspected=kind,
                evidence=f"{problems[kind]}, {context}",
                remedy=remedy,
            )
    yield from suspect_times(np.array([sample.time for sample in samples]))
