"""Detections of a recording in the formats of other programs (`toolkit.exchange`)."""

from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path

from toolkit.detection.detect import FrameDetections
from toolkit.exchange.geo_origin import GeoOrigin
from toolkit.exchange.instant import Instant
from toolkit.exchange.standards import find_standard, open_writers


def export_detections(
    results: Iterable[FrameDetections],
    files: Mapping[str, Path],
    *,
    origin: GeoOrigin | None = None,
    asn1: Path | None = None,
) -> Iterator[FrameDetections]:
    """Write detections as they arrive, and yield each after it was taken up.

    files: file of each standard by its name; complete at the end; origin, asn1: as in
    `toolkit.exchange.standards.open_writer`, whose errors are raised. Warns of values that a format
    cannot hold."""
    takes_clouds = any(find_standard(name).takes_clouds for name in files)
    with open_writers(files, origin=origin, asn1=asn1) as write:
        for result in results:
            frame = result.frame
            clouds = frame.clouds if takes_clouds else ()
            write(Instant.from_detections(frame.time, result.detections, clouds))
            yield result
