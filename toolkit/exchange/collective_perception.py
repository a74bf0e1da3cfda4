"""Collective Perception Messages of ETSI (TS 103 324 V2.1.1) as a capture for Wireshark.

- A frame is a GeoNetworking single-hop broadcast to BTP port 2009, stamped with the instant's time;
  the message is in UPER by ASN.1 modules that the user names (`toolkit.exchange.cpm_modules`).
- The station is a roadside unit of number 1 at the world's 0 0 0, to 0.1 microdegree; its altitude
  is unknown. Coordinates are metres east, north and up from there.
- The reference time is the instant's, to the millisecond. Times of a clock that begins with the
  recording count from 2004.
- An instant without road users has a message, too. Of more than 255, the surest are sent.
- If an instant has clouds, their sensors are numbered in order of their appearance and sent once in
  a second."""

from dataclasses import replace
from pathlib import Path

import numpy as np

from toolkit.arrays import Int64
from toolkit.datasets.problem_kinds import Problems, add_problem
from toolkit.exchange.capture_file import CaptureFile
from toolkit.exchange.cpm_modules import compile_cpm_modules
from toolkit.exchange.cpm_segments import MAX_OBJECTS, MAX_SEGMENTS, CpmContent, CpmEncoder
from toolkit.exchange.geo_origin import GeoOrigin
from toolkit.exchange.geonetworking import RoadsideStation, wrap_message
from toolkit.exchange.instant import Instant
from toolkit.exchange.its_clock import ITS_EPOCH_S, count_its_ms
from toolkit.exchange.message_numbers import encode_degrees
from toolkit.exchange.object_numbers import ObjectNumbers
from toolkit.exchange.perceived_objects import describe_objects
from toolkit.exchange.writer import nanoseconds
from toolkit.objects import LABELS
from toolkit.runtime.reading import name_errors

CPM_PORT = 2009
STATION_NUMBER = 1
SENSORS_EVERY_MS = 1000
MAX_SENSORS = 128
TOO_MANY = "road users beyond 255 of one instant, the least sure left out"
OTHER_NUMBERS = "road users with ids over 65535, sent with other numbers"
BEFORE_2004 = "instants before 2004, counted from there"


class CollectivePerceptionWriter:
    """Writer of one capture."""

    def __init__(self, path: Path, origin: GeoOrigin, asn1: Path) -> None:
        """Compile the modules and open the capture.

        origin: place of the world's 0 0 0; asn1: folder of the modules. Raises OSError and
        ValueError for modules that are missing or of another kind."""
        self.problems: Problems = {}
        self._station = make_station(origin)
        self._encoder = open_cpm_encoder(asn1, self._station)
        self._turn = origin.turn
        self._numbers = ObjectNumbers()
        self._sensor_names: dict[str, None] = {}  # in order of appearance
        self._sensors_due_ms = 0
        self._capture = CaptureFile(path)

    def write(self, instant: Instant) -> None:
        """Write the messages of an instant.

        What the messages cannot hold, such as more than `MAX_OBJECTS` objects, is left out and
        counted among the problems."""
        time_ns = nanoseconds(instant.time_s)
        # ms since the epoch of ITS, 2004
        its_ms = count_its_ms(instant.time_s)
        add_problem(self.problems, BEFORE_2004, int(instant.time_s < ITS_EPOCH_S))
        add_problem(self.problems, TOO_MANY, max(len(instant) - MAX_OBJECTS, 0))
        instant = keep_surest(instant, MAX_OBJECTS)
        ids = instant.list_ids()
        # what messages call the tracks, of fewer bits
        numbers = self._numbers.assign(ids)
        add_problem(self.problems, OTHER_NUMBERS, int(np.not_equal(ids, numbers).sum()))
        content = CpmContent(
            its_ms=its_ms,
            objects=describe_objects(instant, numbers, self._turn, self.problems),
            object_count=len(instant),
            sensor_ids=self._list_sensors(instant, its_ms),
        )
        for message in self._encoder.encode_segments(content):
            frame = wrap_message(message, CPM_PORT, self._station, its_ms)
            self._capture.add(time_ns, frame)

    def close(self) -> None:
        """Complete the capture."""
        self._capture.close()

    def _list_sensors(self, instant: Instant, its_ms: int) -> list[int]:
        """List the numbers of the sensors that are known so far, none if they are not due."""
        self._sensor_names |= dict.fromkeys(cloud.name for cloud in instant.clouds)
        if not self._sensor_names or its_ms < self._sensors_due_ms:
            return []
        self._sensors_due_ms = its_ms + SENSORS_EVERY_MS
        return list(range(min(len(self._sensor_names), MAX_SENSORS)))


def open_cpm_encoder(asn1: Path, station: RoadsideStation) -> CpmEncoder:
    """Return the encoder of a station's messages, whose modules were tried on extreme road users.

    asn1: folder of the ASN.1 modules. Raises OSError and ValueError for modules that are missing,
    do not compile or are of another message."""
    specification = compile_cpm_modules(asn1)
    count = len(LABELS)
    for sign in (-1.0, 1.0):
        extremes = Instant(
            ITS_EPOCH_S,
            np.tile([sign * 1e5, sign * 1e5, sign * 1e5, 1e-3, 30.0, 30.0, 6.28], (count, 1)),
            np.arange(count),
            np.full(count, sign),
            velocities=np.full((count, 3), 1e3 * sign),
            ages=np.full(count, 1.0 + sign),
        )
        content = CpmContent(
            its_ms=0,
            objects=describe_objects(extremes, [0, 1, 2, 65_535], turn=0.0, problems={}),
            object_count=MAX_OBJECTS,
            sensor_ids=(0,),
            segment=(1, MAX_SEGMENTS),
        )
        with name_errors(asn1):
            # raises if the modules do not fit
            CpmEncoder(specification, station, checks_ranges=True).encode(content)
    return CpmEncoder(specification, station)


def check_cpm_modules(asn1: Path) -> None:
    """Raise the errors of `open_cpm_encoder`. asn1: folder of the ASN.1 modules."""
    open_cpm_encoder(asn1, RoadsideStation(number=STATION_NUMBER, latitude=0, longitude=0))


def make_station(origin: GeoOrigin) -> RoadsideStation:
    """Return the station at a place on earth."""
    longitude = encode_degrees(origin.longitude_deg)
    if longitude == encode_degrees(-180.0):  # which must not be used
        longitude = encode_degrees(180.0)
    return RoadsideStation(
        number=STATION_NUMBER, latitude=encode_degrees(origin.latitude_deg), longitude=longitude
    )


def keep_surest(instant: Instant, count: int) -> Instant:
    """Return an instant with only the `count` road users of the highest scores, in their order."""
    if len(instant) <= count:
        return instant
    rows: Int64[np.ndarray, " n"] = np.sort(np.argsort(-instant.scores, kind="stable")[:count])
    return replace(
        instant,
        boxes=instant.boxes[rows],
        labels=instant.labels[rows],
        scores=instant.scores[rows],
        ids=None if instant.ids is None else instant.ids[rows],
        velocities=None if instant.velocities is None else instant.velocities[rows],
        ages=None if instant.ages is None else instant.ages[rows],
    )
