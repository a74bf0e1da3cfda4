"""Columns of ROS's PointCloud2."""

import numpy as np

from toolkit.datasets.layouts.bag_messages import RosObject

# NumPy's type for each `datatype` of a field
_TYPES = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 8: "f8"}


def parse_columns(message: RosObject) -> dict[str, np.ndarray]:
    """Parse the fields of a PointCloud2 as columns by name, a row per point, in our byte order.

    Raises ValueError if they do not fit its bytes."""
    order = ">" if message.is_bigendian else "<"
    width = int(message.width)
    height = int(message.height)
    step = int(message.point_step)
    row_step = int(message.row_step)
    data = np.asarray(message.data, np.uint8)
    names = []
    formats = []
    offsets = []
    for point_field in message.fields:
        if (
            point_field.datatype not in _TYPES
            or point_field.name in names
            or point_field.count not in (0, 1)
        ):
            continue  # padding, or several numbers
        kind = np.dtype(order + _TYPES[point_field.datatype])
        if not 0 <= point_field.offset <= step - kind.itemsize:
            raise ValueError(f"field {point_field.name} does not fit a point of {step} bytes")
        names.append(str(point_field.name))
        formats.append(kind)
        offsets.append(int(point_field.offset))
    packed_step = width * step
    # some drivers leave it 0, or do not change it with the width: rows follow one another
    if row_step < packed_step <= len(data) // max(height, 1) or (
        height * row_step > len(data) == height * packed_step
    ):
        row_step = packed_step
    if step < 1 or row_step < packed_step or len(data) < height * row_step:
        raise ValueError(f"a cloud of {height} rows of {width} points has {len(data)} bytes only")
    # without the padding at the end of each row
    rows = data[: height * row_step].reshape(height, row_step)
    packed_rows = np.ascontiguousarray(rows[:, :packed_step])
    point = np.dtype({"names": names, "formats": formats, "offsets": offsets, "itemsize": step})
    table = np.frombuffer(packed_rows.tobytes(), point, width * height)
    columns = {name: table[name].astype(table[name].dtype.newbyteorder("=")) for name in names}
    if not {"x", "y", "z"} <= columns.keys():
        raise ValueError(f"a cloud has no x, y and z, but {', '.join(names)}")
    return columns
