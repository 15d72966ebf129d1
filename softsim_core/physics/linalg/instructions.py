"""Machine instructions that Numba has no functions for: vectors, atomic numbers, clock and scheduler.

Each is an intrinsic, which generates its own code (LLVM). Dense kernels are a few vector instructions in a
loop, where LLVM does not vectorise by itself, for the vector width of this processor.
"""

from __future__ import annotations

import os
from typing import Any

import llvmlite.binding as llvm
from llvmlite import ir
from numba import config, types
from numba.core import cgutils as numba_cgutils

from softsim_core.physics.linalg.compile import intrinsic


def _has_wide_vectors() -> bool:
    """Return whether kernels are compiled for AVX-512: on this processor, or as NUMBA_CPU_FEATURES says."""
    features = getattr(config, "CPU_FEATURES", None)
    if features is not None:
        return "+avx512f" in features
    return bool(llvm.get_host_cpu_features().get("avx512f", False))


def host_processor() -> tuple[str, str]:
    """Return name and features of the processor for which kernels are compiled."""
    name = os.environ.get("NUMBA_CPU_NAME") or llvm.get_host_cpu_name()
    return name, os.environ.get("NUMBA_CPU_FEATURES") or llvm.get_host_cpu_features().flatten()


LANES = 8 if _has_wide_vectors() else 4
"""Numbers per vector; rows of panels and updates are padded to multiples of it."""

ROWS = 4
"""Rows that one tile updates at once; LANES is a multiple of it."""

cgutils: Any = numba_cgutils
_DOUBLE, _SINGLE = ir.DoubleType(), ir.FloatType()
_FAST = ("contract", "reassoc", "nsz")


class Vectors:
    """Vector loads, stores and arithmetic on arrays of one type, in the code of one intrinsic.

    `array` is the type of the arrays, float64 or float32; None: float64.
    """

    def __init__(self, context: Any, builder: Any, lanes: int, array: Any = None) -> None:
        self.context, self.builder = context, builder
        single = array is not None and array.dtype == types.float32
        self.element, self.align = (_SINGLE, 4) if single else (_DOUBLE, 8)
        self.type = ir.VectorType(self.element, lanes)
        self._zeros = ir.Constant(ir.VectorType(ir.IntType(32), lanes), [0] * lanes)

    def data(self, array_type: Any, value: Any) -> Any:
        """Return the address of a contiguous array's first number."""
        return self.context.make_array(array_type)(self.context, self.builder, value).data

    def at(self, base: Any, place: Any) -> Any:
        """Return the address of number `place`."""
        return self.builder.gep(base, [place])

    def load(self, address: Any) -> Any:
        """Return the vector that starts at `address`, aligned like a single number."""
        return self.builder.load(self.builder.bitcast(address, self.type.as_pointer()), align=self.align)

    def store(self, vector: Any, address: Any) -> None:
        """Write a vector to `address`."""
        self.builder.store(vector, self.builder.bitcast(address, self.type.as_pointer()), align=self.align)

    def splat(self, number: Any) -> Any:
        """Return a vector of one number."""
        undefined = ir.Constant(self.type, ir.Undefined)
        one = self.builder.insert_element(undefined, number, ir.Constant(ir.IntType(32), 0))
        return self.builder.shuffle_vector(one, undefined, self._zeros)

    def multiply(self, a: Any, b: Any) -> Any:
        """Return the product, lane by lane."""
        return self.builder.fmul(a, b, flags=_FAST)

    def add(self, a: Any, b: Any) -> Any:
        """Return the sum, lane by lane."""
        return self.builder.fadd(a, b, flags=_FAST)

    def subtract(self, a: Any, b: Any) -> Any:
        """Return the difference, lane by lane."""
        return self.builder.fsub(a, b, flags=_FAST)

    def root(self, a: Any) -> Any:
        """Return the square root."""
        kind = ir.FunctionType(self.type, [self.type])
        return self.builder.call(self.function(kind, f"llvm.sqrt.v{self.type.count}f64"), [a])

    def function(self, kind: Any, name: str) -> Any:
        """Return one of LLVM's own functions."""
        return cgutils.get_or_insert_function(self.builder.module, kind, name)

    def less(self, a: Any, b: Any) -> Any:
        """Return whether a < b or one is NaN, lane by lane."""
        return self.builder.fcmp_unordered("<", a, b)

    def select(self, mask: Any, a: Any, b: Any) -> Any:
        """Return a where the mask is set, else b, lane by lane."""
        return self.builder.select(mask, a, b)

    def shuffle(self, a: Any, b: Any, order: list[int]) -> Any:
        """Return the numbers of a and b in a given order; the numbers of b are counted after those of a."""
        places = ir.Constant(ir.VectorType(ir.IntType(32), len(order)), order)
        return self.builder.shuffle_vector(a, b, places)

    def variable(self, vector: Any) -> Any:
        """Return a slot that stores a vector across loop iterations (LLVM keeps it in a register)."""
        slot = cgutils.alloca_once(self.builder, self.type)
        self.builder.store(vector, slot)
        return slot


