"""ROS 2 nodes of the suite and the `softsim` command line."""
