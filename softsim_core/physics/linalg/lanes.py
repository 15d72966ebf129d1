"""Numbers of LANES cells in one vector register, as a type of compiled code.

A kernel computes with a register as with a number: `row(array, i)` loads one, `+ - * /` and comparisons work
lane by lane, `where` chooses by lane, and `put(array, i, a)` stores one. LLVM does not vectorise the long
formulas of elasticity by itself; written for registers, they compute four or eight cells at once.

Arrays are C-contiguous, in rows of LANES numbers that are counted from the array's first number on. A number
that meets a register is the same in all lanes. Comparisons with NaN are false.
"""

# mypy: disallow-untyped-calls=False, disallow-subclassing-any=False

from __future__ import annotations

import operator
from collections.abc import Callable
from typing import Any

from llvmlite import ir
from numba import types
from numba.core.typeconv.castgraph import Conversion
from numba.core.typing.templates import AbstractTemplate, infer_global, signature
from numba.extending import lower_builtin, lower_cast, models, register_model

from softsim_core.physics.linalg.compile import intrinsic
from softsim_core.physics.linalg.instructions import LANES, Vectors


class _Register(types.Type):
    """LANES numbers of type float64."""

    def can_convert_from(self, typing: Any, other: Any) -> Any:
        return Conversion.promote if _is_number(other) else None


class _Mask(types.Type):
    """LANES truth values."""


def _is_number(kind: Any) -> bool:
    return isinstance(kind, types.Number) and not isinstance(kind, types.Literal)


REGISTER, MASK = _Register("register"), _Mask("mask")
TRIPLE = types.UniTuple(REGISTER, 3)


@register_model(_Register)
class _RegisterModel(models.PrimitiveModel):
    def __init__(self, manager: Any, kind: Any) -> None:
        super().__init__(manager, kind, ir.VectorType(ir.DoubleType(), LANES))


@register_model(_Mask)
class _MaskModel(models.PrimitiveModel):
    def __init__(self, manager: Any, kind: Any) -> None:
        super().__init__(manager, kind, ir.VectorType(ir.IntType(1), LANES))


@lower_cast(types.Number, _Register)
def _number_in_all_lanes(context: Any, builder: Any, number_type: Any, register: Any, value: Any) -> Any:
    number = context.cast(builder, value, number_type, types.float64)
    return Vectors(context, builder, LANES).splat(number)


def _operator(function: Callable[..., Any], kinds: tuple[Any, ...], result: Any, build: Any) -> None:
    """Define an operator of registers or masks, whose code `build` generates."""

    class Operator(AbstractTemplate):
        key = function

        def generic(self, arguments: Any, named: Any) -> Any:
            fits = len(arguments) == len(kinds) and any(each in kinds for each in arguments)
            fits = fits and all(
                each == kind or (kind == REGISTER and _is_number(each))
                for each, kind in zip(arguments, kinds, strict=False)
            )
            return signature(result, *kinds) if fits else None

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        return build(Vectors(context, builder, LANES), *args)

    infer_global(function)(Operator)
    lower_builtin(function, *(type(kind) for kind in kinds))(generate)


def _comparison(symbol: str) -> Callable[..., Any]:
    return lambda v, a, b: v.builder.fcmp_ordered(symbol, a, b)


_TWO = (REGISTER, REGISTER)
_operator(operator.add, _TWO, REGISTER, lambda v, a, b: v.add(a, b))
_operator(operator.sub, _TWO, REGISTER, lambda v, a, b: v.subtract(a, b))
_operator(operator.mul, _TWO, REGISTER, lambda v, a, b: v.multiply(a, b))
_operator(operator.truediv, _TWO, REGISTER, lambda v, a, b: v.builder.fdiv(a, b))
_operator(operator.neg, _TWO[:1], REGISTER, lambda v, a: v.builder.fneg(a))
_operator(operator.lt, _TWO, MASK, _comparison("<"))
_operator(operator.le, _TWO, MASK, _comparison("<="))
_operator(operator.gt, _TWO, MASK, _comparison(">"))
_operator(operator.ge, _TWO, MASK, _comparison(">="))
_operator(operator.eq, _TWO, MASK, _comparison("=="))
_operator(operator.and_, (MASK, MASK), MASK, lambda v, a, b: v.builder.and_(a, b))
_operator(operator.or_, (MASK, MASK), MASK, lambda v, a, b: v.builder.or_(a, b))
_operator(operator.invert, (MASK,), MASK, lambda v, a: v.builder.not_(a))


@intrinsic
def where(typing: Any, mask: Any, a: Any, b: Any) -> Any:
    """Return a where the mask, or one truth value for all lanes, is set; else b."""

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        return builder.select(*args)

    return REGISTER(MASK if mask == MASK else types.boolean, REGISTER, REGISTER), generate


@intrinsic
def root(typing: Any, a: Any) -> Any:
    """Return the square root."""

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        return Vectors(context, builder, LANES).root(args[0])

    return REGISTER(REGISTER), generate


@intrinsic
def bits_of(typing: Any, mask: Any) -> Any:
    """Return a mask as a number, lane i in bit i."""

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        return builder.zext(builder.bitcast(args[0], ir.IntType(LANES)), ir.IntType(64))

    return types.int64(MASK), generate


