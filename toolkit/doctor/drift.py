"""Sensors that have drifted from their believed poses."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from toolkit.calibration.found_pose import FoundPose
from toolkit.calibration.poses import find_poses
from toolkit.calibration.reference_surface import read_surface
from toolkit.datasets.dataset import CoopDataset
from toolkit.doctor.findings import Finding
from toolkit.sites.site import Site


def check_drift(path: str | Path, reference: str | Path, site: Site | None = None) -> list[Finding]:
    """Compare the poses of a recording's sensors with a reference.

    Args:
        path: file of the recording.
        reference: name of a site, or file of standing surfaces (see `read_surface`).
        site: site of the recording, None if its file names it or shows a built-in one.

    Returns a warning for each sensor that disagrees, or one for a recording whose poses cannot be
    found. Raises ValueError and OSError if the reference cannot be read."""
    surface = read_surface(reference)
    try:
        with CoopDataset(path, site) as recording:
            return drift_findings(find_poses(recording, surface), str(reference))
    except (ValueError, OSError) as error:
        return [
            Finding(
                severity="warning",
                where=str(path),
                suspected="its sensors' poses cannot be checked",
                evidence=str(error),
                remedy="check them by hand",
            )
        ]


def drift_findings(found_poses: Sequence[FoundPose], reference: str) -> list[Finding]:
    """Return warnings of sensors that clearly drifted, or for which no pose was found.

    reference: words for what the poses were found by."""
    findings = []
    for found_pose in found_poses:
        where = f"sensor {found_pose.sensor.name}"
        turn_error, move_error = found_pose.deviation  # standard deviations (rad, m)
        if found_pose.registration is None:
            suspected = f"its pose cannot be checked against {reference}"
            findings.append(
                Finding(
                    severity="warning",
                    where=where,
                    suspected=suspected,
                    evidence=found_pose.refusal,
                    remedy="check by hand",
                )
            )
        elif found_pose.has_drifted:
            change = (
                f"turned by {np.rad2deg(found_pose.turn):.2f}° and moved by "
                f"{found_pose.distance * 100:.1f} cm"
            )
            within = f"to within {np.rad2deg(turn_error):.2f}° and {move_error * 100:.1f} cm"
            findings.append(
                Finding(
                    severity="warning",
                    where=where,
                    suspected="it hangs crooked or has drifted",
                    evidence=f"{change} against {reference}, {within}",
                    remedy="write its pose by coview calibrate",
                )
            )
    return findings
