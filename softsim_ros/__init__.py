"""ROS 2 nodes of the suite and the `softsim` command line."""

import softsim_core  # noqa: F401 (first, it takes the current folder off the import path)
