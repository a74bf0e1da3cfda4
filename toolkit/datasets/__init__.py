"""Recordings: published and own files, simulated ones, samples of clouds in any layout, and the doctor."""

from lazy_loader import attach_stub

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
