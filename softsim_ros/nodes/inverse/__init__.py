"""Inverse control as ROS nodes: goals for the effector in, joint commands out."""
