"""Floor 1: sites, traffic, sensors, clouds, fusion and metrics. Nothing heavy loads until it is
used."""

from lazy_loader import attach_stub

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
