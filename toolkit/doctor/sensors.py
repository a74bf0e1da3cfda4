"""Faults of a recording's sensors, compared with each other."""

from collections.abc import Sequence

from toolkit.doctor.box_fits import GroundView
from toolkit.doctor.buried_points import suspect_buried_points
from toolkit.doctor.findings import Finding
from toolkit.doctor.late_sensors import suspect_late_sensors
from toolkit.doctor.missed_boxes import suspect_missed_boxes


def diagnose_sensors(views: Sequence[GroundView], *, has_sound_times: bool) -> list[Finding]:
    """Return faults of sensors: late clouds, missed boxes, points below the ground.

    views: consecutive frames with their ground, and labels without mistakes; has_sound_times: True
    if `diagnose_times` found nothing, since only then a late sensor can be recognised."""
    late_findings = [*suspect_late_sensors(views)] if has_sound_times else []
    return [*late_findings, *suspect_missed_boxes(views), *suspect_buried_points(views)]
