"""Environments for training policies, by Gymnasium's interface; importing the package registers them.

`gymnasium.make("softsim_core.lab.learning:softsim/TripodReach-v0")` imports it by itself. Without Gymnasium
there is nobody to know them; distributions of scenes are read all the same.
"""

from __future__ import annotations

from importlib.util import find_spec

from lazy_loader import attach_stub

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)

if find_spec("gymnasium") is not None:
    from softsim_core.lab.learning.tasks import register_environments

    register_environments()
