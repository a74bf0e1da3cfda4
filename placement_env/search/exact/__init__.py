"""Searches that prove something about their answer.

They are every set of few candidates, integer programmes with bounds, and greedy's certificate.
"""

from lazy_loader import attach_stub

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
