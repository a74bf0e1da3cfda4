"""Captures of Ethernet frames in libpcap's classic format, which Wireshark opens."""

import struct
from pathlib import Path

_HEADER = struct.Struct("<IHHiIII")  # magic, version, time zone, accuracy, longest frame, link
_RECORD = struct.Struct("<IIII")  # seconds, microseconds, bytes kept, bytes sent
_MICROSECOND_MAGIC = 0xA1B2C3D4
_MAX_FRAME_BYTES = 65_535
_ETHERNET_LINK = 1
_NS_PER_S = 10**9
_NS_PER_US = 1000


class CaptureFile:
    """Capture that is written frame by frame.

    path: the file; its ending is .pcap."""

    def __init__(self, path: Path) -> None:
        """Open the file and write its header."""
        self._file = path.open("wb")
        self._file.write(
            _HEADER.pack(_MICROSECOND_MAGIC, 2, 4, 0, 0, _MAX_FRAME_BYTES, _ETHERNET_LINK)
        )

    def add(self, time_ns: int, frame: bytes) -> None:
        """Add a frame.

        time_ns: nanoseconds since 1970. Raises ValueError for a time after 2106, which the
        format has no numbers for."""
        seconds, rest_ns = divmod(time_ns, _NS_PER_S)
        if seconds >= 2**32:
            raise ValueError(
                f"times in a capture must be before 2106, got {seconds} s since 1970: mend the "
                "times"
            )
        size = len(frame)
        self._file.write(_RECORD.pack(seconds, rest_ns // _NS_PER_US, size, size) + frame)

    def close(self) -> None:
        """Complete the file."""
        self._file.close()
