"""Detections of a recording in the formats of other programs (`toolkit.exchange`)."""

import warnings
from collections.abc import Iterable, Iterator, Mapping
from contextlib import ExitStack
from pathlib import Path

from toolkit.detection.detect import FrameDetections
from toolkit.exchange.geo_origin import GeoOrigin
from toolkit.exchange.instant import Instant
from toolkit.exchange.standards import find_standard, open_writer


def export_detections(
    results: Iterable[FrameDetections], files: Mapping[str, Path], origin: GeoOrigin | None = None
) -> Iterator[FrameDetections]:
    """Write detections as they arrive, and yield each after it was taken up.

    files: file of each standard by its name; complete at the end; origin: place on earth of the
    world frame, for formats in degrees. Warns of values that a format cannot hold. Raises the
    errors of `toolkit.exchange.standards.open_writer`."""
    takes_clouds = any(find_standard(name).takes_clouds for name in files)
    with ExitStack() as stack:
        writers = {
            name: stack.enter_context(open_writer(name, path, origin=origin))
            for name, path in files.items()
        }
        for result in results:
            frame = result.frame
            clouds = frame.clouds if takes_clouds else ()
            instant = Instant.from_detections(frame.time, result.detections, clouds)
            for writer in writers.values():
                writer.write(instant)
            yield result
        for name, writer in writers.items():
            for kind, count in writer.problems.items():
                warnings.warn(f"{name}: {count} {kind}", stacklevel=2)
