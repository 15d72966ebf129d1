"""Run a module or script as a program: `program_starter.py PROGRAM WORDS`; Python 3.10 has no option `-P`."""

import sys

del sys.path[0]  # the folder of this file, whose names are no modules

import runpy  # noqa: E402

if __name__ == "__main__":
    del sys.argv[0]
    if sys.argv[0].endswith(".py"):
        runpy.run_path(sys.argv[0], run_name="__main__")
    else:
        runpy.run_module(sys.argv[0], run_name="__main__", alter_sys=True)
