"""The ROS graph from outside: `topics`."""
