"""What a robot is to ROS: its links and joints as a tree, and as URDF text."""
