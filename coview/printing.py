"""What a command prints: text for people, or one line of JSON."""

from __future__ import annotations

import json
import math
from typing import Any


def print_result(result: Any, text: str, *, as_json: bool) -> None:
    """Print the text, or the result as JSON."""
    print(json.dumps(finite(result), allow_nan=False) if as_json else text)


def finite(value: Any) -> Any:
    """null for the numbers that JSON has not: an infinite bound, the AP of nothing to find."""
    if isinstance(value, dict):
        return {key: finite(each) for key, each in value.items()}
    if isinstance(value, list | tuple):
        return [finite(each) for each in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
