"""`o3d`: Open3D without its viewer for web pages.

The viewer's framework would take half a second at every start."""

import sys
from importlib import import_module
from types import ModuleType
from typing import Any

VIEWER = "open3d.visualization.draw_plotly"


class _Viewer(ModuleType):
    """The viewer, loaded when one of its functions is called."""

    __all__ = ()

    def __getattr__(self, name: str) -> Any:
        """Return a function that loads the viewer, then calls the viewer's function `name`."""
        if name.startswith("__"):
            raise AttributeError(name)

        def call(*args: Any, **kwargs: Any) -> Any:
            if sys.modules[VIEWER] is self:  # makes way for the viewer itself
                del sys.modules[VIEWER]
            return getattr(import_module(VIEWER), name)(*args, **kwargs)

        return call


sys.modules.setdefault(VIEWER, _Viewer(VIEWER))
import open3d as o3d  # noqa: E402

__all__ = ["o3d"]
