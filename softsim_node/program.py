"""First code of an executable: its imports end without a traceback, whatever signal arrives."""

from __future__ import annotations

import importlib
import os
import sys
from collections.abc import Sequence

from softsim_core.base import SoftSimError, use_safe_path
from softsim_node.environment import check_ros_variables, limit_blas_threads, prepare_environment
from softsim_node.signals import ending


def run_module(module: str, args: Sequence[str] | None = None) -> int:
    """Import a module and run its `main`; a request to end in the meantime ends with 0.

    Args:
        module: Module of a node.
        args: Command line without the program's name; None takes that of the process.
    """
    ending.watch()
    use_safe_path()
    limit_blas_threads(os.environ)
    try:
        prepare_environment()
        check_ros_variables()
    except SoftSimError as error:
        sys.stderr.write(f"{error}\n")
        return 1
    program = importlib.import_module(module)
    if ending.asked:
        ending.over()
        return 0
    return int(program.main(args))
