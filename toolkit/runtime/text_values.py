"""Values of JSON, TOML and YAML texts."""

import json
import math
import re
import tomllib
from pathlib import Path
from typing import Any

from toolkit.runtime.reading import name_errors, read_text

MAX_YAML_VALUES = 1_000_000  # in a YAML text; a value that an alias repeats counts each time


def parse_json(text: str) -> Any:
    """Parse a JSON text. Raises ValueError, in one line, for damaged or too deeply nested text."""
    try:
        return json.loads(text, parse_int=_whole_number, object_pairs_hook=_unique)
    except json.JSONDecodeError as error:
        reason = f"not JSON from line {error.lineno} on ({error.msg})"
    except RecursionError:
        reason = "its lists or objects are nested too deep to be read"
    except ValueError as error:
        reason = str(error)
    raise ValueError(f"{reason}: restore the file")


def _whole_number(digits: str) -> int:
    """Number of a text of digits. Raises ValueError for more digits than any float has."""
    # no float is as large, and Python turns no text of thousands into a number
    if len(digits) > 300:
        raise ValueError(f"it has a number of {len(digits)} digits")
    return int(digits)


def _unique(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    _refuse_doubled([key for key, _ in pairs])
    return dict(pairs)


def _refuse_doubled(keys: list[Any]) -> None:
    if len(set(keys)) < len(keys):
        key = next(key for k, key in enumerate(keys) if key in keys[:k])
        raise ValueError(f"it has the key {str(key)[:60]!r} twice")


def read_own_table(module: str, name: str) -> dict[str, Any]:
    """Read a TOML file of this project in the folder of a module, given by its `__file__`."""
    return tomllib.loads(Path(module).with_name(name).read_text(encoding="utf-8"))


def parse_toml(content: bytes) -> dict[str, object]:
    """Parse a TOML file's content.

    Raises ValueError, in one line, for damaged, too large or too deeply nested text."""
    try:
        if len(content) > 1_000_000:
            raise ValueError("it is larger than 1 MB")
        # the parser takes the square of the dots in memory
        if any(line.count(b".") > 300 for line in content.splitlines()):
            raise ValueError("a line has more than 300 dots")
        if re.search(rb"\d{300}", content):
            raise ValueError("it has a number of hundreds of digits")
        return tomllib.loads(content.decode("utf-8-sig"))
    except UnicodeDecodeError as error:
        raise ValueError(
            f"not a text file (byte {error.start} is not UTF-8): give a TOML file"
        ) from None
    except RecursionError:
        raise ValueError(
            "its lists or tables are nested too deep to be read: repair the file"
        ) from None
    except ValueError as error:
        raise ValueError(f"not TOML ({str(error)[:120]}): repair the file") from None


def parse_yaml(text: str) -> Any:
    """Parse a YAML text.

    Raises ValueError, in one line, for damage, a repeated key, and aliases that make more than
    `MAX_YAML_VALUES` values of a few lines."""
    import yaml

    loader = getattr(yaml, "CSafeLoader", yaml.SafeLoader)(text)
    try:
        node = loader.get_single_node()
        if node is None:
            return None
        if _count_values(node, {}) > MAX_YAML_VALUES:
            raise ValueError(
                f"it holds more than {MAX_YAML_VALUES} values, aliases included: restore the file"
            )
        return loader.construct_document(node)
    except yaml.YAMLError as error:
        raise ValueError(" ".join(str(error).split())[:160]) from None
    except RecursionError:
        raise ValueError(
            "its lists or names are nested too deep to be read: restore the file"
        ) from None
    finally:
        loader.dispose()


def _count_values(node: Any, counted: dict[int, int]) -> int:
    """Count a YAML node and all below it, up to `MAX_YAML_VALUES` + 1.

    Aliases lead to one node many times, and it counts each time. counted: numbers so far, by `id`
    of the node, to which new ones are added. Raises ValueError for a key that is there twice."""
    if id(node) not in counted:
        counted[id(node)] = MAX_YAML_VALUES + 1  # met again below itself
        below = node.value if node.id != "scalar" else ()
        if node.id == "mapping":
            _refuse_doubled(
                [key.value for key, _ in below if key.id == "scalar" and key.value != "<<"]
            )
            below = [child for pair in below for child in pair]
        counted[id(node)] = min(
            MAX_YAML_VALUES + 1, 1 + sum(_count_values(child, counted) for child in below)
        )
    return counted[id(node)]


def read_json(path: str | Path) -> Any:
    """Read a JSON file in UTF-8. Raises OSError; ValueError, in one line, for a damaged file."""
    text = read_text(path, "JSON")
    with name_errors(path):
        return parse_json(text)


def replace_infinite(value: Any) -> Any:
    """Replace numbers that JSON lacks by null, such as an infinite bound or an undefined AP."""
    if isinstance(value, dict):
        return {key: replace_infinite(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [replace_infinite(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
