"""Names of sensors and poles in the live planner's scene. A telephone hides the long ones, which
would cover each other."""

from typing import TYPE_CHECKING

import numpy as np

from toolkit.arrays import Float64
from toolkit.viewing import scene_parts
from toolkit.viewing.scene import Handle

if TYPE_CHECKING:
    from viser import LabelHandle, SceneApi

MAX_SHORT_NAME_LETTERS = 8  # for which a telephone has room
LONG_NAMES_NODE = "/names"  # above all longer names


def add_long_names(api: "SceneApi") -> None:
    """Add the node above all long names, before browsers come."""
    scene_parts.add_group(api, LONG_NAMES_NODE)


def hide_long_names(client: Handle) -> None:
    """Hide all long names in one browser, also the ones that follow. client: the browser."""
    scene_parts.add_group(client.scene, LONG_NAMES_NODE, visible=False)


def add_name(
    api: "SceneApi", node: str, name: str, position: Float64[np.ndarray, "3"], *, scale: float
) -> "LabelHandle":
    """Add a name to the scene.

    node: path of its node, which is below `LONG_NAMES_NODE` for a long name; position: x, y and z
    (m) above which it is; scale: size of its letters, as a multiple of the usual one."""
    if len(name) > MAX_SHORT_NAME_LETTERS:
        node = f"{LONG_NAMES_NODE}{node}"
    return scene_parts.add_label(api, node, name, position, scale=scale)
