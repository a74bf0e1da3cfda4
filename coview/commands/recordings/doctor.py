"""`coview doctor`: check a recording for the classic mistakes."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path

from tyro.conf import Positional

from coview.arguments import check_least, refuse_given
from coview.clouds import first_of, open_clouds
from coview.exits import OK, SUSPECTED
from coview.printing import print_result


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
        dataset: Any recording in the published layout; with --layout, of clouds.
        site: As in coview evaluate.
        reference: As in coview calibrate; sensors that are not where it says are suspected too.
        layout: Of a recording of clouds, as in coview detect.
        frames: With --layout, how many samples from its beginning are looked at.
        json: Print as JSON.
    """
    from toolkit.calibration.poses import check_drift
    from toolkit.datasets.doctor import diagnose
    from toolkit.detection.label_doctor import diagnose_samples
    from toolkit.sites.files import load_site

    check_least("--frames", frames, 1)
    healthy = "nothing suspected"
    if layout is not None:
        refuse_given({"--site": site is not None, "--reference": reference is not None}, "is not for --layout")
        samples = list(first_of(open_clouds(dataset, layout), frames))
        findings = diagnose_samples(samples)
        if not any(len(sample.objects) for sample in samples):
            healthy = f"{len(samples)} samples without a label: there is nothing to be checked"
    else:
        place = load_site(site) if site else None
        findings = diagnose(dataset, place) + (check_drift(dataset, reference, place) if reference else [])
    text = "\n".join(map(str, findings)) or healthy
    print_result([asdict(finding) for finding in findings], text, as_json=json)
    return SUSPECTED if findings else OK
