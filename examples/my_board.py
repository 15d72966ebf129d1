"""A board of your own: its protocol in one class, a robot that names it, and a virtual one to drive.

The board takes lines "S 90 90 *65" (degrees of the servos, then the sum of the characters before " *", modulo
256, in hexadecimal) and says "my_board ready" ten times per second, by which the bridge knows it.

    python examples/my_board.py                                          drives a virtual board
    ros2 run servo_bridge servo_bridge --ros-args -p robot:=$PWD/examples/my_board.py -p port:=/dev/ttyACM0
"""

import time
from collections.abc import Sequence

from servo_bridge.driver import ServoDriver, angles_to_bytes, bytes_to_angles
from servo_bridge.emulator import VirtualBoard
from servo_bridge.protocols import Ability, BoardModel, BoardProtocol, Decoded, EncodedPacket, register
from softsim_core import BoardDescription, JointDescription, JointLimits, Scene, ServoCalibration, load_scene

READY = b"my_board ready"


def line_of(degrees: tuple[int, ...]) -> bytes:
    body = " ".join(["S", *map(str, degrees)]).encode()
    return body + b" *%02X\n" % (sum(body) % 256)  # large letters: a small d is the byte 100


@register
class MyBoard(BoardProtocol):
    name, abilities = "my_board", Ability.DETECT | Ability.TELEMETRY
    said = b""  # the line begun

    def encode_pose(self, angles_rad: tuple[float, ...]) -> EncodedPacket:
        degrees = angles_to_bytes(angles_rad, self.servos)
        return EncodedPacket(line_of(degrees), degrees, bytes_to_angles(degrees, self.servos))

    def decode(self, data: bytes) -> Decoded:
        *lines, rest = (self.said + data).split(b"\n")
        self.said = rest[-80:]  # a line without end is given up
        return Decoded(recognised=READY in lines)

    @classmethod
    def board_model(cls, servos: Sequence[ServoCalibration]) -> BoardModel:
        return MyBoardModel()


class MyBoardModel(BoardModel):  # what a virtual board does; a protocol works without one
    say_period_s, accepted, dropped, begun = 0.1, 0, 0, b""

    def feed(self, data: bytes, now: float) -> list[tuple[int, ...]]:
        *lines, self.begun = (self.begun + data).split(b"\n")
        said = [(tuple(int(word) for word in line.split() if word.isdigit()), line) for line in lines]
        poses = [pose for pose, line in said if line_of(pose) == line + b"\n"]
        self.accepted, self.dropped = self.accepted + len(poses), self.dropped + len(lines) - len(poses)
        return poses

    def reset(self, cause: int) -> None:
        self.begun = b""

    def say(self, now: float) -> bytes:
        return READY + b"\n"


def create_scene(scene: Scene) -> None:
    scene.name, names = "my_robot", ("shoulder", "elbow")
    scene.add(JointDescription(name=name, limits=JointLimits(-1.5, 0.0, 2.0)) for name in names)
    servos = tuple(ServoCalibration(joint=name) for name in names)
    scene.board = BoardDescription(servos=servos, protocol="my_board")


if __name__ == "__main__":
    driver = ServoDriver(load_scene(__file__))
    with VirtualBoard(servos=2, protocol="my_board") as board:
        driver.connect(board.port, quiet_s=1.0)
        while board.servo_bytes != (121, 99):
            driver.command([-1.0, -1.39])
            driver.tick()
            time.sleep(driver.period)
        print(f"{driver.link_state}: {board.accepted} lines, servos at {board.servo_bytes} degrees")
        driver.disconnect()
