"""Recordings: published, own and simulated files. Also the frames of clouds in any layout, and the
doctor."""

from lazy_loader import attach_stub

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
