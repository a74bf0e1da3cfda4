"""What the doctor says of sensors that are not where their recording says they are."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from toolkit.calibration.reference import read_surface
from toolkit.calibration.sensor_poses import FoundPose, find_poses
from toolkit.datasets.dataset import CoopDataset
from toolkit.datasets.doctor.checks import Finding
from toolkit.sites.site import Site


def check_drift(path: str | Path, reference: str | Path, site: Site | None = None) -> list[Finding]:
    """A warning for each sensor of a recording that is not where the reference says, see `read_surface`; one warning
    where the recording cannot be read or is too short. Raises ValueError and OSError where the reference is none."""
    surface = read_surface(reference)
    try:
        with CoopDataset(path, site) as recording:
            return drift_findings(find_poses(recording, surface, noise_seed=None), str(reference))
    except (ValueError, OSError) as error:
        return [Finding("warning", str(path), "its sensors' poses cannot be checked", str(error), "check them by hand")]


def drift_findings(found: Sequence[FoundPose], reference: str) -> list[Finding]:
    """A warning for each sensor that has clearly drifted, and for each that the reference says nothing of."""
    return [_finding(each, reference) for each in found if each.drifted or each.registration is None]


def _finding(found: FoundPose, reference: str) -> Finding:
    where = f"sensor {found.sensor.name}"
    if found.registration is None:
        return Finding(
            "warning", where, f"its pose cannot be checked against {reference}", found.refusal, "check by hand"
        )
    turn, move = np.split(np.sqrt(np.diag(found.registration.covariance)), 2)
    evidence = (
        f"turned by {np.rad2deg(found.turn):.2f}° and moved by {found.distance * 100:.1f} cm against {reference}, "
        f"to within {np.rad2deg(np.linalg.norm(turn)):.2f}° and {np.linalg.norm(move) * 100:.1f} cm"
    )
    return Finding("warning", where, "it hangs crooked, or has drifted", evidence, "write its pose by coview calibrate")
