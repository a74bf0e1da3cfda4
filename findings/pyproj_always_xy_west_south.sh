#!/bin/sh
# pyproj: always_xy=True does not mean "x to the east, y to the north", and a guessed datum has no error.
#
# pyproj 3.7.2 (PROJ 9.5.1), Python 3.11, Linux x86-64, seen on 29 November 2026.
#
# 1. EPSG:2048 (South Africa) counts to the west and to the south. With always_xy=True a place east of its meridian
#    still has a negative first coordinate: the axes keep their order and their directions, as those of 4326 do not.
# 2. "+proj=utm +zone=32 +ellps=bessel" names no datum. Transformer.from_crs makes a transformation to WGS84 without an
#    error or a warning; it takes the ellipsoids for one ("ballpark"), which is 135 m off if DHDN is meant.
#    allow_ballpark=False refuses, and also refuses "+ellps=WGS84", which is exact.
#
# Output seen:
#   1 a place 0.5 degrees east: x = -46247 m
#   2 bessel: Ballpark in its description: True; 135 m from the place with the shift of DHDN
#   3 allow_ballpark=False: bessel refused: True, WGS84 refused: True
# Exits with 1 if any of this is otherwise.
set -eu
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv venv
venv/bin/python -m pip install --quiet pyproj==3.7.2
cat > check.py <<'PYTHON'
import sys

from pyproj import Geod, Transformer
from pyproj.exceptions import ProjError

x, _ = Transformer.from_crs("EPSG:4326", "EPSG:2048", always_xy=True).transform(19.5, -33.9)
print(f"1 a place 0.5 degrees east: x = {x:.0f} m")
bare = "+proj=utm +zone=32 +ellps=bessel"
guess = Transformer.from_crs(bare, "EPSG:4326", always_xy=True)
shift = "+towgs84=598.1,73.7,418.2,0.202,0.045,-2.455,6.7"
known = Transformer.from_crs(f"{bare} {shift}", "EPSG:4326", always_xy=True)
place = 500000, 5400000
_, _, apart = Geod(ellps="WGS84").inv(*guess.transform(*place), *known.transform(*place))
is_ballpark = "Ballpark" in guess.description
print(f"2 bessel: Ballpark in its description: {is_ballpark}; {apart:.0f} m from the place with the shift of DHDN")


def is_refused(definition):
    try:
        Transformer.from_crs(definition, "EPSG:4326", allow_ballpark=False)
    except ProjError:
        return True
    return False


refused = [is_refused(bare), is_refused("+proj=utm +zone=32 +ellps=WGS84")]
print(f"3 allow_ballpark=False: bessel refused: {refused[0]}, WGS84 refused: {refused[1]}")
sys.exit(not (x < 0 and is_ballpark and 100 < apart < 160 and all(refused)))
PYTHON
venv/bin/python check.py
