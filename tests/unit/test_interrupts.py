"""Ctrl-C while kernels are compiled."""

from __future__ import annotations

import signal
from collections.abc import Iterator

import pytest
from node_processes import spin_until

from softsim_ros.interrupts import put_off_in_callbacks


@pytest.fixture(autouse=True)
def pythons_own_handler() -> Iterator[None]:
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    put_off_in_callbacks()
    yield
    signal.signal(signal.SIGINT, before)


@pytest.mark.numba
def test_an_interrupt_in_a_callback_of_the_compiler_comes_after_it(
    capfd: pytest.CaptureFixture[str],
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
    with pytest.raises(KeyboardInterrupt):  # noqa: PT012
        engine.finalize_object()
        spin_until(lambda: False)
    assert len(kept) == 1
    assert capfd.readouterr().err == ""


def test_any_other_interrupt_comes_at_once() -> None:
    with pytest.raises(KeyboardInterrupt):
        signal.raise_signal(signal.SIGINT)


def test_a_handler_of_somebody_else_stays() -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    put_off_in_callbacks()
    assert signal.getsignal(signal.SIGINT) is signal.SIG_IGN
