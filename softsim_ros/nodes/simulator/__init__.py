"""The simulator: physics in its own thread, and the ROS node around it."""
