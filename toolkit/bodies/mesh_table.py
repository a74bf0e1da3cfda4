"""`meshes.toml`: what the files of a folder of meshes are, where their names and shapes do not say it.

    [[mesh]]
    file = "models/bus_12m.obj"   # below the folder
    label = "heavy"               # vehicle, cyclist, pedestrian or heavy
    up = "y"                      # the file's axis that points up: x y z -x -y -z
    forward = "z"                 # and the one that points forward
    scale = 0.0254                # metres of one of its units

Only `file` must be there. What is not given is documented (z up, x forward, metres) or told from folder, name or shape.
"""

from __future__ import annotations

import tomllib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from toolkit.arrays import Float64
from toolkit.objects import label_index

TABLE = "meshes.toml"
_AXES = {sign + axis: (1 if not sign else -1) * np.eye(3)[i] for i, axis in enumerate("xyz") for sign in ("", "-")}


@dataclass(frozen=True)
class MeshEntry:
    """What the table says of a file; None for what it does not say. up, forward: axes of the file; scale: metres."""

    label: int | None = None
    up: str | None = None
    forward: str | None = None
    scale: float | None = None

    @property
    def framed(self) -> bool:
        """Whether the entry says how the mesh stands."""
        return self.up is not None or self.forward is not None

    @property
    def turn(self) -> Float64[np.ndarray, "3 3"]:
        """The rotation from the file's axes to x forward, y left, z up."""
        forward, up = _AXES[self.forward or "x"], _AXES[self.up or "z"]
        return np.stack([forward, np.cross(up, forward), up])


NOTHING_SAID = MeshEntry()


def read_mesh_table(folder: Path) -> dict[Path, MeshEntry]:
    """What `meshes.toml` in the folder says, by file; nothing where there is none.

    Raises ValueError, naming the table and the entry, where it is no TOML or says what cannot be.
    """
    path = folder / TABLE
    if not path.is_file():
        return {}
    try:
        content = tomllib.loads(path.read_text(encoding="utf-8"))
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise ValueError(f"{path}: is no TOML ({error}): mend it or remove it") from None
    rows = content.get("mesh")
    if set(content) != {"mesh"} or not isinstance(rows, list):
        raise ValueError(f"{path}: must hold [[mesh]] entries alone, got {sorted(content)}")
    table: dict[Path, MeshEntry] = {}
    for number, row in enumerate(rows, 1):
        where = f"{path}, entry {number}"
        file = row.get("file") if isinstance(row, dict) else None
        if not isinstance(file, str) or not (folder / file).is_file():
            raise ValueError(f"{where}: file must name a mesh below {folder}, got {file!r}")
        if Path(file) in table:
            raise ValueError(f"{where}: {file} is there twice: keep one entry")
        table[Path(file)] = _entry(row, where)
    return table


def _entry(row: dict[str, Any], where: str) -> MeshEntry:
    known = {"file", "label", "up", "forward", "scale"}
    if not set(row) <= known:
        raise ValueError(f"{where}: knows {', '.join(sorted(known))}, got {', '.join(sorted(set(row) - known))}")
    for key in ("up", "forward"):
        if key in row and row[key] not in list(_AXES):
            raise ValueError(f"{where}: {key} must be one of {', '.join(_AXES)}, got {row[key]!r}")
    up, forward, scale = row.get("up"), row.get("forward"), row.get("scale")
    if (up or "z")[-1] == (forward or "x")[-1]:
        raise ValueError(f"{where}: up {up or 'z'} and forward {forward or 'x'} lie on one axis: say both")
    if scale is not None and (isinstance(scale, bool) or not isinstance(scale, int | float) or not 0 < scale < 1e6):
        raise ValueError(f"{where}: scale must be a number above 0, metres of one unit, got {scale!r}")
    try:
        label = None if "label" not in row else label_index(row["label"])
    except ValueError as error:
        raise ValueError(f"{where}: {error}") from None
    return MeshEntry(label, up, forward, None if scale is None else float(scale))
