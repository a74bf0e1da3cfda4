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
    """Warn of each sensor that disagrees with the reference (see `read_surface`), or of a recording
    without poses. Raises ValueError and OSError if the reference cannot be read."""
    surface = read_surface(reference)
    try:
        with CoopDataset(path, site) as recording:
            return drift_findings(find_poses(recording, surface), str(reference))
    except (ValueError, OSError) as error:
        return [
            Finding(
                "warning",
                str(path),
                "its sensors' poses cannot be checked",
                str(error),
                "check them by hand",
            )
        ]


def drift_findings(found_poses: Sequence[FoundPose], reference: str) -> list[Finding]:
    """Warn of sensors that clearly drifted or have no pose."""
    findings = []
    for found_pose in found_poses:
        subject, (turn, move) = f"sensor {found_pose.sensor.name}", found_pose.deviation
        if found_pose.registration is None:
            suspected = f"its pose cannot be checked against {reference}"
            findings.append(
                Finding("warning", subject, suspected, found_pose.refusal, "check by hand")
            )
        elif found_pose.has_drifted:
            off = (
                f"turned by {np.rad2deg(found_pose.turn):.2f}° and moved by "
                f"{found_pose.distance * 100:.1f} cm"
            )
            within = f"to within {np.rad2deg(turn):.2f}° and {move * 100:.1f} cm"
            evidence = f"{off} against {reference}, {within}"
            suspicion = (
                "it hangs crooked or has drifted",
                evidence,
                "write its pose by coview calibrate",
            )
            findings.append(Finding("warning", subject, *suspicion))
    return findings
