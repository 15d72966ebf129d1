"""The ROS nodes of the project, one package each."""
