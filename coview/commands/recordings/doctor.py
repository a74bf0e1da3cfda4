"""`coview doctor`: check a recording for the classic mistakes."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path

from tyro.conf import Positional

from coview.arguments import check_least
from coview.outputs import OK, SUSPECTED, print_result


def doctor(
    dataset: Positional[Path],
    /,
    *,
    site: str | None = None,
    reference: str | None = None,
    layout: str | None = None,
    frames: int = 20,
    json: bool = False,
) -> int:
    """Check a recording for the classic mistakes and say which are suspected and why. Exit code 1 if any is.

    Example: coview doctor my-recording.hdf5

    Example: coview doctor my-log --layout argoverse

    Args:
        dataset: Recording in any layout.
        site: Name or file of the site, for hdf5, as in coview evaluate.
        reference: Reference, as in coview calibrate, against which the sensors' poses are checked too.
        layout: Layout, as in coview evaluate.
        frames: Number of first frames whose labels are checked; of hdf5 all are.
        json: Print as JSON.
    """
    from toolkit.calibration.poses import check_drift
    from toolkit.detection.label_doctor import diagnose
    from toolkit.sites.files import load_site

    check_least("--frames", frames, 1)
    place = load_site(site) if site else None
    diagnosis = diagnose(dataset, layout, site=place, frames=frames)
    findings = diagnosis.findings + (check_drift(dataset, reference, place) if reference else [])
    text = "\n".join(map(str, findings)) or diagnosis.healthy
    print_result([asdict(finding) for finding in findings], text, as_json=json)
    return SUSPECTED if findings else OK
