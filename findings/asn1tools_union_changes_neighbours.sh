#!/bin/sh
# asn1tools takes the first part of a union of integers for all of it: the next ones change the member before them.
#
# asn1tools 0.169.0, unaligned PER. INTEGER (0 | 5..11 | 14) is encoded as 0..14, in four bits (X.691: the effective constraint of a
# union reaches from its lowest to its highest value). asn1tools has 0..0 and no bits; the value is added to those before it, without an
# error. Its issue 193 has the empty output of such an integer that stands alone; next to others it is worse:
# - {number: 1, kind: 5} of SEQUENCE { number INTEGER (0..255), kind INTEGER (0 | 5..11 | 14) } is read as {number: 5, kind: 0};
# - with INTEGER (0..14) in its place, both numbers come back.
# With check_constraints=True the sound value is refused ("Expected an integer between 0 and 0").
# ETSI's data dictionary has such a union for the class of a vehicle in a Collective Perception Message.
set -eu
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check asn1tools==0.169.0 bitstruct==8.24.0 pyparsing==3.3.3
"$folder/venv/bin/python" - <<'PYTHON'
import asn1tools

MODULE = """
Streets DEFINITIONS AUTOMATIC TAGS ::= BEGIN
Union ::= SEQUENCE { number INTEGER (0..255), kind INTEGER (0 | 5..11 | 14) }
Range ::= SEQUENCE { number INTEGER (0..255), kind INTEGER (0..14) }
END
"""

streets = asn1tools.compile_string(MODULE, "uper")
value = {"number": 1, "kind": 5}
found = {}
for name in ("Union", "Range"):
    encoded = streets.encode(name, value)
    found[name] = streets.decode(name, encoded)
    print(name, encoded.hex(), found[name])
assert found == {"Union": {"number": 5, "kind": 0}, "Range": value}
try:
    streets.encode("Union", value, check_constraints=True)
except asn1tools.ConstraintsError as error:
    print(error)
else:
    raise AssertionError("the union is checked rightly")
PYTHON
