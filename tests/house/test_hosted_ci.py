"""What runs on other machines only: workflows, image, development container name what is there."""

from __future__ import annotations

import argparse
import json
import re
import shlex
from pathlib import Path
from typing import Any

import pytest
import yaml

from softsim_ros.cli import COMMANDS, Parser

REPOSITORY = Path(__file__).resolve().parents[2]
WORKFLOWS = sorted((REPOSITORY / ".github" / "workflows").glob("*.yml"))
PLACES = re.compile(r"(?<![\w/.-])(?:\./softsim|(?:\.ci|tests|examples|ros2_ws|docs)/[\w./-]+)")
MADE = re.compile(r"/(install|\.venv|build)(/|$)")
"""Made by the steps themselves."""


def steps(workflow: Path) -> list[tuple[str, dict[str, Any]]]:
    jobs = yaml.safe_load(workflow.read_text())["jobs"]
    return [(name, step) for name, job in jobs.items() for step in job["steps"]]


def parsed(words: list[str]) -> argparse.Namespace:
    """The words of a `softsim` command, as the command takes them."""
    parser = Parser(prog=words[0])
    COMMANDS[words[0]].import_module().configure(parser)
    return parser.parse_args(words[1:])  # type: ignore[no-any-return]


@pytest.mark.parametrize("workflow", WORKFLOWS, ids=lambda file: file.stem)
def test_steps_run_what_the_repository_has(workflow: Path) -> None:
    found = 0
    for job, step in steps(workflow):
        assert ("uses" in step) != ("run" in step), job
        for line in step.get("run", "").splitlines():
            for place in PLACES.findall(line):
                assert MADE.search(place) or (REPOSITORY / place).exists(), (job, place)
            for command in re.findall(r"(?:\./|bin/| )softsim (\w[^|&;>\"]*)", f" {line}"):
                words = shlex.split(command)
                if words[0] in COMMANDS and not COMMANDS[words[0]].passes_on:
                    parsed(words)
            found += 1
    assert found


def test_every_python_that_is_promised_is_tested() -> None:
    project = (REPOSITORY / "pyproject.toml").read_text()
    promised = set(re.findall(r"Programming Language :: Python :: (3\.\d+)", project))
    jobs = yaml.safe_load((REPOSITORY / ".github" / "workflows" / "ci.yml").read_text())["jobs"]
    tested = set(jobs["quick"]["strategy"]["matrix"]["python"])
    tested |= {
        step["with"]["python-version"]
        for step in jobs["suite"]["steps"]
        if "python-version" in step.get("with", {})
    }
    assert tested == promised


def test_the_image_starts_a_robot_whose_page_is_reached() -> None:
    text = (REPOSITORY / "Dockerfile").read_text()
    words = [*json.loads(text.split("ENTRYPOINT ")[1].splitlines()[0]), *json.loads(text.split("CMD ")[1])]
    assert words[0] == "softsim"
    arguments = parsed(words[1:])
    exposed = int(re.findall(r"^EXPOSE (\d+)", text, re.MULTILINE)[0])
    assert (arguments.host, arguments.port, arguments.no_token) == ("0.0.0.0", exposed, False)
    for file in (REPOSITORY / "Dockerfile", REPOSITORY / ".github" / "workflows" / "ci.yml"):
        (run,) = re.findall(r"docker run .*", file.read_text())
        assert (
            f"--hostname localhost -p 127.0.0.1:{exposed}:{exposed} softsim" in run
        )  # reached from here only


@pytest.mark.parametrize("workflow", WORKFLOWS, ids=lambda file: file.stem)
def test_no_step_can_write_to_the_repository(workflow: Path) -> None:
    data = yaml.safe_load(workflow.read_text())
    assert data["permissions"] == {"contents": "read"}
    assert not any("permissions" in job for job in data["jobs"].values())
    for _, step in steps(workflow):
        if step.get("uses", "").startswith("actions/checkout@"):
            assert step["with"]["persist-credentials"] is False


@pytest.mark.parametrize("workflow", WORKFLOWS, ids=lambda file: file.stem)
def test_actions_are_commits_beside_the_tag_that_they_had(workflow: Path) -> None:
    used = re.findall(r"uses: *(.+)", workflow.read_text())
    assert used
    pinned = re.compile(r"[\w./-]+@[0-9a-f]{40} # v\d+\.\d+\.\d+")
    assert [each for each in used if not pinned.fullmatch(each)] == []


def test_the_image_runs_as_an_ordinary_user_on_a_fixed_release() -> None:
    lines = (REPOSITORY / "Dockerfile").read_text().splitlines()
    (base,) = (line for line in lines if line.startswith("FROM "))
    assert re.fullmatch(r"FROM python:3\.\d+\.\d+-slim-[a-z]+@sha256:[0-9a-f]{64}", base)
    user = lines.index("USER softsim")
    assert not [line for line in lines[user:] if "root" in line]
    assert lines.index('ENTRYPOINT ["softsim"]') > user


def test_the_development_container_makes_the_environment() -> None:
    container = json.loads((REPOSITORY / ".devcontainer" / "devcontainer.json").read_text())
    assert container["postCreateCommand"].startswith("./softsim doctor")
    from softsim_ros.cli.running import PAGE_PORT

    assert container["forwardPorts"] == [PAGE_PORT]
    interpreter = container["customizations"]["vscode"]["settings"]["python.defaultInterpreterPath"]
    assert interpreter == ".softsim/venv/bin/python"  # that of ./softsim
