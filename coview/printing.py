"""Output of a command: text or JSON. Text is for people; JSON is one line."""

from __future__ import annotations

import json
from typing import Any

from toolkit.runtime.files import replace_infinite


def print_result(result: Any, text: str, *, as_json: bool) -> None:
    """Print the text, or the result as JSON."""
    print(json.dumps(replace_infinite(result), allow_nan=False) if as_json else text)
