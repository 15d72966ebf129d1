"""The `softsim` command line: one small file a subcommand, imported only when it is asked for."""

from __future__ import annotations

from collections.abc import Sequence

from softsim_core.base.processes import use_safe_path
from softsim_node.ending import ending


def main(words: Sequence[str] | None = None) -> int:
    """Run the `softsim` command, see `softsim_ros.cli.app`; from here on signals are looked after."""
    ending.watch()
    use_safe_path()
    from softsim_ros.cli import app

    return app.main(words)


__all__ = ["main"]
