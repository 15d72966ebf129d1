from . import dynamixel_packets as dynamixel_packets, legacy as legacy
from .ascii_imu import (
    ASCII_BAUD_RATE as ASCII_BAUD_RATE,
    LineParser as LineParser,
    encode_line as encode_line,
    parse_line as parse_line,
)
from .dynamixel import (
    DEAD_BAND as DEAD_BAND,
    DynamixelProtocol as DynamixelProtocol,
)
from .dynamixel_bus import (
    DynamixelBus as DynamixelBus,
    EmulatedServo as EmulatedServo,
)
from .dynamixel_packets import (
    HardwareError as HardwareError,
    Instruction as Instruction,
    Packet as Packet,
    PacketStream as PacketStream,
    StatusError as StatusError,
    crc16 as crc16,
)
from .extended import (
    DEAF_PATIENCE as DEAF_PATIENCE,
    PATIENCE as PATIENCE,
    ExtendedProtocol as ExtendedProtocol,
    PoseComparison as PoseComparison,
    reset_cause_text as reset_cause_text,
)
from .extended_board import (
    FRAME_S as FRAME_S,
    TICKS_PER_US as TICKS_PER_US,
    ExtendedBoard as ExtendedBoard,
)
from .frames import (
    FIRMWARE_VERSION as FIRMWARE_VERSION,
    Banner as Banner,
    BoardFlags as BoardFlags,
    Frame as Frame,
    FrameParser as FrameParser,
    FrameType as FrameType,
    Telemetry as Telemetry,
    encode as encode,
    join12 as join12,
    read_telemetry as read_telemetry,
    set_widths as set_widths,
)
from .legacy import (
    BOOT_LOADER_BYTE as BOOT_LOADER_BYTE,
    LegacyBoard as LegacyBoard,
    LegacyProtocol as LegacyProtocol,
    PacketParser as PacketParser,
    avoid_byte_100 as avoid_byte_100,
    encode_packet as encode_packet,
)
from .protocol import (
    Ability as Ability,
    BoardModel as BoardModel,
    BoardProtocol as BoardProtocol,
    Decoded as Decoded,
    EncodedPacket as EncodedPacket,
    TiltReading as TiltReading,
)
from .registry import (
    AUTO as AUTO,
    WAITING as WAITING,
    candidates as candidates,
    model_of_board as model_of_board,
    names as names,
    protocol_named as protocol_named,
    register as register,
)
