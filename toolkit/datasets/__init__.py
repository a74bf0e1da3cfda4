"""Recordings: published, recorded and simulated files, clouds in any layout, and their doctor."""

from lazy_loader import attach_stub

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
