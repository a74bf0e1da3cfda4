"""JSON with care: what is wrong with a document becomes one ValueError that says where; what JSON cannot hold, null."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any


def parse_json(text: str) -> Any:
    """The values of a JSON text. Raises ValueError, in one line, where it is none or nested too deep.

    >>> parse_json("[" * 100000)
    Traceback (most recent call last):
    ValueError: its lists or objects are nested too deep to be read: restore the file
    """
    try:
        return json.loads(text)
    except json.JSONDecodeError as error:
        raise ValueError(f"not JSON from line {error.lineno} on ({error.msg}): restore the file") from None
    except RecursionError:
        raise ValueError("its lists or objects are nested too deep to be read: restore the file") from None
    except ValueError:  # Python refuses to turn very long texts into numbers
        raise ValueError("it has a number of thousands of digits: restore the file") from None


def read_json(path: str | Path) -> Any:
    """The values of a JSON file in UTF-8. Raises OSError; ValueError, in one line, where it is damaged."""
    try:
        return parse_json(Path(path).read_text(encoding="utf-8-sig"))
    except UnicodeDecodeError as error:
        raise ValueError(f"{path}: not a text file (byte {error.start} is not UTF-8): give a JSON file") from None
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from None


def finite(value: Any) -> Any:
    """The value with null for the numbers that JSON has not: an infinite bound, the AP of nothing to find.

    >>> finite({"bound": float("inf"), "ap": (0.5, float("nan"))})
    {'bound': None, 'ap': [0.5, None]}
    """
    if isinstance(value, dict):
        return {key: finite(each) for key, each in value.items()}
    if isinstance(value, list | tuple):
        return [finite(each) for each in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
