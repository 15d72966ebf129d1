"""`softsim doctor`: what is installed, which port, which ROS, and what to do where something is wrong."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from softsim_ros.cli.colours import Colours
from softsim_ros.cli.upkeep.checks import house, ports, ros
from softsim_ros.cli.upkeep.checks.finding import Finding, Level

MARKS = {Level.OK: "ok  ", Level.WARNING: "warn", Level.PROBLEM: "FAIL"}
COLOURS = {Level.OK: "green", Level.WARNING: "yellow", Level.PROBLEM: "red"}

CHECKS = (
    house.python,
    house.packages,
    house.optional_packages,
    house.numba,
    house.configs,
    ros.client,
    ros.mixture,
    ros.reach,
    ros.log_folder,
    ros.shared_memory,
    ports.board,
    ports.virtual_board,
    ports.emulated_board,
    ports.flashing,
    house.terminal,
)


def configure(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    parser.add_argument("--port", default="", metavar="PATH", help="the board's port, where you know it")


def run(arguments: argparse.Namespace) -> int:
    """Print every finding; 0 where nothing is broken (warnings allowed), else 1."""
    findings = examine(arguments.port)
    colour = Colours(sys.stdout)
    for finding in findings:
        mark = colour(COLOURS[finding.level], MARKS[finding.level])
        print(f"{mark}  {finding.subject}: {finding.text}")
        if finding.advice:
            print(f"      -> {finding.advice}")
    problems = sum(finding.level is Level.PROBLEM for finding in findings)
    warnings = sum(finding.level is Level.WARNING for finding in findings)
    print(f"{len(findings)} checks, {problems} broken, {warnings} to mind")
    return 1 if problems else 0


def examine(port: str = "") -> list[Finding]:
    """Run every check; one that fails by itself becomes a finding, too."""
    findings = []
    for check in CHECKS:
        try:
            findings += check(port) if check is ports.board else check()
        except Exception as error:  # a broken installation may fail anywhere, and this is where it gets said
            name = f"{Path(check.__module__.replace('.', '/')).name} {check.__name__}"
            findings.append(Finding(Level.PROBLEM, name, f"the check itself failed: {error!r}"))
    return findings
