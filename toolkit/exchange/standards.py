"""Table of the writers by name, and the function that opens one."""

import warnings
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from pathlib import Path

from toolkit.exchange.geo_origin import GeoOrigin
from toolkit.exchange.instant import Instant
from toolkit.exchange.standard import Standard
from toolkit.exchange.writer import OrderedWriter
from toolkit.runtime.writing import writing, writing_folder

_ROOM = "toolkit.exchange"
STANDARDS = {
    standard.name: standard
    for standard in (
        Standard(
            "kitti-tracking",
            f"{_ROOM}.kitti_tracking:KittiTrackingWriter",
            ".txt",
            needs_time=False,
        ),
        Standard(
            "openlabel", f"{_ROOM}.openlabel_tracks:OpenLabelWriter", ".json", needs_time=False
        ),
        Standard(
            "mf-json", f"{_ROOM}.moving_features:MovingFeaturesWriter", ".json", needs_place=True
        ),
        Standard(
            "mcap",
            f"{_ROOM}.foxglove_scenes:FoxgloveWriter",
            ".mcap",
            packages=(("mcap", "mcap"), ("foxglove_schemas_protobuf", "foxglove-schemas-protobuf")),
            takes_clouds=True,
        ),
        Standard(
            "detection3d",
            f"{_ROOM}.detection_arrays:DetectionArrayWriter",
            "",
            packages=(("rosbags", "rosbags"),),
        ),
        Standard(
            "osi",
            f"{_ROOM}.osi_ground_truth:OsiWriter",
            ".mcap",
            packages=(("betterosi", "betterosi"),),
        ),
        Standard(
            "cpm",
            f"{_ROOM}.collective_perception:CollectivePerceptionWriter",
            ".pcap",
            packages=(("asn1tools", "asn1tools"),),
            needs_place=True,
            needs_asn1=True,
            takes_clouds=True,
            extra="cpm",
        ),
    )
}


def find_standard(name: str) -> Standard:
    """Return a standard by name. Raises ValueError for an unknown one."""
    standard = STANDARDS.get(name)
    if standard is None:
        raise ValueError(f"there is no writer {name!r}: choose among {', '.join(STANDARDS)}")
    return standard


@contextmanager
def open_writer(
    name: str, path: str | Path, *, origin: GeoOrigin | None = None, asn1: Path | None = None
) -> Iterator[OrderedWriter]:
    """Give the block a writer of detections or tracks; the file is complete at the end.

    If the block raises or the process is killed, nothing appears at `path`, and what was there
    stays. name: a name of `STANDARDS`; origin: place on earth of the world frame, for formats that
    need it; asn1: folder of the ASN.1 modules for cpm. Raises ValueError for an unknown name, a
    missing place and wrong modules, ImportError for a missing package, OSError as
    `toolkit.runtime.writing.writing`.

    >>> import tempfile
    >>> import numpy as np
    >>> from toolkit.exchange.instant import Instant
    >>> box = np.array([[10, 0, 1, 4, 2, 1.5, 0]])
    >>> car = Instant(0.1, box, np.array(["vehicle"]), np.array([0.9]), ids=np.array([7]))
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     with open_writer("kitti-tracking", f"{folder}/tracks.txt") as writer:
    ...         writer.write(car)
    ...     print(Path(folder, "tracks.txt").read_text().split()[:3])
    ['0', '7', 'Car']
    """
    standard = find_standard(name)
    standard.check_packages()
    target = writing(path) if standard.ending else writing_folder(path)
    with target as unfinished:
        writer = OrderedWriter(
            standard.make(unfinished, origin, asn1), name, needs_time=standard.needs_time
        )
        try:
            yield writer
        finally:
            writer.close()


@contextmanager
def open_writers(
    files: Mapping[str, Path], *, origin: GeoOrigin | None = None, asn1: Path | None = None
) -> Iterator[Callable[[Instant], None]]:
    """Give the block a function that writes an instant in several formats.

    The files are complete at the end; values that a format cannot hold become warnings. files: file
    of each standard by its name; origin: place on earth of the world frame, for formats that need
    it; asn1: folder of the ASN.1 modules for cpm. Raises the errors of `open_writer`."""
    with ExitStack() as stack:
        writers: dict[str, OrderedWriter] = {}
        for name, path in files.items():
            writers[name] = stack.enter_context(open_writer(name, path, origin=origin, asn1=asn1))

        def write(instant: Instant) -> None:
            """Write an instant in each format."""
            for writer in writers.values():
                writer.write(instant)

        yield write
        for name, writer in writers.items():
            for kind, count in writer.problems.items():
                # the place of the caller's `with`, behind contextlib
                warnings.warn(f"{name}: {count} {kind}", stacklevel=3)
