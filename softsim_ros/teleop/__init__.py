"""Drive a robot from the keys of a terminal.

`decoder`, `state`, `commands` and `display` are pure; `terminal` owns the terminal's modes; `teleop_node` is the ROS
node and `loop` runs both together.
"""
