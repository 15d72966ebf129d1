"""Drive a robot from the keys of a terminal.

`decoder` and `display` are pure; `terminal` owns the terminal's modes; `teleop_node` is the ROS node,
which runs with a terminal. What keys do is in `softsim_ros.keys`, what comes of it in
`softsim_ros.client`.
"""
