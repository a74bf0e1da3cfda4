"""A UDP port of this computer at which one lidar's packets arrive."""

import socket
import time
import warnings
from collections.abc import Collection, Iterator
from dataclasses import dataclass
from threading import Event

_POLL_S = 0.2  # a silent port looks for the end of the run this often
_BUFFER_BYTES = 1 << 22  # of the system, for packets that wait: a second of a large lidar
_MAX_DATAGRAM_BYTES = 1 << 16


@dataclass(frozen=True)
class PacketPort:
    """UDP port of this computer to which a lidar sends.

    Attributes:
        number: UDP port.
        address: Address of the lidar, None to take packets from anywhere.
        host: Address of this computer at which to listen, "" for all.
    """

    number: int
    address: str | None = None
    host: str = ""

    def receive(
        self, packet_bytes: int, stop: Event, *, ignored_bytes: Collection[int] = ()
    ) -> Iterator[tuple[float, bytes]]:
        """Yield time of arrival (s, this computer's clock) and data of the lidar's packets.

        Packets of another size are passed over, with a warning for each size.

        Args:
            packet_bytes: Size of a packet.
            stop: Ends the iteration when it is set.
            ignored_bytes: Sizes of other packets of the lidar, passed over without a warning.

        Raises:
            OSError: The port is taken, or not this user's to open.
        """
        known_sizes = {packet_bytes, *ignored_bytes}
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as port:
            port.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, _BUFFER_BYTES)
            port.bind((self.host, self.number))
            port.settimeout(_POLL_S)
            while not stop.is_set():
                try:
                    data, (sender, _) = port.recvfrom(_MAX_DATAGRAM_BYTES)
                except TimeoutError:
                    continue
                if self.address not in (None, sender):
                    continue
                if len(data) == packet_bytes:
                    yield time.time(), data
                elif len(data) not in known_sizes:
                    known_sizes.add(len(data))
                    warnings.warn(
                        f"port {self.number} gets packets of {len(data)} bytes from {sender}, "
                        f"where the lidar's have {packet_bytes}: they are passed over",
                        stacklevel=2,
                    )
