"""The `softsim` command line: one small file a subcommand, imported only when it is asked for."""

from softsim_ros.cli.app import main

__all__ = ["main"]
