"""Load of sensors' messages on shared links.

Capacities of links are nominal and shared by all senders, so that a share well below 1 is needed.
802.11p: the default rate in a channel of 10 MHz (IEEE 802.11-2020, clause 17). LTE-V2X: a transport
block of 7992 bits each ms, that is 50 resource blocks of 10 MHz, QPSK (3GPP TS 36.213, table
7.1.7.2.1-1, index 9). Ethernet: a cable (100BASE-TX). Packets and their airtime are defined in
`toolkit.detection.link.packets`."""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from toolkit.arrays import Int64
from toolkit.detection.link.packets import count_packets, find_airtime_us
from toolkit.runtime.text_tables import align_columns

CAPACITIES_MBIT_PER_S = {"802.11p": 6.0, "LTE-V2X": 8.0, "Ethernet": 100.0}


@dataclass(frozen=True)
class LinkLoad:
    """Load of some sensors on a shared link.

    Attributes:
        rate: messages per second of each sensor (Hz).
        mbit_per_s: mean load of all sensors together (Mbit/s).
        packets: mean number of packets per message.
        one_packet: share (0 to 1) of messages that fit one packet.
        packets_per_s: packets of all sensors together in a second.
        airtime_ms_per_s: time (ms) of a second that these packets occupy a channel of 802.11p.
        shares: load divided by the link's capacity, by name in `CAPACITIES_MBIT_PER_S`; above 1 for
            an overloaded link.
    """

    rate: float
    mbit_per_s: float
    packets: float
    one_packet: float
    packets_per_s: float
    airtime_ms_per_s: float
    shares: dict[str, float]


@dataclass(frozen=True)
class SetLoad:
    """Load of one scheme and sensor set on a shared link.

    scheme: name of the scheme; sensors: indices of the sensors."""

    scheme: str
    sensors: tuple[int, ...]
    load: LinkLoad

    def as_dict(self) -> dict[str, object]:
        """Return scheme, sensors and the fields of the load as one flat dict for JSON."""
        return {"scheme": self.scheme, "sensors": self.sensors, **vars(self.load)}


def link_load(bits: Int64[np.ndarray, "frames sensors"], rate: float) -> LinkLoad:
    """Load of sensors that each send a message in every frame.

    bits: bits of each message; rate: frames per second (Hz). Raises ValueError for a rate that is
    not above 0 and finite, and without messages."""
    if not 0 < rate < np.inf:
        raise ValueError(f"rate must be above 0 Hz, got {rate:g}: such as 10")
    if not bits.size:
        raise ValueError(
            f"there must be a message on a link, got {bits.shape[0]} frames of {bits.shape[1]} "
            "sensors"
        )
    packets = count_packets(bits)
    airtime_us = find_airtime_us(bits)
    mbit = float(bits.sum(axis=1).mean()) * rate / 1e6  # in a second, from all sensors
    return LinkLoad(
        rate=float(rate),
        mbit_per_s=mbit,
        packets=float(packets.mean()),
        one_packet=float((packets <= 1).mean()),
        packets_per_s=float(packets.sum(axis=1).mean()) * rate,
        airtime_ms_per_s=float(airtime_us.sum(axis=1).mean()) * rate / 1000,
        shares={name: mbit / capacity for name, capacity in CAPACITIES_MBIT_PER_S.items()},
    )


def format_loads(loads: Iterable[SetLoad]) -> str:
    """Format the load of each scheme and sensor set as a table, one line each."""
    headings = [
        "scheme",
        "sensors",
        "Mbit/s",
        "packets/message",
        "in one packet",
        "packets/s",
        "airtime ms/s",
    ]
    # last, the share of each kind of link
    table = [[*headings, *CAPACITIES_MBIT_PER_S]]
    for set_load in loads:
        load = set_load.load
        names = [set_load.scheme, ",".join(map(str, set_load.sensors)) or "none"]
        shares = [f"{100 * load.shares[link]:.2f} %" for link in CAPACITIES_MBIT_PER_S]
        figures = [
            f"{load.mbit_per_s:.3f}",
            f"{load.packets:.2f}",
            f"{load.one_packet:.3f}",
            f"{load.packets_per_s:.1f}",
            f"{load.airtime_ms_per_s:.1f}",
        ]
        table.append([*names, *figures, *shares])
    return align_columns(table, texts=2)  # the first two columns are texts, the rest numbers
