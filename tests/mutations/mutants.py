"""Seeded damage to files: bits, bytes and blocks of any file; numbers of a text; the structure of
JSON and HDF5.

Every mutation takes the content of a sound file and a generator, and gives what was done and the
damaged content.
"""

import io
import json
import re
import struct
from collections.abc import Callable
from functools import partial
from typing import Any

import h5py
import numpy as np

Mutation = Callable[[bytes, np.random.Generator], tuple[str, bytes]]


def flipped(content: bytes, rng: np.random.Generator) -> tuple[str, bytes]:
    """One to sixteen bits turned over, half of the time in the first kilobyte, where headers
    are."""
    changed = bytearray(content)
    reach = min(len(changed), 1024) if rng.random() < 0.5 else len(changed)
    places = rng.integers(0, reach, int(rng.integers(1, 17)))
    for place in places:
        changed[place] ^= 1 << int(rng.integers(8))
    return f"{len(places)} bits flipped", bytes(changed)


def cut(content: bytes, rng: np.random.Generator) -> tuple[str, bytes]:
    rest = int(rng.integers(0, len(content)))
    return f"cut off after {rest} bytes", content[:rest]


def blanked(content: bytes, rng: np.random.Generator) -> tuple[str, bytes]:
    """A block of zeros or of ones, as a bad sector leaves it."""
    first, length, value = (
        int(rng.integers(len(content))),
        int(rng.integers(1, 513)),
        rng.choice([0, 255]),
    )
    block = bytes([value]) * len(content[first : first + length])
    return f"{len(block)} bytes from {first} set to {value}", content[:first] + block + content[
        first + length :
    ]


def inserted(content: bytes, rng: np.random.Generator) -> tuple[str, bytes]:
    place, more = int(rng.integers(len(content) + 1)), rng.bytes(int(rng.integers(1, 65)))
    return f"{len(more)} bytes inserted at {place}", content[:place] + more + content[place:]


def repeated(content: bytes, rng: np.random.Generator) -> tuple[str, bytes]:
    first, length = int(rng.integers(len(content))), int(rng.integers(1, 2049))
    chunk = content[first : first + length]
    return f"{len(chunk)} bytes at {first} doubled", content[:first] + chunk + content[first:]


def removed(content: bytes, rng: np.random.Generator) -> tuple[str, bytes]:
    first, length = int(rng.integers(len(content))), int(rng.integers(1, 2049))
    return f"up to {length} bytes at {first} removed", content[:first] + content[first + length :]


BYTES: tuple[Mutation, ...] = (flipped, cut, blanked, inserted, repeated, removed)

_NUMBERS = (
    b"nan",
    b"-inf",
    b"1e400",
    b"-1",
    b"0",
    b"1e300",
    b"99999999999999999999",
    b"0.5",
    b"abc",
    b"",
    b"\xff\xfe",
)


def renumbered(content: bytes, rng: np.random.Generator) -> tuple[str, bytes]:
    """One number of a text is another, or none; half of the time one in the first kilobyte."""
    found = list(re.finditer(rb"[-+]?\d+(?:\.\d+)?(?:[eE][-+]?\d+)?", content))
    if not found:
        return flipped(content, rng)
    early = [number for number in found if number.start() < 1024]
    chosen = early if early and rng.random() < 0.5 else found
    number, other = (
        chosen[int(rng.integers(len(chosen)))],
        _NUMBERS[int(rng.integers(len(_NUMBERS)))],
    )
    first, last = number.span()
    return f"{number[0][:20]!r} at {first} is {other!r}", content[:first] + other + content[last:]


def rejoined(content: bytes, rng: np.random.Generator) -> tuple[str, bytes]:
    """Lines of a text that are exchanged, doubled or gone."""
    lines = content.splitlines(keepends=True)
    i, j = (int(k) for k in rng.integers(0, len(lines), 2))
    if rng.random() < 0.5:
        lines[i], lines[j] = lines[j], lines[i]
        return f"lines {i} and {j} exchanged", b"".join(lines)
    lines[i : i + 1] = [lines[i]] * int(rng.choice([0, 2]))
    return f"line {i} gone or doubled", b"".join(lines)


TEXT: tuple[Mutation, ...] = (*BYTES, renumbered, renumbered, rejoined)

