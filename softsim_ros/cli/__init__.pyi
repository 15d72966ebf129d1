import collections.abc

from .app import (
    BROUGHT_BY as BROUGHT_BY,
    COMMANDS as COMMANDS,
    run_command as run_command,
)
from .command import (
    Colours as Colours,
    Parser as Parser,
)

def main(words: collections.abc.Sequence[str] | None = None) -> int: ...
