"""Collective Perception Messages of one instant (TS 103 324 V2.1.1), each within one packet.

An instant whose road users do not fit one message becomes up to eight. Each is complete, has the
same reference time and the number of road users of the instant; the first has the sensors."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

from toolkit.exchange.geonetworking import BTP_HEADER_BYTES, PACKET_BYTES, RoadsideStation
from toolkit.exchange.perceived_objects import ItsValue

MAX_CPM_BYTES = PACKET_BYTES - BTP_HEADER_BYTES
MAX_OBJECTS = 255  # in one instant, which fit the segments
MAX_SEGMENTS = 8
_MAX_MESSAGE_OBJECTS = 50  # that fit a message without velocities and ages
CPM_TYPE = "CollectivePerceptionMessage"
_PROTOCOL_VERSION = 2
_CPM_ID = 14
_RSU_CONTAINER = 2
_SENSOR_CONTAINER = 3
_OBJECT_CONTAINER = 5
_UNDEFINED_SENSOR = 0
_UNKNOWN_SEMI_AXIS = 4095
_UNKNOWN_HEADING = 3601
_UNKNOWN_ALTITUDE = 800_001


@dataclass(frozen=True)
class CpmContent:
    """Content of a message.

    Attributes:
        its_ms: Reference time, as `count_its_ms` returns it.
        objects: Road users, as `describe_objects` returns them.
        object_count: Number of road users of the instant.
        sensor_ids: Number of each sensor, 0 to 255; empty to leave the sensors out.
        segment: Number of the message from 1, and how many there are; None for the only one.
    """

    its_ms: int
    objects: Sequence[ItsValue]
    object_count: int
    sensor_ids: Sequence[int] = ()
    segment: tuple[int, int] | None = None

    def split(self, count: int) -> "list[CpmContent]":
        """Return the content of `count` messages, with about as many road users each."""
        total = len(self.objects)
        bounds = [total * k // count for k in range(count + 1)]
        segments = []
        for k in range(count):
            segment = replace(
                self,
                objects=self.objects[bounds[k] : bounds[k + 1]],
                sensor_ids=() if k else self.sensor_ids,
                segment=(k + 1, count),
            )
            segments.append(segment)
        return segments


class CpmEncoder:
    """Encoder of a station's messages.

    Args:
        specification: Compiled modules, as `compile_cpm_modules` returns them.
        station: Sender.
        checks_ranges: True to refuse numbers that the modules have no room for, which otherwise
            become other numbers. It takes three times as long.
    """

    def __init__(
        self, specification: Any, station: RoadsideStation, *, checks_ranges: bool = False
    ) -> None:
        """Encode the container that never changes.

        Raises ValueError for values that the modules refuse."""
        self._specification = specification
        self._station = station
        self._checks_ranges = checks_ranges
        self._rsu_container = self._wrap(_RSU_CONTAINER, "OriginatingRsuContainer", {})

    def encode_segments(self, content: CpmContent) -> list[bytes]:
        """Return the messages of an instant, each of at most `MAX_CPM_BYTES`.

        Raises ValueError for values that the modules refuse, and for road users that do not fit
        `MAX_SEGMENTS`."""
        least_count = max(1, -(-len(content.objects) // _MAX_MESSAGE_OBJECTS))
        for count in range(least_count, MAX_SEGMENTS + 1):
            segments = content.split(count) if count > 1 else [content]
            messages = [self.encode(segment) for segment in segments]
            if all(len(message) <= MAX_CPM_BYTES for message in messages):
                return messages
        raise ValueError(
            f"{len(content.objects)} road users do not fit {MAX_SEGMENTS} messages of "
            f"{MAX_CPM_BYTES} bytes: give fewer"
        )

    def encode(self, content: CpmContent) -> bytes:
        """Return a message of any length. Raises ValueError for values that its standard refuses.

        Keys are the names that the ASN.1 modules of the standard give."""
        containers = [self._rsu_container]
        if content.sensor_ids:
            sensors = [
                {"sensorId": number, "sensorType": _UNDEFINED_SENSOR, "shadowingApplies": True}
                for number in content.sensor_ids
            ]
            containers.append(self._wrap(_SENSOR_CONTAINER, "SensorInformationContainer", sensors))
        perceived = {
            "numberOfPerceivedObjects": content.object_count,
            "perceivedObjects": list(content.objects),
        }
        containers.append(self._wrap(_OBJECT_CONTAINER, "PerceivedObjectContainer", perceived))
        management: ItsValue = {
            "referenceTime": content.its_ms,
            "referencePosition": describe_position(self._station),
        }
        if content.segment is not None:
            number, count = content.segment
            management["segmentationInfo"] = {"totalMsgNo": count, "thisMsgNo": number}
        header = {
            "protocolVersion": _PROTOCOL_VERSION,
            "messageId": _CPM_ID,
            "stationId": self._station.number,
        }
        payload = {"managementContainer": management, "cpmContainers": containers}
        return self._encode_type(CPM_TYPE, {"header": header, "payload": payload})

    def _wrap(self, container_id: int, type_name: str, content: Any) -> ItsValue:
        """Return an encoded container with its number."""
        return {"containerId": container_id, "containerData": self._encode_type(type_name, content)}

    def _encode_type(self, type_name: str, content: Any) -> bytes:
        """Return a value of a type of the modules. Raises ValueError if they refuse it."""
        import asn1tools

        try:
            encoded: bytes = self._specification.encode(
                type_name, content, check_constraints=self._checks_ranges
            )
        except (asn1tools.EncodeError, asn1tools.ConstraintsError, LookupError) as error:
            reason = " ".join(str(error).split())
            raise ValueError(
                f"the ASN.1 modules do not fit TS 103 324 V2.1.1: {type_name}: {reason}"
            ) from None
        return encoded


def describe_position(station: RoadsideStation) -> ItsValue:
    """Return a station's place as ReferencePosition, with unknown accuracy and altitude."""
    return {
        "latitude": station.latitude,
        "longitude": station.longitude,
        "positionConfidenceEllipse": {
            "semiMajorConfidence": _UNKNOWN_SEMI_AXIS,
            "semiMinorConfidence": _UNKNOWN_SEMI_AXIS,
            "semiMajorOrientation": _UNKNOWN_HEADING,
        },
        "altitude": {"altitudeValue": _UNKNOWN_ALTITUDE, "altitudeConfidence": "unavailable"},
    }
