#!/bin/sh
# kognic-openlabel refuses the fractions of a second that OpenLABEL's schema allows in a frame's timestamp.
#
# kognic-openlabel 2.2.0 (pydantic 2.14.4), openlabel-checker 0.1.0, which brings the schema of ASAM OpenLABEL 1.0.0. It says of
# frame_properties.timestamp: a text or a number. A lidar's time in seconds, 1700000000.25, is such a number:
# - the schema takes a file with it;
# - OpenLabelAnnotation of kognic_openlabel raises a ValidationError: "Input should be a valid integer, got a number with a fractional
#   part";
# - the same time as text, or in whole seconds, is read.
# So a file that passes the standard's own schema is refused by the library, and a writer that wants to be read by both writes text.
set -eu
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check kognic-openlabel==2.2.0 pydantic==2.14.4 openlabel-checker==0.1.0
"$folder/venv/bin/python" - <<'PYTHON'
import json
from pathlib import Path

import jsonschema
import openlabel_checker
from kognic.openlabel.models import OpenLabelAnnotation
from pydantic import ValidationError

SCHEMA = Path(openlabel_checker.__file__).parent / "schema_data" / "openlabel_json_schema-v1.0.0.json"


def read(timestamp):
    """How a file with one frame at a time is taken, once the standard's schema has taken it."""
    frames = {"0": {"frame_properties": {"timestamp": timestamp}}}
    content = {"openlabel": {"metadata": {"schema_version": "1.0.0"}, "frames": frames}}
    jsonschema.validate(content, json.loads(SCHEMA.read_text()))
    try:
        OpenLabelAnnotation.model_validate(content)
    except ValidationError as error:
        return error.errors()[0]["msg"]
    return "read"


for timestamp in (1700000000.25, 1700000000, "1700000000.25"):
    print(repr(timestamp), read(timestamp))
assert "fractional part" in read(1700000000.25)
assert read(1700000000) == read("1700000000.25") == "read"
PYTHON
