"""The `softsim` command line: one small file per subcommand, imported only when it is used."""

from __future__ import annotations

from collections.abc import Sequence

from lazy_loader import attach_stub

from softsim_core.base import use_safe_path
from softsim_node import ending

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)


def main(words: Sequence[str] | None = None) -> int:
    """Run the `softsim` command, see `softsim_ros.cli.app`; signals are handled from here on."""
    ending.watch()
    use_safe_path()
    from softsim_ros.cli import app

    return app.run_command(words)
