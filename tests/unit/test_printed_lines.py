"""Lines that one thread prints are heard, those of others go where they went before."""

from __future__ import annotations

import sys
import threading

import pytest
from waiting import DEADLINE_S

pytest.importorskip("rclpy")

from softsim_ros.nodes.simulator import printed_lines

pytestmark = pytest.mark.ros


def test_whole_lines_are_heard_and_empty_ones_are_not(capsys: pytest.CaptureFixture[str]) -> None:
    heard: list[str] = []
    usual = sys.stdout
    with printed_lines(heard.append):
        print("one", 2, end="")
        print(" three\n\nfour")
        print("five", end="", flush=True)
        assert heard == ["one 2 three", "four"]
    assert heard == ["one 2 three", "four", "five"]
    assert sys.stdout is usual
    print("six")
    assert capsys.readouterr().out == "six\n"


def test_a_failure_gives_standard_output_back() -> None:
    usual, heard = sys.stdout, []

    def fail() -> None:
        with printed_lines(heard.append):
            print("before")
            raise ValueError("stop")

    with pytest.raises(ValueError, match="stop"):
        fail()
    assert heard == ["before"]
    assert sys.stdout is usual


def test_threads_are_kept_apart(capsys: pytest.CaptureFixture[str]) -> None:
    usual = sys.stdout
    heard: dict[str, list[str]] = {"a": [], "b": []}
    meet = threading.Barrier(3, timeout=DEADLINE_S)

    def work(name: str) -> None:
        with printed_lines(heard[name].append):
            meet.wait()
            print(f"{name} speaks")
            meet.wait()

    threads = [threading.Thread(target=work, args=(name,)) for name in heard]
    for thread in threads:
        thread.start()
    meet.wait()
    print("this thread is nobody's")
    meet.wait()
    for thread in threads:
        thread.join(DEADLINE_S)
    assert heard == {"a": ["a speaks"], "b": ["b speaks"]}
    assert sys.stdout is usual
    assert capsys.readouterr().out == "this thread is nobody's\n"
