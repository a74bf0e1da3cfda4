"""Detection: VoxelNet, its training and its weights.

Needs only torch, numpy, h5py and shapely, each loaded when used.
"""

from lazy_loader import attach_stub

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
