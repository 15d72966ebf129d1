"""Drive a robot from the keys of a terminal.

`decoder`, `state`, `commands` and `display` are pure; `terminal` owns the terminal's modes; `services` and
`bridge_link` talk to the other nodes; `teleop_node` is the ROS node, and `loop` runs it with a terminal.
"""
