"""Packets of Ouster lidars in a capture, decoded by ouster-sdk (1.0 and later).

- The sensor's metadata is NAME.json, or NAME_0.json and on for several, next to NAME.pcap, as
  ouster-cli writes them; it says how packets are laid out and where beams point.
- Points are `XYZLut`'s, in the sensor's frame in metres, of pixels that have a range in columns
  that are valid. Rows stay staggered, which only matters for images.
- Intensity is SIGNAL (photons), or REFLECTIVITY if the profile has no signal; ring is the row.
- Of two returns the first is read. A frame with less than 97 of 100 columns of its window is part
  of a turn."""

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from toolkit.datasets.layouts.packet_sweeps import Sweep
from toolkit.datasets.record_values import name_damage

MIN_COLUMN_SHARE = 0.97  # share of a whole turn's columns that must be there
_NS_PER_S = 10**9


@dataclass(frozen=True, eq=False)
class OusterCapture:
    """Capture of one or several Ouster lidars.

    path: the file; serials: serial number of each sensor."""

    path: Path
    serials: tuple[int, ...]

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the sensors: ouster for one, with their serial numbers for several."""
        if len(self.serials) == 1:
            return ("ouster",)
        return tuple(f"ouster-{serial}" for serial in self.serials)

    def decode(self) -> Iterator[Sweep]:
        """Yield the sweeps of all sensors, in order of the capture."""
        from ouster.sdk import core, open_source

        # sweeps so far, by the sensor's name
        counts: Counter[str] = Counter()
        names = dict(zip(self.serials, self.names, strict=True))
        tables: dict[int, Any] = {}  # directions of a sensor's pixels, by its serial number
        with name_damage(self.path, "capture", (Exception,)):
            for frames in open_source(str(self.path)):
                for frame in frames:
                    if frame is None:  # this sensor has none here
                        continue
                    serial = int(frame.sensor_info.sn)
                    if serial not in tables:
                        tables[serial] = core.XYZLut(frame.sensor_info)
                    name = names[serial]
                    counts[name] += 1
                    yield convert_frame(frame, tables[serial](frame), name, counts[name] - 1)


def find_metadata(path: Path) -> list[Path]:
    """List the files of metadata next to a capture."""
    return sorted(
        [*path.parent.glob(f"{path.stem}.json"), *path.parent.glob(f"{path.stem}_*.json")]
    )


def open_ousters(path: Path) -> OusterCapture:
    """Open a capture of Ouster lidars, whose metadata is next to it.

    Raises ImportError without ouster-sdk, ValueError for a damaged capture or metadata of another
    sensor."""
    import_ouster("reading an Ouster's .pcap")  # raises, with the remedy, if it is missing
    from ouster.sdk import open_source

    with name_damage(path, "capture", (Exception,)):
        source = open_source(str(path))
        serials = tuple(int(info.sn) for info in source.sensor_info)
        if len(set(serials)) < len(serials):
            raise ValueError(f"two sensors have one serial number, {serials}: mend their metadata")
    return OusterCapture(path, serials)


def import_ouster(use: str) -> Any:
    """Import `ouster.sdk.core`; use: what needs it, named in the ImportError if it is missing."""
    try:
        from ouster.sdk import core
    except ImportError:
        raise ImportError(
            f"{use} needs ouster-sdk, which pins other packages than coview: "
            "pip install --no-deps ouster-sdk more-itertools prettytable"
        ) from None
    return core


def convert_frame(frame: Any, points: np.ndarray, name: str, number: int) -> Sweep:
    """Convert a LidarFrame of ouster-sdk to a sweep.

    points: (rows, columns, 3) m, of every pixel; name: name of the sensor; number: place of the
    sweep among the sensor's, from 0. Second returns of a pixel are left out and counted."""
    ranges = np.asarray(frame.field("RANGE"))  # 0 for no return
    is_valid = np.asarray(frame.status) & 1 == 1  # columns that arrived
    is_return = (ranges > 0) & is_valid
    rows, columns = np.nonzero(is_return)
    intensity = frame.field("SIGNAL" if "SIGNAL" in frame.fields else "REFLECTIVITY")
    column_ns = np.asarray(frame.timestamp).astype(np.int64)
    start_ns = int(column_ns[is_valid].min()) if is_valid.any() else 0
    left_out = 0
    if "RANGE2" in frame.fields:
        left_out = int(np.count_nonzero(np.asarray(frame.field("RANGE2"))[:, is_valid]))
    first, last = frame.sensor_info.format.column_window
    width = (last - first) % len(is_valid) + 1  # columns of the window, which may pass column 0
    return Sweep(
        sensor=name,
        number=number,
        time_s=frame.get_first_valid_packet_timestamp() / _NS_PER_S,
        columns={
            "positions": points[rows, columns],
            "intensity": np.asarray(intensity)[rows, columns],
            "ring": rows,
            "time_s": (column_ns[columns] - start_ns) / _NS_PER_S,
        },
        is_partial=bool(is_valid.sum() < MIN_COLUMN_SHARE * width),
        left_out=left_out,
    )