_HOLE = "a hole in the document"
_VALUES: tuple[str, ...] = (
    *(
        "null",
        "true",
        '"north"',
        '""',
        "-1",
        "0",
        "1.5",
        "1e300",
        "1e400",
        "NaN",
        "-Infinity",
        "[]",
        "{}",
        "[[]]",
    ),
    *(
        '{"a": 1}',
        "[1, 2, 3]",
        "1" * 400,
        "1" * 5000,
        "[" * 20000 + "]" * 20000,
        '{"a":' * 20000 + "1" + "}" * 20000,
    ),
    *('"\\ud800"', '"\\u0000"', '["a", "b"]', "[null]"),
)


def restructured(content: bytes, rng: np.random.Generator) -> tuple[str, bytes]:
    """One value of a JSON document is of another type, huge, deep, no number, or gone."""
    return _restructured(json.loads(content), rng)


def _restructured(document: Any, rng: np.random.Generator) -> tuple[str, bytes]:
    where, holder, key = "", [document], 0
    while isinstance(holder[key], dict | list) and holder[key] and rng.random() < 0.85:
        inside = holder[key]
        keys = list(inside) if isinstance(inside, dict) else list(range(len(inside)))
        holder, key = inside, keys[int(rng.integers(len(keys)))]
        where += f".{key}"
    if where and rng.random() < 0.2:
        del holder[key]
        return f"{where} is gone", json.dumps(document).encode()
    value = _VALUES[int(rng.integers(len(_VALUES)))]
    holder[key] = _HOLE
    text = json.dumps(document if where else _HOLE)
    return f"{where or 'all'} is {value[:20]}", text.replace(json.dumps(_HOLE), value).encode()


JSON: tuple[Mutation, ...] = (
    *BYTES,
    renumbered,
    restructured,
    restructured,
    restructured,
    restructured,
)


def with_header_changed(content: bytes, rng: np.random.Generator) -> tuple[str, bytes]:
    """A safetensors file whose JSON header, or what it holds as JSON itself, says something
    else."""
    (length,) = struct.unpack("<Q", content[:8])
    header = json.loads(content[8 : 8 + length])
    inner = [key for key, text in header["__metadata__"].items() if text[:1] in "{["]
    if rng.random() < 0.5:
        key = inner[int(rng.integers(len(inner)))]
        what, text = _restructured(json.loads(header["__metadata__"][key]), rng)
        header["__metadata__"][key] = text.decode()
        what, changed = f"metadata {key}{what}", json.dumps(header).encode()
    else:
        what, changed = _restructured(header, rng)
    return what, struct.pack("<Q", len(changed)) + changed + content[8 + length :]


SAFETENSORS: tuple[Mutation, ...] = (
    *BYTES,
    with_header_changed,
    with_header_changed,
    with_header_changed,
)


def rebuilt(content: bytes, rng: np.random.Generator) -> tuple[str, bytes]:
    """An HDF5 file of which one dataset, group or attribute has another type, shape or value, or is
    gone."""
    stream = io.BytesIO(content)
    with h5py.File(stream, "r+") as file:
        names: list[str] = []
        file.visit(names.append)
        name = names[int(rng.integers(len(names)))]
        attributes = sorted(file[name].attrs)
        if attributes and rng.random() < 0.6:
            attribute = attributes[int(rng.integers(len(attributes)))]
            what = f"{name}:{attribute} {_change_attribute(file[name], attribute, rng)}"
        elif isinstance(file[name], h5py.Group) or rng.random() < 0.25:
            what = f"{name} {_change_node(file, name, rng)}"
        else:
            what = f"{name} {_change_dataset(file, name, rng)}"
    return what, stream.getvalue()


HDF5: tuple[Mutation, ...] = (flipped, cut, blanked, inserted, repeated, removed, *[rebuilt] * 8)


def _change_attribute(node: Any, name: str, rng: np.random.Generator) -> str:
    values: list[Any] = [
        *("north", "", b"\xff\xfe", np.nan, np.inf, -1, 0, 1.5, 1e300, 10**12, True, 1 + 2j),
        *(
            np.zeros(0),
            np.zeros((2, 3)),
            np.array(["a", "b"], h5py.string_dtype()),
            h5py.Empty("f8"),
        ),
        *(
            np.full((4, 4), np.nan),
            np.eye(3),
            np.zeros((), [("a", "f8")]),
            "[" * 20000,
            '{"a": NaN}',
            "[1, {}]",
        ),
        "null",
    ]
    if rng.random() < 0.15:
        del node.attrs[name]
        return "is gone"
    value = values[int(rng.integers(len(values)))]
    node.attrs[name] = value
    return f"is {value!s:.30}"


