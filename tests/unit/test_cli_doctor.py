"""The doctor's findings: what it says, and when it calls something broken."""

from __future__ import annotations

import argparse
import os
from pathlib import Path

import pytest

from softsim_ros.cli.upkeep import Finding, Level, doctor


def report(port: str = "") -> int:
    return doctor.run(argparse.Namespace(port=port))


def test_a_line_for_everything_and_the_sum_last(capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("rclpy")
    report()
    shown = capsys.readouterr().out
    for subject in (
        "Python",
        "packages",
        "numba",
        "configs",
        "ROS 2",
        "discovery",
        "logs",
        "board",
        "virtual board",
        "emulated board",
        "avrdude",
    ):
        assert f"  {subject}: " in shown
    assert " checks, " in shown.splitlines()[-1]


def test_only_what_is_broken_fails(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(doctor, "CHECKS", (lambda: [Finding(Level.WARNING, "a", "odd", "mind it")],))
    assert report() == 0
    monkeypatch.setattr(doctor, "CHECKS", (lambda: [Finding(Level.PROBLEM, "b", "gone", "mend it")],))
    assert report() == 1
    shown = capsys.readouterr().out
    assert "warn  a: odd\n      -> mind it" in shown
    assert "FAIL  b: gone\n      -> mend it" in shown


def test_a_check_that_fails_is_a_finding(monkeypatch: pytest.MonkeyPatch) -> None:
    def broken() -> list[Finding]:
        raise OSError("no such thing")

    monkeypatch.setattr(doctor, "CHECKS", (broken,))
    (finding,) = doctor.examine()
    assert finding.level is Level.PROBLEM
    assert "no such thing" in finding.text


def test_a_named_port_that_is_not_there(tmp_path: Path) -> None:
    (finding,) = doctor.check_board(str(tmp_path / "ttyACM9"))
    assert finding.level is Level.PROBLEM
    assert "does not exist" in finding.text


@pytest.mark.skipif(os.getuid() == 0, reason="root may use every port")
def test_a_port_without_permission(tmp_path: Path) -> None:
    port = tmp_path / "ttyACM0"
    port.touch(mode=0)
    (finding,) = doctor.check_board(str(port))
    assert "usermod -aG dialout" in finding.advice


def test_configs_are_missed_and_bad_robots_are_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "robots").mkdir()
    (tmp_path / "robots" / "crooked.yaml").write_text("name: crooked\nbodys: []\n")
    monkeypatch.setenv("SOFTSIM_CONFIG_PATH", str(tmp_path))
    found = doctor.check_configs()
    assert found[0].level is Level.OK
    assert str(tmp_path) in found[0].text
    assert any(each.subject == "robot crooked" and each.level is Level.PROBLEM for each in found)


def test_an_open_network_is_a_warning(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SOFTSIM_DISCOVERY_RANGE", "SUBNET")
    assert doctor.check_reach()[0].level is Level.WARNING
    monkeypatch.delenv("SOFTSIM_DISCOVERY_RANGE")
    assert doctor.check_reach()[0].level is Level.OK


def test_logs_that_cannot_be_written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    blocked = tmp_path / "file"
    blocked.touch()
    monkeypatch.setenv("ROS_LOG_DIR", str(blocked / "log"))
    assert doctor.check_log_folder()[0].level is Level.PROBLEM


def test_what_only_a_board_needs_is_no_fault_where_it_is_missing(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PATH", "")
    (finding,) = doctor.check_flashing()
    assert finding.level is Level.OK
    assert "apt install avrdude" in finding.advice
    monkeypatch.setattr(doctor, "why_missing", lambda: "libsimavr is missing; install it")
    (finding,) = doctor.check_emulated_board()
    assert finding.level is Level.OK
    assert "install it" in finding.text


def test_what_is_lost_without_each_optional_package_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    installed = {finding.subject: finding.level for finding in doctor.check_optional_packages()}
    mesh = {"pytetwild", "fast-simplification"}
    assert set(installed) == {"c3d", "daqp", "viser", "rosbags", "matplotlib", "urdfdom_py", "xacro"} | mesh
    monkeypatch.setattr(doctor.importlib.util, "find_spec", lambda name: None)
    missing = {finding.subject: finding for finding in doctor.check_optional_packages()}
    assert all(finding.level is Level.WARNING for finding in missing.values())
    for package, lost in (("daqp", "inverse control"), ("viser", "web page"), ("rosbags", "record, replay")):
        assert f"without it no {lost}" in missing[package].text
        assert f"pip install {package}" in missing[package].advice
