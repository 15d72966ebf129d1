"""The ROS nodes of the bridge and of boards without hardware."""
