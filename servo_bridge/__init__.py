"""From joint angles to the serial board of a servo robot, and never beyond its limits."""

import softsim_core  # noqa: F401 (first, it takes the current folder off the import path)
