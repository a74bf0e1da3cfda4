"""Site of an HDF5 file of images."""

from collections.abc import Sequence
from itertools import islice

import h5py
import numpy as np

from toolkit.datasets import published_layout as published
from toolkit.runtime import hdf5
from toolkit.runtime.text_values import parse_json
from toolkit.sites import BUILT_IN
from toolkit.sites.files import load_site, parse
from toolkit.sites.site import Site


class UnknownSite(ValueError):
    """A recording that does not name its site, and shows none that is known."""


def find_stored_site(file: h5py.File, cameras: Sequence[str]) -> Site:
    """Return the site of a file: the stored one, else a built-in one.

    A built-in site is taken if more than half of the cameras, or of the objects in some frames,
    are in its area or within 15 m of it. Raises UnknownSite for none. cameras: names of groups in
    cameras/."""
    if hdf5.contains(file, "coview/site"):
        try:
            return parse(parse_json(hdf5.text(file, "coview/site")))
        except (ValueError, OSError) as error:
            raise UnknownSite(
                f"coview/site is damaged ({error}): pass site= to read the file all the same"
            ) from None
    matrices = [hdf5.array(file, f"cameras/{name}/extrinsic") for name in cameras]
    usable_matrices = [
        matrix for matrix in matrices if matrix.shape == (4, 4) and np.isfinite(matrix).all()
    ]
    # extrinsics lead from the world to the camera; x, y of the cameras in CARLA's world, (1, 2)
    positions = [np.linalg.pinv(matrix)[None, :2, 3] for matrix in usable_matrices]
    # objects of the first 20 frames
    tables = (
        hdf5.array(file, f"objects/{k}", kinds="fiub")
        for k in islice(hdf5.child_names(file, "objects"), 20)
    )
    centres = [objects[:, :2] for objects in tables if objects.ndim == 2 and objects.shape[1] > 1]
    for site in map(load_site, BUILT_IN):
        carla_to_site = np.linalg.inv(published.MAP_FROM_CARLA @ site.map_SE3_site)
        for places in (positions, centres):
            xy = (
                np.concatenate([np.zeros((0, 2)), *places]) @ carla_to_site[:2, :2].T
                + carla_to_site[:2, 3]
            )
            is_inside = ((xy > site.area[:2] - 15) & (xy < site.area[2:] + 15)).all(axis=1)
            if len(xy) and is_inside.mean() > 0.5:
                return site
    raise UnknownSite(
        f"it does not say which site it shows and is none of {', '.join(BUILT_IN)}: pass site="
    )
