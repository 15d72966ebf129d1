from . import teleop_node as teleop_node
from .decoder import (
    ESCAPE_TIMEOUT_S as ESCAPE_TIMEOUT_S,
    KeyDecoder as KeyDecoder,
)
from .display import (
    WARNING_S as WARNING_S,
    View as View,
    bar as bar,
    frame as frame,
    render as render,
)
from .teleop_node import (
    Teleop as Teleop,
    drive as drive,
    main as main,
)
from .terminal import NoTerminalError as NoTerminalError