def _tile(vectors: int) -> Any:
    """Return an intrinsic that subtracts a product of rows from a tile.

    The tile has ROWS rows and vectors * LANES columns.
    """

    @intrinsic
    def tile(
        typing: Any, target: Any, place: Any, stride: Any, source: Any, a: Any, b: Any, pitch: Any, count: Any
    ) -> Any:
        """target[place + i stride + j] -= sum_k source[a + k pitch + i] source[b + k pitch + j]."""
        signature = types.void(target, types.int64, types.int64, source, *(types.int64,) * 4)

        def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
            v = Vectors(context, builder, LANES, target)
            out, values = v.data(signature.args[0], args[0]), v.data(signature.args[3], args[3])
            _, place, stride, _, a, b, pitch, count = args
            integer = place.type
            goals = [
                [
                    v.at(
                        out,
                        builder.add(place, builder.add(builder.mul(stride, integer(i)), integer(LANES * j))),
                    )
                    for j in range(vectors)
                ]
                for i in range(ROWS)
            ]
            sums = [[v.variable(v.load(goal)) for goal in row] for row in goals]
            with cgutils.for_range(builder, count) as loop:
                row = builder.mul(loop.index, pitch)
                start = v.at(values, builder.add(b, row))
                columns = [v.load(v.at(start, integer(LANES * j))) for j in range(vectors)]
                first = v.at(values, builder.add(a, row))
                for i in range(ROWS):
                    factor = v.splat(builder.load(v.at(first, integer(i))))
                    for slot, column in zip(sums[i], columns, strict=True):
                        builder.store(v.subtract(builder.load(slot), v.multiply(factor, column)), slot)
            for slots, row_goals in zip(sums, goals, strict=True):
                for slot, goal in zip(slots, row_goals, strict=True):
                    v.store(builder.load(slot), goal)
            return context.get_dummy_value()

        return signature, generate

    return tile


tile_two = _tile(2)
tile_one = _tile(1)


@intrinsic
def solve_rows(typing: Any, array: Any, place: Any, stride: Any, coefficients: Any, length: Any) -> Any:
    """Substitute forward on ROWS rows of `array` at once, over `length` columns (a multiple of LANES).

    Row i of `coefficients` has l_i0 .. l_i,i-1 and, at [i], 1 / l_ii; shape (ROWS * ROWS,).
    """
    signature = types.void(array, types.int64, types.int64, coefficients, types.int64)

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        v = Vectors(context, builder, LANES, array)
        values, numbers = v.data(signature.args[0], args[0]), v.data(signature.args[3], args[3])
        _, place, stride, _, length = args
        integer = place.type
        factors = [
            [v.splat(builder.load(v.at(numbers, integer(ROWS * i + j)))) for j in range(i + 1)]
            for i in range(ROWS)
        ]
        starts = [v.at(values, builder.add(place, builder.mul(stride, integer(i)))) for i in range(ROWS)]
        with cgutils.for_range(builder, builder.sdiv(length, integer(LANES))) as loop:
            offset = builder.mul(loop.index, integer(LANES))
            done: list[Any] = []
            for i in range(ROWS):
                row = v.load(v.at(starts[i], offset))
                for j, earlier in enumerate(done):
                    row = v.subtract(row, v.multiply(factors[i][j], earlier))
                row = v.multiply(row, factors[i][i])
                v.store(row, v.at(starts[i], offset))
                done.append(row)
        return context.get_dummy_value()

    return signature, generate