def _row(context: Any, builder: Any, kind: Any, array: Any, index: Any) -> tuple[Vectors, Any]:
    """Return the vectors and the address of a row."""
    v = Vectors(context, builder, LANES)
    return v, v.at(v.data(kind, array), builder.mul(index, index.type(LANES)))


@intrinsic
def row(typing: Any, array: Any, index: Any) -> Any:
    """Return row `index` of an array."""

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        v, address = _row(context, builder, signature.args[0], *args)
        return v.load(address)

    return REGISTER(array, types.int64), generate


@intrinsic
def put(typing: Any, array: Any, index: Any, a: Any) -> Any:
    """Write row `index` of an array."""

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        v, address = _row(context, builder, signature.args[0], *args[:2])
        v.store(args[2], address)
        return context.get_dummy_value()

    return types.void(array, types.int64, REGISTER), generate


def _nodes(v: Vectors, kind: Any, nodes: Any, index: Any) -> list[Any]:
    """Return the LANES numbers of row `index` of an array of integers."""
    builder, base = v.builder, v.data(kind, nodes)
    first = builder.mul(index, index.type(LANES))
    return [builder.load(v.at(base, builder.add(first, index.type(lane)))) for lane in range(LANES)]


@intrinsic
def gather(typing: Any, values: Any, nodes: Any, index: Any) -> Any:
    """Return three registers with rows of an array (n, 3), one for each lane, by row `index` of `nodes`."""

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        v, kinds = Vectors(context, builder, LANES), signature.args
        base = v.data(kinds[0], args[0])
        quad, bits = ir.VectorType(ir.DoubleType(), 4), ir.VectorType(ir.IntType(1), 4)
        pointer = quad.as_pointer()
        kind = ir.FunctionType(quad, [pointer, ir.IntType(32), bits, quad])
        load = v.function(kind, "llvm.masked.load.v4f64.p0v4f64")  # reads nothing beyond the array
        three, undefined = ir.Constant(bits, [1, 1, 1, 0]), ir.Constant(quad, ir.Undefined)
        rows = []
        for node in _nodes(v, kinds[1], *args[1:]):
            address = builder.bitcast(v.at(base, builder.mul(node, node.type(3))), pointer)
            rows.append(builder.call(load, [address, ir.IntType(32)(8), three, undefined]))
        parts: list[list[Any]] = []  # four lanes each: (x0 .. x3, y0 .. y3) and (z0 .. z3, undefined)
        for lane in range(0, LANES, 4):
            pairs = [v.shuffle(rows[lane + i], rows[lane + i + 1], list(range(8))) for i in (0, 2)]
            parts.append([])
            for i, j in ((0, 1), (2, 2)):
                order = [i, i + 4, i + 8, i + 12, j, j + 4, j + 8, j + 12]
                parts[-1].append(v.shuffle(pairs[0], pairs[1], order))
        result = []
        for which, first in ((0, 0), (0, 4), (1, 0)):
            order = [8 * part + first + i for part in range(len(parts)) for i in range(4)]
            result.append(v.shuffle(parts[0][which], parts[-1][which], order))
        return context.make_tuple(builder, signature.return_type, result)

    return TRIPLE(values, nodes, types.int64), generate


def _transposed(v: Vectors, triple: list[Any]) -> list[Any]:
    """Return pieces of LANES / 4 lanes, one register each, with numbers (a, b, c, 0) for every lane."""
    half = LANES // 2
    low = [lane + LANES * side for lane in range(half) for side in (0, 1)]
    high = [lane + LANES * side for lane in range(half, LANES) for side in (0, 1)]
    first, second, third = triple
    none = ir.Constant(v.type, [0.0] * LANES)
    pieces = []
    for order in (low, high):
        even, odd = v.shuffle(first, third, order), v.shuffle(second, none, order)
        pieces += [v.shuffle(even, odd, places) for places in (low, high)]
    return pieces


@intrinsic
def put_quads(typing: Any, array: Any, index: Any, triple: Any) -> Any:
    """Write (a, b, c, 0) of each lane, one lane after the other, to four rows of an array from `index` on."""

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        v, address = _row(context, builder, signature.args[0], *args[:2])
        triple = [builder.extract_value(args[2], i) for i in range(3)]
        for piece, numbers in enumerate(_transposed(v, triple)):
            v.store(numbers, v.at(address, ir.IntType(64)(LANES * piece)))
        return context.get_dummy_value()

    return types.void(array, types.int64, TRIPLE), generate


@intrinsic
def subtract_at(typing: Any, values: Any, nodes: Any, index: Any, triple: Any) -> Any:
    """Subtract (a, b, c) of each lane, one after the other, from rows of an array (n, 4); see `gather`."""

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        v, quad, kinds = Vectors(context, builder, LANES), Vectors(context, builder, 4), signature.args
        base, lanes = v.data(kinds[0], args[0]), LANES // 4
        numbers = _nodes(v, kinds[1], *args[1:3])
        triple = [builder.extract_value(args[3], i) for i in range(3)]
        for piece, rows in enumerate(_transposed(v, triple)):
            for part in range(lanes):
                own = v.shuffle(rows, rows, list(range(4 * part, 4 * part + 4)))
                node = numbers[lanes * piece + part]
                address = quad.at(base, builder.mul(node, node.type(4)))
                quad.store(quad.subtract(quad.load(address), own), address)
        return context.get_dummy_value()

    return types.void(values, nodes, types.int64, TRIPLE), generate
