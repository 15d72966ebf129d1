"""A board on a CAN bus: its port, its protocol, and a robot that names it.

The board takes frames POSE (degrees of the servos, a byte each) and sends its number in frames NUMBER ten
times per second, by which the bridge knows it. The bus needs python-can (pip install python-can);
virtual_can_board.py drives such a board without hardware.

    ros2 run servo_bridge servo_bridge --ros-args -p robot:=my_can_board.py -p port:=can:socketcan:can0
"""

from collections.abc import Callable, Sequence
from typing import Any

import can

from servo_bridge import PortError
from servo_bridge.driver import angles_to_bytes, bytes_to_angles, register_transport
from servo_bridge.protocols import Ability, BoardProtocol, Decoded, EncodedPacket, register
from softsim_core import BoardDescription, JointDescription, JointLimits, Scene, ServoCalibration

POSE, NUMBER = b"\x01\x20", b"\x01\x21"  # identifiers of frames


class CanPort:  # named can:INTERFACE:CHANNEL; a packet is a frame, its identifier first
    def __init__(self, port: str, bits_per_s: int = 0) -> None:
        self.port = port
        _, interface, channel = (*port.split(":", 2), "", "")[:3]
        self._bus: can.BusABC = self._try(can.Bus, channel, interface)

    def _try(self, action: Callable[..., Any], *arguments: Any) -> Any:
        try:
            return action(*arguments)
        except (OSError, ValueError, can.CanError) as error:
            raise PortError(self.port, f"the CAN bus {self.port} failed ({error}); is it up?") from error

    def write(self, packet: bytes) -> None:
        identifier = int.from_bytes(packet[:2], "big")
        frame = can.Message(arbitration_id=identifier, data=packet[2:], is_extended_id=False)
        self._try(self._bus.send, frame, 0.2)

    def read(self) -> bytes:
        frame = self._try(self._bus.recv, 0.05)
        return (frame.arbitration_id % 65536).to_bytes(2, "big") + bytes(frame.data) if frame else b""

    def cancel_read(self) -> None:
        """Do nothing: a read ends by itself soon."""

    def close(self) -> None:
        self._bus.shutdown()


@register
class CanBoard(BoardProtocol):
    name, abilities, number = "can_board", Ability.DETECT | Ability.TELEMETRY, b""

    @classmethod
    def refusal(cls, board: BoardDescription) -> str:
        text = f"the board has {len(board.servos)} servos and a CAN frame 8 data bytes; use at most 8 servos"
        return text if len(board.servos) > 8 else ""

    def encode_pose(self, angles_rad: Sequence[float]) -> EncodedPacket:
        degrees = angles_to_bytes(angles_rad, self.servos)
        return EncodedPacket(POSE + bytes(degrees), degrees, bytes_to_angles(degrees, self.servos))

    def decode(self, data: bytes) -> Decoded:
        self.number = data[2:] if data[:2] == NUMBER else self.number
        return Decoded(recognised=data[:2] == NUMBER)

    def identity(self) -> str | None:  # after the bus was lost, no other board is driven
        return f"number {self.number.hex()}" if self.number else None


register_transport("can", CanPort)


def create_scene(scene: Scene) -> None:
    scene.name, names = "can_robot", ("shoulder", "elbow")
    scene.add(JointDescription(name=name, limits=JointLimits(-1.5, 0.0, 2.0)) for name in names)
    servos = tuple(ServoCalibration(joint=name) for name in names)
    scene.board = BoardDescription(servos=servos, protocol="can_board")
