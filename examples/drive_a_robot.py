"""Drive a running robot from a script: start it with `softsim up tripod`, then run this file.

    python examples/drive_a_robot.py [ROBOT]

Nothing here knows topics or services: a client does, the same that the terminal and the page use. Its
commands keep the robot's limits; what is refused raises an error with a message.
"""

from __future__ import annotations

import sys

from softsim_core import SoftSimError
from softsim_ros.client import connect


def main(name: str) -> None:
    """Visit the poses of a robot's file, then make ten single steps."""
    with connect(name) as robot:
        joints, simulator = robot.client.joints, robot.client.simulator
        for pose in robot.client.robot.poses:
            robot.do(joints.go_to, pose)
            state = robot.wait_until_there()
            print(pose, [round(position, 2) for position in state.measured or ()])

        first = robot.client.robot.joint_names[0]
        print(robot.do(joints.move, first, 99.0))  # as far as its limit
        robot.wait_until_there()

        robot.do(simulator.pause, True)
        for _ in range(10):
            robot.do(simulator.step)
        robot.do(simulator.pause, False)
        try:
            robot.do(joints.go_to, "upside_down")
        except SoftSimError as error:
            print(error)


if __name__ == "__main__":
    main(sys.argv[1] if len(sys.argv) > 1 else "tripod")
