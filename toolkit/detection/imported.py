"""`ImportedDetector`: any Python detector by its import path, such as `my_package.my_module:detect`.

The name stands for a detector, called with the points (n, 3) of a frame, world frame, m, or for a maker of one: a
class, or a callable with a parameter `site` (a `Site`) or `area` (xmin ymin xmax ymax, m), or none at all. A detector
may have an attribute `digest`, a text that changes with everything its detections depend on. Detections are kept for
another run only with a digest.
"""

from __future__ import annotations

import inspect
import os
import re
import sys
from collections.abc import Sequence
from pkgutil import resolve_name

import numpy as np

from toolkit.arrays import Float32
from toolkit.objects import Detections
from toolkit.sites.site import Site


class ImportedDetector:
    """Detector for a site, imported by its name `package.module:callable`, also from the current folder. Another
    process imports it again. Raises ValueError, in one line, if the import fails or the detector returns anything but
    `Detections` for a cloud without points.
    """

    def __init__(self, name: str, site: Site) -> None:
        self.name, self.site = name, site
        if not re.fullmatch("[^:]+:[^:]+", name):
            raise ValueError(f"a detector to import must be named package.module:callable, got {name!r}")
        if os.getcwd() not in sys.path:
            sys.path.append(os.getcwd())  # modules of the current folder are found last
        try:
            named = resolve_name(name)
        except Exception as error:  # importing runs the module
            raise ValueError(f"detector {name} cannot be imported ({type(error).__name__}: {error})") from error
        if not callable(named):
            raise ValueError(f"detector {name} must be callable, got {type(named).__name__}")
        offered = {"site": site, "area": tuple(site.area.tolist())}
        try:
            parameters = inspect.signature(named).parameters
            wanted = {key: value for key, value in offered.items() if key in parameters}
            self._detect = named(**wanted) if wanted or not parameters or inspect.isclass(named) else named
        except Exception as error:  # making the detector may raise anything
            raise ValueError(f"detector {name} cannot be made ({type(error).__name__}: {error})") from error
        self(np.zeros((0, 3), np.float32))

    def __call__(self, points: Float32[np.ndarray, "n 3"], /) -> Detections:
        """Detect in one cloud. Raises ValueError, in one line, if that fails."""
        try:
            detections = self._detect(points)
        except Exception as error:  # the detector may raise anything
            raise ValueError(
                f"detector {self.name} fails with a cloud of {len(points) or 'no'} points "
                f"({type(error).__name__}: {error}): let it take any points (n, 3) and return Detections"
            ) from error
        if not isinstance(detections, Detections):
            raise ValueError(
                f"detector {self.name} must return toolkit.objects.Detections, got {type(detections).__name__}"
            )
        return detections

    @property
    def digest(self) -> str:
        """Digest of the detector. Raises AttributeError if it has none."""
        return str(self._detect.digest)

    @property
    def labels(self) -> Sequence[str]:
        """Classes that the detector names. Raises AttributeError if it names none."""
        labels: Sequence[str] = self._detect.labels
        return labels

    def __reduce__(self) -> tuple[type[ImportedDetector], tuple[str, Site]]:
        return ImportedDetector, (self.name, self.site)