@intrinsic
def add_to(typing: Any, target: Any, place: Any, source: Any, start: Any, count: Any) -> Any:
    """Add source[start + j] to target[place + j] for j < count; the arrays must not overlap there."""
    signature = types.void(target, types.int64, source, types.int64, types.int64)

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        out = Vectors(context, builder, 4, target)
        goal = out.at(out.data(signature.args[0], args[0]), args[1])
        data = out.at(out.data(signature.args[2], args[2]), args[3])
        count = args[4]
        integer = count.type
        whole = builder.sdiv(count, integer(4))
        with cgutils.for_range(builder, whole) as loop:
            place = builder.mul(loop.index, integer(4))
            at = out.at(goal, place)
            out.store(out.add(out.load(at), out.load(out.at(data, place))), at)
        done = builder.mul(whole, integer(4))
        with cgutils.for_range(builder, builder.sub(count, done)) as loop:
            place = builder.add(done, loop.index)
            at = out.at(goal, place)
            builder.store(builder.fadd(builder.load(at), builder.load(out.at(data, place))), at)
        return context.get_dummy_value()

    return signature, generate


@intrinsic
def add_block(typing: Any, panels: Any, start: Any, stride: Any, blocks: Any, place: Any, pitch: Any) -> Any:
    """Add a 3 x 3 block to three panel rows: panels[start + i stride + j] += blocks[place + i pitch + j].

    The block's rows have four numbers, the fourth zero, so that each row is one vector.
    """
    signature = types.void(panels, types.int64, types.int64, blocks, types.int64, types.int64)

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        v = Vectors(context, builder, 4)
        values, numbers = v.data(signature.args[0], args[0]), v.data(signature.args[3], args[3])
        _, start, stride, _, place, pitch = args
        rows = []
        for _ in range(3):
            goal, source = v.at(values, start), v.at(numbers, place)
            rows.append((v.add(v.load(goal), v.load(source)), goal))
            start, place = builder.add(start, stride), builder.add(place, pitch)
        for row, goal in rows:
            v.store(row, goal)
        return context.get_dummy_value()

    return signature, generate


@intrinsic
def dot_product(typing: Any, a: Any, i: Any, b: Any, j: Any, count: Any) -> Any:
    """Return sum_k a[i + k] b[j + k], k < count."""
    signature = types.float64(a, types.int64, b, types.int64, types.int64)

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        v = Vectors(context, builder, LANES)
        first = v.at(v.data(signature.args[0], args[0]), args[1])
        second = v.at(v.data(signature.args[2], args[2]), args[3])
        count = args[4]
        integer = count.type
        zero = ir.Constant(v.type, [0.0] * LANES)
        sums = [v.variable(zero), v.variable(zero)]
        whole = builder.sdiv(count, integer(2 * LANES))
        with cgutils.for_range(builder, whole) as loop:
            for part, slot in enumerate(sums):
                place = builder.add(builder.mul(loop.index, integer(2 * LANES)), integer(part * LANES))
                product = v.multiply(v.load(v.at(first, place)), v.load(v.at(second, place)))
                builder.store(v.add(builder.load(slot), product), slot)
        both = v.add(builder.load(sums[0]), builder.load(sums[1]))
        total = cgutils.alloca_once_value(builder, ir.Constant(_DOUBLE, 0.0))
        for lane in range(LANES):
            number = builder.extract_element(both, ir.IntType(32)(lane))
            builder.store(builder.fadd(builder.load(total), number, flags=_FAST), total)
        done = builder.mul(whole, integer(2 * LANES))
        with cgutils.for_range(builder, builder.sub(count, done)) as loop:
            place = builder.add(done, loop.index)
            product = builder.fmul(
                builder.load(v.at(first, place)), builder.load(v.at(second, place)), flags=_FAST
            )
            builder.store(builder.fadd(builder.load(total), product, flags=_FAST), total)
        return builder.load(total)

    return signature, generate


