"""A request to end: looked at between steps, raised where nothing has to be closed, never lost or doubled."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from node_processes import spin_until

from softsim_core.base import in_processes, usable_cores
from softsim_node import END_SIGNALS, Ending


@pytest.fixture
def ending() -> Iterator[Ending]:
    own = Ending()
    signal.signal(signal.SIGHUP, signal.SIG_DFL)
    own.watch()
    return own


@pytest.mark.skipif(sys.platform != "linux" or usable_cores() < 2, reason="forks on Linux with two cores")
def test_forked_processes_end_at_the_request_of_this_one_without_a_word(ending: Ending) -> None:
    with ending.interruptible():
        handlers = list(in_processes(lambda _: [signal.getsignal(each) for each in (2, 15)], range(4)))
    assert handlers == [[signal.SIG_IGN, signal.SIG_DFL]] * 4


@pytest.mark.parametrize("number", END_SIGNALS)
def test_a_signal_is_a_request_that_is_looked_at(ending: Ending, number: signal.Signals) -> None:
    assert not ending.asked
    for _ in range(3):
        signal.raise_signal(number)
    assert ending.asked


def test_inside_interruptible_the_first_signal_raises_and_no_other(ending: Ending) -> None:
    with pytest.raises(KeyboardInterrupt), ending.interruptible():  # noqa: PT012
        try:
            signal.raise_signal(signal.SIGTERM)
        finally:
            signal.raise_signal(signal.SIGINT)  # on the way out
    assert ending.asked


def test_a_request_from_before_raises_at_once(ending: Ending) -> None:
    with ending.interruptible():
        with ending.orderly():
            signal.raise_signal(signal.SIGINT)
        with pytest.raises(KeyboardInterrupt), ending.interruptible():
            pytest.fail("went on")


def test_the_end_of_the_parent_is_a_request(ending: Ending, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "getppid", lambda: 1)
    assert ending.asked
    assert ending.is_orphan


@pytest.mark.parametrize("how", ["nohup", "environment"])
def test_a_process_may_outlive_its_parent_where_it_was_started_to(
    monkeypatch: pytest.MonkeyPatch, how: str
) -> None:
    signal.signal(signal.SIGHUP, signal.SIG_IGN if how == "nohup" else signal.SIG_DFL)
    monkeypatch.setenv("SOFTSIM_OUTLIVE_PARENT", "0" if how == "nohup" else "1")
    own = Ending()
    own.watch()
    monkeypatch.setattr(os, "getppid", lambda: 1)
    assert not own.asked
    signal.raise_signal(signal.SIGHUP)
    assert own.asked == (how == "environment")


def test_when_all_is_closed_signals_are_ignored(ending: Ending) -> None:
    ending.over()
    assert {signal.getsignal(number) for number in END_SIGNALS} == {signal.SIG_IGN}


@pytest.mark.numba
def test_an_interrupt_in_a_callback_of_the_compiler_comes_after_it(
    ending: Ending, capfd: pytest.CaptureFixture[str]
) -> None:
    llvm = pytest.importorskip("llvmlite.binding")
    llvm.initialize_native_target()
    llvm.initialize_native_asmprinter()
    module = llvm.parse_assembly("define i32 @one() { ret i32 1 }")
    engine = llvm.create_mcjit_compiler(module, llvm.Target.from_default_triple().create_target_machine())
    kept = []

    def keep(_: object, compiled: bytes) -> None:
        signal.raise_signal(signal.SIGINT)
        kept.append(compiled)

    engine.set_object_cache(keep, lambda _: None)
    with pytest.raises(KeyboardInterrupt), ending.interruptible():  # noqa: PT012
        engine.finalize_object()
        spin_until(lambda: False)
    assert len(kept) == 1
    assert capfd.readouterr().err == ""


INTERRUPTED = """
import atexit, ctypes, os, signal, sys, threading
from softsim_node import ending

begun = threading.Event()
atexit.register(print, "the interpreter took its data away")

def compile_kernels():
    begun.set()
    ctypes.CDLL(None).sleep(600)  # what the compiler looks like from Python

def interrupt():
    begun.wait()
    os.kill(os.getpid(), signal.SIGINT)

ending.watch()
threading.Thread(target=interrupt).start()
try:
    with CONTEXT():
        ending.abandonable(compile_kernels)
except KeyboardInterrupt:
    sys.exit(ending.leave(7))
"""


@pytest.mark.parametrize("context", ["ending.interruptible", "ending.orderly"])
def test_work_that_is_left_behind_ends_with_the_process_at_once(context: str) -> None:
    """Also where the signal raises: an interpreter that ends in its own way would crash the compiler."""
    code = INTERRUPTED.replace("CONTEXT", context)
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, timeout=60, check=False
    )
    assert (done.returncode, done.stdout, done.stderr) == (7, "", "")


def test_a_file_that_a_controller_keeps_open_is_complete_after_the_exit(tmp_path: Path) -> None:
    """A reference cycle is closed by the last search for garbage, which nothing may leave out."""
    program = f"""
import softsim_node.signals, softsim_node.program
class Controller:
    def __init__(self):
        self.own, self.file = self, open({str(tmp_path / "rows.csv")!r}, "w")
        self.file.write("row")
controller = Controller()
"""
    subprocess.run([sys.executable, "-c", program], check=True)
    assert (tmp_path / "rows.csv").read_text() == "row"
