import collections.abc

from .app import (
    BROUGHT_BY as BROUGHT_BY,
    COMMANDS as COMMANDS,
    ROS_PACKAGES as ROS_PACKAGES,
    run_command as run_command,
)
from .command import (
    EXIT_INTERRUPTED as EXIT_INTERRUPTED,
    Colours as Colours,
    CommandError as CommandError,
    Parser as Parser,
    ProgressLine as ProgressLine,
    UsageError as UsageError,
    add_number as add_number,
    add_out as add_out,
    add_words as add_words,
    require_matplotlib as require_matplotlib,
    table_lines as table_lines,
)

def main(words: collections.abc.Sequence[str] | None = None) -> int: ...
