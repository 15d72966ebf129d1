"""`softsim doctor`: report what is installed, which port, which ROS, and what to do about problems."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from softsim_ros.cli import Colours
from softsim_ros.cli.upkeep import findings, ros_findings
from softsim_ros.cli.upkeep.findings import Finding, Level

MARKS = {Level.OK: "ok  ", Level.WARNING: "warn", Level.PROBLEM: "FAIL"}
COLOURS = {Level.OK: "green", Level.WARNING: "yellow", Level.PROBLEM: "red"}

CHECKS = (
    findings.python,
    findings.packages,
    findings.optional_packages,
    findings.numba,
    findings.configs,
    ros_findings.client,
    ros_findings.mixture,
    ros_findings.reach,
    ros_findings.log_folder,
    ros_findings.shared_memory,
    findings.board,
    findings.virtual_board,
    findings.emulated_board,
    findings.flashing,
    findings.terminal,
)


def configure(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    parser.add_argument("--port", default="", metavar="PATH", help="the board's port, where you know it")


def run(arguments: argparse.Namespace) -> int:
    """Print every finding; return 0 if nothing is broken (warnings allowed), else 1."""
    found = examine(arguments.port)
    colour = Colours(sys.stdout)
    for finding in found:
        mark = colour(COLOURS[finding.level], MARKS[finding.level])
        print(f"{mark}  {finding.subject}: {finding.text}")
        if finding.advice:
            print(f"      -> {finding.advice}")
    problems = sum(finding.level is Level.PROBLEM for finding in found)
    warnings = sum(finding.level is Level.WARNING for finding in found)
    print(f"{len(found)} checks, {problems} broken, {warnings} to mind")
    return 1 if problems else 0


def examine(port: str = "") -> list[Finding]:
    """Run every check; a check that fails itself becomes a finding, too."""
    found = []
    for check in CHECKS:
        try:
            found += check(port) if check is findings.board else check()
        except Exception as error:  # a broken installation may fail anywhere, and it is reported here
            name = f"{Path(check.__module__.replace('.', '/')).name} {check.__name__}"
            found.append(Finding(Level.PROBLEM, name, f"the check itself failed: {error!r}"))
    return found
