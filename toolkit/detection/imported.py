"""`ImportedDetector`: any Python detector by its import path.

For example `my_package.my_module:detect`. The name stands for one of:

    a detector           called with the points (n, 3) of a frame, world frame, m, it returns `Detections`
    a maker of one       it has a parameter `site` (a `Site`) or `area` (xmin ymin xmax ymax, m), or none at all, and
                         returns a detector for that place; a class counts, its instances being the detectors

A detector may have an attribute `digest`, a text that changes with everything its detections depend on. Detections are
kept for another run only with a digest.
"""

from __future__ import annotations

import inspect
import os
import sys
from collections.abc import Callable
from importlib import import_module
from typing import Any

import numpy as np

from toolkit.arrays import Float32
from toolkit.objects import Detections, Detector
from toolkit.sites.site import Site


class ImportedDetector:
    """Detector for a site, imported by its name `package.module:callable`, also from the current folder. Another
    process imports it again. Raises ValueError, in one line, if the import fails or the detector returns anything but
    `Detections` for a cloud without points.
    """

    def __init__(self, name: str, site: Site) -> None:
        self.name, self.site = name, site
        named = _import_callable(name)
        try:
            self._detect = _make_detector(named, site)
            detections = self._detect(np.zeros((0, 3), np.float32))
        except Exception as error:  # the detector may raise anything
            raise ValueError(
                f"detector {name} fails with a cloud of no points ({type(error).__name__}: {error}): "
                "let it take points (n, 3) and return Detections"
            ) from error
        self._check(detections)

    def __call__(self, points: Float32[np.ndarray, "n 3"], /) -> Detections:
        """Detect in one cloud. Raises ValueError, in one line, if that fails."""
        try:
            detections = self._detect(points)
        except Exception as error:  # the detector may raise anything
            raise ValueError(
                f"detector {self.name} fails with a cloud of {len(points)} points ({type(error).__name__}: {error}): "
                "let it take any points (n, 3)"
            ) from error
        return self._check(detections)

    @property
    def digest(self) -> str:
        """Digest of the detector. Raises AttributeError if it has none."""
        return str(self._detect.digest)  # type: ignore[attr-defined]

    @property
    def labels(self) -> Any:
        """Classes that the detector names. Raises AttributeError if it names none."""
        return self._detect.labels  # type: ignore[attr-defined]

    def __reduce__(self) -> tuple[Any, ...]:
        return ImportedDetector, (self.name, self.site)

    def _check(self, detections: Any) -> Detections:
        if not isinstance(detections, Detections):
            raise ValueError(
                f"detector {self.name} must return toolkit.objects.Detections, got {type(detections).__name__}"
            )
        return detections


def _import_callable(name: str) -> Any:
    """Import the object of that name. Modules of the current folder are found last."""
    module, colon, attribute = name.partition(":")
    if not (colon and module and attribute):
        raise ValueError(f"a detector to import must be named package.module:callable, got {name!r}")
    if os.getcwd() not in sys.path:
        sys.path.append(os.getcwd())
    try:
        named = import_module(module)
        for part in attribute.split("."):
            named = getattr(named, part)
    except Exception as error:  # importing runs the module
        raise ValueError(f"detector {name} cannot be imported ({type(error).__name__}: {error})") from error
    if not callable(named):
        raise ValueError(f"detector {name} must be callable, got {type(named).__name__}")
    return named


def _make_detector(named: Callable[..., Any], site: Site) -> Detector:
    parameters = inspect.signature(named).parameters
    offered = {"site": site, "area": tuple(site.area.tolist())}
    wanted = {key: value for key, value in offered.items() if key in parameters}
    if wanted or not parameters or inspect.isclass(named):
        return named(**wanted)
    return named
