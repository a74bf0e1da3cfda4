"""`coview doctor`: check a recording for the classic mistakes."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path

from tyro.conf import Positional

from coview.exits import OK, SUSPECTED
from coview.printing import print_result


def doctor(
    dataset: Positional[Path], /, *, site: str | None = None, reference: str | None = None, json: bool = False
) -> int:
    """Check a recording for the classic mistakes and say which are suspected and why. Exit code 1 if any is.

    Example: coview doctor my-recording.hdf5

    Args:
        dataset: Any recording in the published layout.
        site: As in coview evaluate.
        reference: As in coview calibrate; sensors that are not where it says are suspected too.
        json: Print as JSON.
    """
    from toolkit.calibration.drift import check_drift
    from toolkit.datasets.doctor.diagnosis import diagnose
    from toolkit.sites.files import load_site

    place = load_site(site) if site else None
    findings = diagnose(dataset, place) + (check_drift(dataset, reference, place) if reference else [])
    text = "\n".join(map(str, findings)) or "nothing suspected"
    print_result([asdict(finding) for finding in findings], text, as_json=json)
    return SUSPECTED if findings else OK
