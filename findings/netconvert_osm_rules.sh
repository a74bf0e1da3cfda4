#!/bin/sh
# SUMO's netconvert on valid OpenStreetMap XML: rules of the road that it does not read, without a word.
#
# eclipse-sumo 1.28.0 (wheel), Python 3.11, Linux x86-64, seen on 29 November 2026.
# A secondary road crosses a residential street; the street's tags, or the place on earth, say what may drive and where.
#
# 1. motor_vehicle=no on the street: cars may still drive on it (access=no is read, motor_vehicle is not).
# 2. access=no on the street, and nothing more: buses and bicycles may still drive on it.
# 3. Both roads in London: traffic keeps right, as there is no rule by place; only the option --lefthand makes it keep left.
# netconvert warns of none of them.
#
# Output seen:
#   1 motor_vehicle=no: cars drive there: True, buses: True
#   2 access=no: cars drive there: False, buses: True, bicycles: True
#   3 London: lefthand in the network: False
# Exits with 1 if any of this is otherwise.
set -eu
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv venv
venv/bin/python -m pip install --quiet eclipse-sumo==1.28.0
cat > check.py <<'PYTHON'
import os
import subprocess
import sys
from pathlib import Path
from xml.etree import ElementTree

import sumo

STEPS = {1: (0, 0), 2: (-0.003, 0), 3: (0.003, 0), 4: (0, 0.0018), 5: (0, -0.0018)}


def convert(tag, longitude=8.0, latitude=49.5):
    """Users of the street's lanes; whether traffic keeps left; warnings about roads."""
    nodes = "".join(
        f'<node id="{k}" lat="{latitude + north}" lon="{longitude + east}"/>' for k, (east, north) in STEPS.items()
    )
    key, value = tag
    ways = '<way id="1"><nd ref="2"/><nd ref="1"/><nd ref="3"/><tag k="highway" v="secondary"/></way>'
    ways += '<way id="2"><nd ref="4"/><nd ref="1"/><nd ref="5"/><tag k="highway" v="residential"/>'
    ways += f'<tag k="{key}" v="{value}"/></way>'
    Path("map.osm").write_text(f'<osm version="0.6">{nodes}{ways}</osm>')
    run = subprocess.run(
        [Path(sumo.SUMO_HOME, "bin", "netconvert"), "--osm-files=map.osm", "--output-file=net.xml"],
        capture_output=True, text=True, check=True, env={**os.environ, "SUMO_HOME": sumo.SUMO_HOME},
    )
    root = ElementTree.parse("net.xml").getroot()
    users = set()
    for edge in root.iter("edge"):
        if edge.get("type") == "highway.residential":
            for lane in edge.iter("lane"):
                allowed = lane.get("allow")
                forbidden = (lane.get("disallow") or "").split()
                all_users = {"passenger", "bus", "bicycle"} - set(forbidden)
                users |= set(allowed.split()) if allowed else all_users
    warned = [line for line in run.stderr.splitlines() if "restriction" in line or "access" in line]
    return users, root.get("lefthand") == "true", warned


closed, _, warned = convert(("motor_vehicle", "no"))
print(f"1 motor_vehicle=no: cars drive there: {'passenger' in closed}, buses: {'bus' in closed}")
nobody, _, more = convert(("access", "no"))
print(f"2 access=no: cars drive there: {'passenger' in nobody}, buses: {'bus' in nobody}, ", end="")
print(f"bicycles: {'bicycle' in nobody}")
_, is_left, other = convert(("lit", "yes"), -0.1276, 51.5072)
print(f"3 London: lefthand in the network: {is_left}")
as_seen = {"passenger", "bus"} <= closed and {"bus", "bicycle"} <= nobody and "passenger" not in nobody
sys.exit(not (as_seen and not is_left and not warned + more + other))
PYTHON
venv/bin/python check.py
