"""The ROS nodes of the suite, one package each."""
