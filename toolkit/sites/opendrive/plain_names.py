"""Names and numbers of an OpenDRIVE map that SUMO can hold."""

import re

import numpy as np

SAFE_NAME = re.compile(r"[A-Za-z0-9_][\w.]*")
WHOLE_NUMBER = re.compile(r"[-+]?\d{1,9}")


def is_number(text: str) -> bool:
    """True for the text of a finite number."""
    try:
        return bool(np.isfinite(float(text)))
    except ValueError:
        return False


def name_junction(name: str) -> str:
    """Name of a junction that SUMO can hold: `name` itself, or else the numbers of its letters."""
    if SAFE_NAME.fullmatch(name):
        return name
    return "junction" + "".join(f"_{ord(letter)}" for letter in name)
