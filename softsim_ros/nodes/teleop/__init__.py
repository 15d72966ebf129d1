"""Drive a robot with the keys of a terminal.

`decoder` and `display` are pure; `terminal` controls the terminal's modes; `teleop_node` is the ROS node,
which needs a terminal. The actions of keys are in `softsim_ros.keys`, and the commands that they send are in
`softsim_ros.client`.
"""

from lazy_loader import attach_stub

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
