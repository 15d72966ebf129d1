from .keyboard import (
    DEFAULT_ROBOT as DEFAULT_ROBOT,
    Keyboard as Keyboard,
    KeySettings as KeySettings,
    requested_robot as requested_robot,
)
from .press import (
    GOAL_KEYS as GOAL_KEYS,
    HELP_KEY as HELP_KEY,
    HOLD_GAP_S as HOLD_GAP_S,
    REPEAT_INTERVAL_S as REPEAT_INTERVAL_S,
    TILT_KEYS as TILT_KEYS,
    CallAction as CallAction,
    KeyPress as KeyPress,
    KeyState as KeyState,
    MoveGoal as MoveGoal,
    Quit as Quit,
    SetReference as SetReference,
    goal_help as goal_help,
    key_of as key_of,
    key_table as key_table,
    tilt_line as tilt_line,
)
