#!/bin/sh
# v2xflexstack cannot read GeoNetworking packets of roadside units: it has 12 for them where the standard has 15.
#
# v2xflexstack 0.11.2. Bits 1 to 5 of a GeoNetworking address are the type of the station (ETSI EN 302 636-4-1), with the numbers of
# StationType: 11 is a tram, 15 a roadside unit. Wireshark 4.0 shows 15 as "Road Side Unit", vanetza has RSU = 15. v2xflexstack has
# ROAD_SIDE_UNIT = 12:
# - a packet of a roadside unit is refused: "ValueError: 15 is not a valid ST";
# - a station that it makes a roadside unit sends 12, which others do not know.
set -eu
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check v2xflexstack==0.11.2
"$folder/venv/bin/python" - <<'PYTHON'
from flexstack.geonet.gn_address import ST, GNAddress

MAC = bytes.fromhex("020000000001")


def address(station_type):
    """GeoNetworking address of a station: not set by hand, type, ten reserved bits, MAC."""
    return (station_type << 10).to_bytes(2, "big") + MAC


tram = GNAddress.decode(address(11))
print("11:", tram.st)
assert tram.st is ST.TRAM
try:
    GNAddress.decode(address(15))
except ValueError as error:
    print("15:", error)
    assert str(error) == "15 is not a valid ST"
else:
    raise AssertionError("a roadside unit can be read")
print("roadside unit:", ST.ROAD_SIDE_UNIT.value)
assert ST.ROAD_SIDE_UNIT.value == 12
PYTHON
