"""Several searches together, judged accurately on fresh traffic. None of the searches saw that
traffic."""

from lazy_loader import attach_stub

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
