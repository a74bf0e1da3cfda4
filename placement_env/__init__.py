"""Floor 3: candidates, objective, environments and searches, loaded lazily."""

from lazy_loader import attach_stub

from placement_env.envs.registration import register_with_gymnasium

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)

register_with_gymnasium()