def _change_node(file: h5py.File, name: str, rng: np.random.Generator) -> str:
    """It is gone, of the other kind, of a type of no use, or a link that leads nowhere."""
    was_group = isinstance(file[name], h5py.Group)
    del file[name]
    what, node = (
        *(("is gone", None), ("is of the other kind", np.arange(3.0) if was_group else None)),
        ("is a link to nowhere", h5py.SoftLink("/nowhere/at/all")),
        ("is a link to a missing file", h5py.ExternalLink("missing.hdf5", "/there")),
        *(("is a named type", np.dtype("f8")), ("is the root itself", h5py.SoftLink("/"))),
        ("is empty", h5py.Empty("f4")),
    )[int(rng.integers(7))]
    if node is not None:
        file[name] = node
    elif what == "is of the other kind":
        file.create_group(name)
    return what


def _change_dataset(file: h5py.File, name: str, rng: np.random.Generator) -> str:
    was = file[name]
    attributes, values = dict(was.attrs), was[()]
    if isinstance(values, bytes):
        texts = [
            "",
            "[]",
            "3",
            "null",
            "{",
            "[" * 20000,
            '{"type": "FeatureCollection"}',
            "\x01",
            7.5,
            b"\xff\xfe",
        ]
        value: Any = texts[int(rng.integers(len(texts)))]
        del file[name]
        file[name] = value
        return f"is {value!r:.30}"
    changes: dict[str, Callable[[], Any]] = {
        "of text": lambda: values.astype("S"),
        "of texts of any length": lambda: np.full(values.shape, "north", h5py.string_dtype()),
        "complex": lambda: values.astype(np.complex128),
        "of truth values": lambda: values.astype(bool),
        "of whole numbers": lambda: np.nan_to_num(values).astype(np.int64),
        "of float16": lambda: values.astype(np.float16),
        "of pairs": lambda: np.zeros(values.shape, [("a", "f8"), ("b", "i4")]),
        "of void": lambda: np.zeros(values.shape, "V8"),
        "of references": lambda: np.full(values.shape, file.ref, h5py.ref_dtype),
        "shorter": lambda: values[: len(values) // 2],
        "longer": lambda: np.concatenate([values, values[-1:]]),
        "transposed": lambda: values.T,
        "flat": lambda: values.ravel(),
        "one axis more": lambda: values[None],
        "a scalar": lambda: values.ravel()[0],
        "without rows": lambda: values[:0],
        "narrower": lambda: values[..., :-1],
        "wider": lambda: np.concatenate([values, values[..., -1:]], axis=-1),
    }
    numbers = (np.nan, np.inf, -np.inf, 1e300, -1, 0, 1e6, 1e18, 2**31, 2**62, -(2**40), 0.5)
    for number in numbers:
        changes[f"{number:g} somewhere"] = partial(_filled, values, number, rng)
        changes[f"{number:g} all over"] = partial(_fitting, np.full_like(values, 0), number, ...)
    if rng.random() < 0.08:
        shape = (10**9, *was.shape[1:]) if was.ndim else (10**12,)
        dtype = was.dtype
        del file[name]
        file.create_dataset(name, shape, dtype, chunks=True).attrs.update(attributes)
        return f"claims shape {shape}"
    what = list(changes)[int(rng.integers(len(changes)))]
    try:
        value = changes[what]()
    except (ValueError, TypeError, IndexError, OverflowError):
        what, value = "of zeros", np.zeros(3)
    del file[name]
    file[name] = value
    file[name].attrs.update(attributes)
    return f"is {what}"


def _filled(values: np.ndarray, number: float, rng: np.random.Generator) -> np.ndarray:
    changed = np.array(values)
    return _fitting(changed, number, tuple(int(rng.integers(n)) for n in changed.shape))


def _fitting(changed: np.ndarray, number: float, place: Any) -> np.ndarray:
    with np.errstate(all="ignore"):
        changed[place] = np.asarray(number).astype(changed.dtype)
    return changed
