"""Numbers that threads agree by: atomic operations on an array of int64, for kernels."""

from __future__ import annotations

from typing import Any

from llvmlite import ir
from numba import types
from numba.core import cgutils as numba_cgutils

from softsim_core.linalg.compile import intrinsic

cgutils: Any = numba_cgutils
_INT, _ALIGN = types.int64, 8


def _address(context: Any, builder: Any, kind: Any, array: Any, place: Any) -> Any:
    return builder.gep(context.make_array(kind)(context, builder, array).data, [place])


@intrinsic
def atomic_load(typing: Any, numbers: Any, place: Any) -> Any:
    """numbers[place]; what its writer wrote before it is seen by what comes after this."""

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        address = _address(context, builder, signature.args[0], args[0], args[1])
        return builder.load_atomic(address, "acquire", _ALIGN)

    return _INT(numbers, _INT), generate


@intrinsic
def atomic_store(typing: Any, numbers: Any, place: Any, value: Any) -> Any:
    """numbers[place] = value; whoever reads it sees what was written before."""

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        address = _address(context, builder, signature.args[0], args[0], args[1])
        builder.store_atomic(args[2], address, "release", _ALIGN)
        return context.get_dummy_value()

    return types.void(numbers, _INT, _INT), generate


@intrinsic
def atomic_add(typing: Any, numbers: Any, place: Any, value: Any) -> Any:
    """numbers[place] += value; what it was before."""

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        address = _address(context, builder, signature.args[0], args[0], args[1])
        return builder.atomic_rmw("add", address, args[2], "acq_rel")

    return _INT(numbers, _INT, _INT), generate


@intrinsic
def atomic_exchange(typing: Any, numbers: Any, place: Any, expected: Any, value: Any) -> Any:
    """numbers[place] = value if it was as expected; whether it was."""

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        address = _address(context, builder, signature.args[0], args[0], args[1])
        result = builder.cmpxchg(address, args[2], args[3], "acq_rel", "acquire")
        return builder.extract_value(result, 1)

    return types.boolean(numbers, _INT, _INT, _INT), generate


@intrinsic
def give_way(typing: Any) -> Any:
    """Let another thread have the core, if one waits for it (sched_yield)."""

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        kind = ir.FunctionType(ir.IntType(32), [])
        builder.call(cgutils.get_or_insert_function(builder.module, kind, "sched_yield"), [])
        return context.get_dummy_value()

    return types.void(), generate