@intrinsic
def steady_seconds(typing: Any) -> Any:
    """Return the seconds on the steady clock (clock_gettime), as time.perf_counter reads it."""
    signature = types.float64()

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        long, monotonic = ir.IntType(64), 1
        pair = ir.ArrayType(long, 2)  # struct timespec where long and time_t have 64 bits
        slot = cgutils.alloca_once(builder, pair)
        kind = ir.FunctionType(ir.IntType(32), [ir.IntType(32), pair.as_pointer()])
        clock = cgutils.get_or_insert_function(builder.module, kind, "clock_gettime")
        builder.call(clock, [ir.IntType(32)(monotonic), slot])
        value = builder.load(slot)
        seconds, nanoseconds = (builder.sitofp(builder.extract_value(value, i), _DOUBLE) for i in range(2))
        return builder.fadd(seconds, builder.fmul(nanoseconds, _DOUBLE(1e-9)))

    return signature, generate


_LONG, _ALIGN = types.int64, 8


def _address(context: Any, builder: Any, kind: Any, array: Any, place: Any) -> Any:
    return builder.gep(context.make_array(kind)(context, builder, array).data, [place])


@intrinsic
def atomic_load(typing: Any, numbers: Any, place: Any) -> Any:
    """Return numbers[place]; everything that its writer wrote before is visible afterwards (acquire)."""

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        address = _address(context, builder, signature.args[0], args[0], args[1])
        return builder.load_atomic(address, "acquire", _ALIGN)

    return _LONG(numbers, _LONG), generate


@intrinsic
def atomic_store(typing: Any, numbers: Any, place: Any, value: Any) -> Any:
    """Set numbers[place] = value; a reader of it sees everything that was written before (release)."""

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        address = _address(context, builder, signature.args[0], args[0], args[1])
        builder.store_atomic(args[2], address, "release", _ALIGN)
        return context.get_dummy_value()

    return types.void(numbers, _LONG, _LONG), generate


@intrinsic
def atomic_add(typing: Any, numbers: Any, place: Any, value: Any) -> Any:
    """Add a value to numbers[place] and return what it was before."""

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        address = _address(context, builder, signature.args[0], args[0], args[1])
        return builder.atomic_rmw("add", address, args[2], "acq_rel")

    return _LONG(numbers, _LONG, _LONG), generate


@intrinsic
def atomic_exchange(typing: Any, numbers: Any, place: Any, expected: Any, value: Any) -> Any:
    """Set numbers[place] = value if it is as expected; return whether it was."""

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        address = _address(context, builder, signature.args[0], args[0], args[1])
        result = builder.cmpxchg(address, args[2], args[3], "acq_rel", "acquire")
        return builder.extract_value(result, 1)

    return types.boolean(numbers, _LONG, _LONG, _LONG), generate


@intrinsic
def give_way(typing: Any) -> Any:
    """Yield the core to another waiting thread, if any (sched_yield)."""

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        kind = ir.FunctionType(ir.IntType(32), [])
        builder.call(cgutils.get_or_insert_function(builder.module, kind, "sched_yield"), [])
        return context.get_dummy_value()

    return types.void(), generate
