"""Sensing: the sensors of a scene, each with its own sample rate, noise and seed."""

from lazy_loader import attach_stub

from softsim_core.base import find_former_names

_find, __dir__, __all__ = attach_stub(__name__, __file__)
__getattr__ = find_former_names(__name__, {"Seen": "StepObservation"}, _find)
