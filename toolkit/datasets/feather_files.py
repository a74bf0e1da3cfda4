"""Columns of Arrow's feather files."""

import struct
from pathlib import Path
from typing import Any

import numpy as np

from toolkit.runtime import array_files, reading

_DICTIONARY = 2  # kind of an Arrow message
_BATCH = 3  # kind of an Arrow message


def read_table(path: str | Path) -> dict[str, np.ndarray]:
    """Read the columns of a feather file by name; float16 columns become float32.

    Raises ImportError without pyarrow, ValueError for a damaged file."""
    try:
        import pyarrow.ipc
    except ImportError:
        raise ImportError("reading .feather needs pyarrow: pip install pyarrow") from None
    unpacked = 0
    try:
        content = reading.read_plain(path)
        if content[:6] != b"ARROW1" or content[-6:] != b"ARROW1":
            raise ValueError("it is cut off or of another format: write it with pyarrow.feather")
        # the file's footer could point elsewhere
        stream = pyarrow.py_buffer(content).slice(8)
        batches = 0
        for message in pyarrow.ipc.MessageReader.open_stream(stream):
            batches += message.type == "record batch"
            unpacked += _batch_size(message.metadata.to_pybytes(), message.body or b"")
            array_files.check_unpacked(unpacked, array_files.MAX_CLOUD_BYTES)
        if batches != pyarrow.ipc.open_file(content).num_record_batches:
            raise ValueError("it lacks some of its rows: copy it again")
        table = pyarrow.ipc.open_stream(stream).read_all()
        table.validate(full=True)
        columns = {name: table[name].to_numpy() for name in table.column_names}
        return {
            name: column.astype(np.float32) if column.dtype == np.float16 else column
            for name, column in columns.items()
        }
    except (
        pyarrow.ArrowException,
        OSError,
        ValueError,
        KeyError,
        TypeError,
        MemoryError,
        struct.error,
    ) as error:
        reason = " ".join(str(error).split())[:200]
        raise ValueError(f"{path} is no feather file that can be read: {reason}") from None


def _batch_size(message: bytes, body: Any) -> int:
    """Number of bytes that a message of an Arrow file declares to unpack to, 0 if it has no data.

    message: its header, a flat buffer as Arrow's Message.fbs describes it; body: its data."""

    def number(kind: str, position: int) -> int:
        # Little-endian number of a `struct` kind at a position of the message.
        return int(struct.unpack_from(f"<{kind}", message, position)[0])

    def field(table: int, field_index: int) -> int:
        """Position of a field in the message, 0 if the table lacks it.

        table: position of its table in the message. The table begins with the distance back to a
        list: its size in bytes, the table's size, and each field's offset in the table, 2 bytes
        each."""
        # "i" is a number of 4 bytes, "H" one of 2 bytes without sign
        field_list = table - number("i", table)
        entry = 4 + 2 * field_index
        list_size = number("H", field_list)
        offset = number("H", field_list + entry) if entry < list_size else 0
        return table + offset if offset else 0

    def follow_offset(position: int) -> int:
        # Position to which the offset at a position points.
        return position + number("I", position)

    root = number("I", 0)
    kind = number("B", field(root, 1))
    batch = follow_offset(field(root, 2))
    if kind not in (_DICTIONARY, _BATCH):
        return 0
    batch = follow_offset(field(batch, 1)) if kind == _DICTIONARY else batch
    columns = follow_offset(field(batch, 1))
    buffers = follow_offset(field(batch, 2))
    rows = number("q", field(batch, 0)) if field(batch, 0) else 0
    # as NumPy's columns, also of nulls that take no bytes in the file
    size = rows * number("I", columns) * 8
    is_compressed = field(batch, 3)  # a compressed buffer begins with its size
    for k in range(number("I", buffers) if is_compressed else 0):
        position = number("q", buffers + 4 + 16 * k)
        length = number("q", buffers + 12 + 16 * k)
        size += max(length, struct.unpack_from("<q", body, position)[0] if length else 0)
    return size
