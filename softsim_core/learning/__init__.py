"""Environments for training policies, by Gymnasium's interface; importing the package registers them.

`gymnasium.make("softsim/TripodReach-v0")` finds them without an import where the suite is installed. Without
Gymnasium there is nobody to know them; distributions of scenes are read all the same.
"""

from __future__ import annotations

from importlib.util import find_spec

if find_spec("gymnasium") is not None:
    from softsim_core.learning.registration import register_environments

    register_environments()
