from . import (
    bridge_node as bridge_node,
    emulated_board_node as emulated_board_node,
    virtual_board_node as virtual_board_node,
)
from .board_node import BoardNode as BoardNode
from .bridge_node import (
    ServoBridge as ServoBridge,
    main as main,
)
from .bridge_services import EStopServices as EStopServices
from .commands import (
    MOST_BYTES as MOST_BYTES,
    CommandInput as CommandInput,
    command_values as command_values,
    joint_positions as joint_positions,
)
from .emulated_board_node import EmulatedBoardNode as EmulatedBoardNode
from .parameters import (
    BridgeSettings as BridgeSettings,
    assemble as assemble,
)
from .virtual_board_node import (
    LOG_LENGTH as LOG_LENGTH,
    VirtualBoardNode as VirtualBoardNode,
)
