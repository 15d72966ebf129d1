"""What `softsim up` says of its page: the address, why there is none, or nothing where the robot ended."""

from __future__ import annotations

import sys
from pathlib import Path
from types import SimpleNamespace

import pytest

from softsim_ros.cli.running import PageChoice, WebPage, web_page

pytest.importorskip("viser")


def page(folder: Path, monkeypatch: pytest.MonkeyPatch, viewer: str) -> WebPage:
    """A page whose viewer is a shell's line."""
    program = folder / "viewer"
    program.write_text(f"#!/bin/sh\n{viewer}\n")
    program.chmod(0o700)
    monkeypatch.setattr(sys, "executable", str(program))
    return WebPage("tripod", "tripod", PageChoice("127.0.0.1", 8080))


def test_the_address(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with page(tmp_path, monkeypatch, "echo viewer: http://127.0.0.1:8080; exec sleep 60") as shown:
        assert shown.notice() == "open http://127.0.0.1:8080 in a browser"


def test_why_there_is_none(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with page(tmp_path, monkeypatch, "echo viewer: port 8080 is taken") as shown:
        assert shown.notice() == "no web page: port 8080 is taken"
    monkeypatch.setattr(web_page, "START_WITHIN_S", 0.0)
    with page(tmp_path, monkeypatch, "exec sleep 60") as shown:
        assert shown.notice() == "no web page: it did not start within 0 s"


def test_a_robot_that_ends_before_says_nothing_of_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(web_page, "ending", SimpleNamespace(asked=True))
    with page(tmp_path, monkeypatch, "exec sleep 60") as shown:
        assert shown.notice() == ""
