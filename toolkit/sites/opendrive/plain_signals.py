"""Traffic lights and signs of priority for netconvert."""

from collections.abc import Iterator
from xml.etree import ElementTree

from toolkit.sites.network import format_element
from toolkit.sites.opendrive.plain_names import SAFE_NAME, WHOLE_NUMBER, is_number

# types of signals that are traffic lights, in OpenDRIVE's list
TRAFFIC_LIGHTS = (
    "1000001",
    "1000002",
    "1000003",
    "1000004",
    "1000005",
    "1000006",
    "1000007",
    "1000009",
    "1000010",
    "1000011",
    "1000012",
    "1000013",
    "1000020",
)
PRIORITY_SIGNS = ("205", "301", "306")  # German signs that netconvert reads


def write_plain_signals(road: ElementTree.Element, sign: int) -> Iterator[str]:
    """Yield the texts of a <road>'s traffic lights, signs of priority and references to signals.

    netconvert ignores all other signs. sign: -1 if netconvert mirrors the map, as traffic keeps
    left, so that ids of lanes get the opposite sign; else 1."""
    for signal in road.findall("signals/signal"):
        kind = signal.get("type", "")
        is_read = kind in TRAFFIC_LIGHTS or kind in PRIORITY_SIGNS
        if is_read and _is_placed(signal):
            row = {
                "id": signal.get("id", ""),
                "s": signal.get("s", ""),
                "type": kind,
                "orientation": signal.get("orientation", "none"),
                "dynamic": "no" if signal.get("dynamic") == "no" else "yes",
            }
            yield format_element("signal", row, "".join(_write_validity(signal, sign)))
    for reference in road.findall("signals/signalReference"):
        if _is_placed(reference):
            row = {
                "id": reference.get("id", ""),
                "s": reference.get("s", ""),
                "orientation": reference.get("orientation", "none"),
            }
            validity = "".join(_write_validity(reference, sign))
            yield format_element("signalReference", row, validity)


def _is_placed(signal: ElementTree.Element) -> bool:
    """True for a signal with a name that SUMO can hold, and a place along the road."""
    return bool(SAFE_NAME.fullmatch(signal.get("id", ""))) and is_number(signal.get("s", ""))


def _write_validity(signal: ElementTree.Element, sign: int) -> Iterator[str]:
    """Yield the texts of the lanes for which a signal holds. sign: factor of their ids."""
    for validity in signal.findall("validity"):
        ends = [validity.get("fromLane", ""), validity.get("toLane", "")]
        if all(WHOLE_NUMBER.fullmatch(end) for end in ends):
            first, last = sorted(sign * int(end) for end in ends)
            yield format_element("validity", {"fromLane": first, "toLane": last})
