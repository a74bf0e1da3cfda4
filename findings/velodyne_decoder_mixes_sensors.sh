#!/bin/sh
# velodyne-decoder looks at no address: two lidars in one capture become one sensor, whose sweeps hold the points of both.
#
# velodyne-decoder 3.1.0 (NumPy 2.4.6, dpkt 1.9.8). At a junction every lidar sends to the same port (2368) of one recorder, so a
# capture of the network holds the packets of several sensors, told apart by the address of the sender. Two VLP-16 here: one stands in
# a round room of 10 m, the other in one of 20 m.
# - read_pcap of the capture of both: every sweep has points at 10 m and at 20 m, in one coordinate system, without a word;
# - of a capture of one sensor: all points at 10 m.
# There is no option for an address; who wants one sensor writes a capture of its packets first.
set -eu
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check velodyne-decoder==3.1.0 numpy==2.4.6 dpkt==1.9.8
"$folder/venv/bin/python" - "$folder" <<'PYTHON'
import inspect
import struct
import sys
from pathlib import Path

import numpy as np
import velodyne_decoder

FOLDER = Path(sys.argv[1])
START_S = 1_700_000_000


def packet(metres, azimuth, microseconds):
    """Data packet of a VLP-16, 1206 bytes: 12 blocks that look round from an azimuth (0.01 degrees)."""
    blocks = b""
    for block in range(12):
        blocks += struct.pack("<HH", 0xEEFF, (azimuth + 40 * block) % 36000)
        blocks += struct.pack("<HB", round(metres / 0.002), 50) * 32
    # time past the hour; factory bytes: strongest return, VLP-16
    return blocks + struct.pack("<IBB", microseconds, 0x37, 0x22)


def frame(payload, sender):
    """Ethernet frame of a UDP packet from 192.168.1.SENDER to port 2368."""
    udp = struct.pack(">HHHH", 2368, 2368, 8 + len(payload), 0) + payload
    header = struct.pack(">BBHHHBBH", 0x45, 0, 20 + len(udp), 0, 0, 64, 17, 0)
    return bytes(12) + b"\x08\x00" + header + bytes([192, 168, 1, sender, 255, 255, 255, 255]) + udp


def capture(name, sensors):
    """pcap of three turns at 10 Hz of sensors, given as address and distance (m)."""
    records = struct.pack("<IHHiIII", 0xA1B2C3D4, 2, 4, 0, 0, 65535, 1)
    for number in range(3 * 75):
        microseconds = round(number * 1e5 / 75)
        for sender, metres in sensors:
            payload = packet(metres, number * 480 % 36000, microseconds)
            data = frame(payload, sender)
            records += struct.pack("<IIII", START_S + microseconds // 10**6, microseconds % 10**6, len(data), len(data)) + data
    path = FOLDER / name
    path.write_bytes(records)
    return path


def distances(path):
    """Whole metres at which the points of each sweep are."""
    sweeps = []
    for _, points in velodyne_decoder.read_pcap(str(path), velodyne_decoder.Config(model=velodyne_decoder.Model.VLP16)):
        cloud = np.asarray(points)[:, :3]
        sweeps.append(sorted(set(np.linalg.norm(cloud, axis=1).round().astype(int).tolist())))
    return sweeps


alone = distances(capture("alone.pcap", [(201, 10.0)]))
both = distances(capture("both.pcap", [(201, 10.0), (202, 20.0)]))
parameters = sorted(inspect.signature(velodyne_decoder.read_pcap).parameters)
print("one sensor: ", alone)
print("two sensors:", both)
print("parameters: ", parameters)
assert alone and all(found == [10] for found in alone)
assert any(found == [10, 20] for found in both)
assert not any("ip" in name or "addr" in name for name in parameters)
PYTHON
