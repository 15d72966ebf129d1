"""MuJoCo models (MJCF) as scenes of ours, and scenes of ours as MuJoCo models."""

from lazy_loader import attach_stub

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
