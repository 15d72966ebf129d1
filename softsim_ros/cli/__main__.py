"""`python -m softsim_ros.cli`: the `softsim` command where the console script is not installed."""

import sys

from softsim_ros.cli.app import run_command

if __name__ == "__main__":
    sys.exit(run_command())
