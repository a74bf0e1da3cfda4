#!/bin/sh
# SUMO's netconvert on valid OpenDRIVE: what it does not read, it drops without a word.
#
# eclipse-sumo 1.28.0 (wheel), Python 3.11, Linux x86-64, seen on 29 November 2026.
# One straight road along +x, lanes 1 and -1 of type driving, 3.5 m wide; all four files are valid OpenDRIVE 1.6.
#
# 1. rule="LHT": lane -1, to the right of the reference line, must carry traffic towards -x. netconvert makes it run
#    towards +x, as without the attribute; no warning.
# 2. <type><speed max="30" unit="km/h"/>: the limit of both lanes stays the 13.89 m/s (50 km/h) of netconvert's default;
#    no warning. (A <speed> of a lane is read.)
# 3. laneSection singleSide="true": the other side, which goes on, loses its lanes from there; no warning.
# 4. <left> with lane 1 before lane 2 (the standard says "should", not "shall", of the order): the two lanes are exchanged.
#    A sidewalk as lane 2, the outer one, becomes the lane next to the middle; no warning.
#
# Output seen:
#   1 lane at y = -1.75 runs towards +x
#   2 limits 13.89 13.89
#   3 lanes to the left at x = 50: 0
#   4 sidewalk at y = 1.00
# Exits with 1 if any of this is otherwise.
set -eu
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv venv
venv/bin/python -m pip install --quiet eclipse-sumo==1.28.0
cat > check.py <<'PYTHON'
import subprocess
import sys
from pathlib import Path
from xml.etree import ElementTree

LANE = '<lane id="{}" type="{}" level="false"><width sOffset="0" a="{}" b="0" c="0" d="0"/></lane>'
SECTION = '<laneSection s="{}" {}>{}<center><lane id="0" type="none" level="false"/></center>{}</laneSection>'
CARS = LANE.format(1, "driving", 3.5), LANE.format(-1, "driving", 3.5)


def convert(lanes, rule="RHT", kind=""):
    """Lanes of the network: type, limit, points; and what netconvert warns of."""
    plan = '<planView><geometry s="0" x="-150" y="0" hdg="0" length="300"><line/></geometry></planView>'
    road = f'<road name="" length="300" id="1" junction="-1" rule="{rule}">{kind}{plan}<lanes>{lanes}</lanes></road>'
    Path("in.xodr").write_text(f'<OpenDRIVE><header revMajor="1" revMinor="6"/>{road}</OpenDRIVE>')
    command = ["venv/bin/netconvert", "--opendrive-files=in.xodr", "--offset.disable-normalization", "-o", "net.xml"]
    done = subprocess.run([*command, "--opendrive.import-all-lanes"], capture_output=True, text=True, check=True)
    if "Warning" in done.stderr:
        print("it warns:", done.stderr)
    found = []
    for lane in ElementTree.parse("net.xml").getroot().iterfind("edge[@from]/lane"):
        points = [tuple(map(float, point.split(",")[:2])) for point in lane.get("shape").split()]
        found.append((lane.get("type", ""), float(lane.get("speed")), points))
    return found


def section(left, right, s=0, attributes=""):
    sides = (f"<left>{left}</left>" if left else "", f"<right>{right}</right>")
    return SECTION.format(s, attributes, *sides)


right = [points for _, _, points in convert(section(*CARS), rule="LHT") if abs(points[0][1] + 1.75) < 0.1]
towards = "+x" if right[0][-1][0] > right[0][0][0] else "-x"
print(f"1 lane at y = -1.75 runs towards {towards}")

limit = '<type s="0" type="town"><speed max="30" unit="km/h"/></type>'
limits = [speed for _, speed, _ in convert(section(*CARS), kind=limit)]
print("2 limits", *limits)

one = convert(section(*CARS) + section("", CARS[1], s=150, attributes='singleSide="true"'))
beyond = sum(points[0][1] > 0 and max(x for x, _ in points) > 50 for _, _, points in one)
print(f"3 lanes to the left at x = 50: {beyond}")

walk = convert(section(LANE.format(1, "driving", 3.5) + LANE.format(2, "sidewalk", 2.0), CARS[1]))
place = next(points[0][1] for kind, _, points in walk if kind == "sidewalk")
print(f"4 sidewalk at y = {place:.2f}")

seen = towards == "+x" and set(limits) == {13.89} and beyond == 0 and abs(place - 1.0) < 0.01
sys.exit(not seen)
PYTHON
venv/bin/python check.py
