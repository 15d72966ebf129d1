from .board import (
    FIRMWARE as FIRMWARE,
    EmulatedBoard as EmulatedBoard,
)
from .pty import (
    PtyBoard as PtyBoard,
    make_link as make_link,
)
from .pty_board import EmulatedBoardPty as EmulatedBoardPty
from .simavr import (
    EmulatorError as EmulatorError,
    I2cRegisters as I2cRegisters,
    read_image as read_image,
    why_missing as why_missing,
)
from .virtual_board import (
    ReceivedPacket as ReceivedPacket,
    VirtualBoard as VirtualBoard,
)
