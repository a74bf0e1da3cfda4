"""Load of messages on a link: rate, packets, and share of usual capacities.

A packet carries at most 1400 bytes of a message, so that with the headers of IP and UDP it fits an Ethernet frame.
Capacities are nominal and shared by all senders, so that a share well below 1 is needed: of 802.11p the default rate in
a channel of 10 MHz (IEEE 802.11-2020, clause 17), of LTE-V2X a transport block of 7992 bits each ms, that is 50
resource blocks of 10 MHz, QPSK (3GPP TS 36.213, table 7.1.7.2.1-1, index 9), of Ethernet a cable (100BASE-TX).
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from toolkit.arrays import Int64
from toolkit.runtime.text_tables import align_columns

PACKET = 1400  # bytes of a message in a packet
CAPACITIES = {"802.11p": 6.0, "LTE-V2X": 8.0, "Ethernet": 100.0}  # Mbit/s


@dataclass(frozen=True)
class LinkLoad:
    """Load of some sensors on a shared link, each sending at `rate` (Hz). packets: mean number per message; one_packet:
    share of messages that fit one; shares: of each link's capacity, by name.
    """

    rate: float
    mbit_per_s: float
    packets: float
    one_packet: float
    shares: dict[str, float]

    def as_dict(self) -> dict[str, object]:
        """Return plain values for JSON."""
        return dict(vars(self))


@dataclass(frozen=True)
class SetLoad:
    """Load of one scheme and sensor set (indices)."""

    scheme: str
    sensors: tuple[int, ...]
    load: LinkLoad

    def as_dict(self) -> dict[str, object]:
        """Return plain values for JSON."""
        return {"scheme": self.scheme, "sensors": self.sensors, **self.load.as_dict()}


def link_load(bits: Int64[np.ndarray, "frames sensors"], rate: float) -> LinkLoad:
    """Load of all sensors' messages of every frame, at a rate (Hz). Raises ValueError for a rate not above 0 and
    without messages.
    """
    if not 0 < rate < np.inf:
        raise ValueError(f"rate must be above 0 Hz, got {rate:g}: such as 10")
    if not bits.size:
        raise ValueError(f"there must be a message on a link, got {bits.shape[0]} frames of {bits.shape[1]} sensors")
    packets = -(-bits // (8 * PACKET))
    mbit = float(bits.sum(axis=1).mean()) * rate / 1e6
    shares = {name: mbit / capacity for name, capacity in CAPACITIES.items()}
    return LinkLoad(float(rate), mbit, float(packets.mean()), float((packets <= 1).mean()), shares)


def format_loads(loads: Iterable[SetLoad]) -> str:
    """Format the load of schemes and sensor sets. A line for each, a column with the share of each link's capacity."""
    table = [["scheme", "sensors", "Mbit/s", "packets/message", "in one packet", *CAPACITIES]]
    for each in loads:
        load, named = each.load, [each.scheme, ",".join(map(str, each.sensors)) or "none"]
        shares = [f"{100 * load.shares[link]:.2f} %" for link in CAPACITIES]
        table.append([*named, f"{load.mbit_per_s:.3f}", f"{load.packets:.2f}", f"{load.one_packet:.3f}", *shares])
    return align_columns(table, texts=2)
