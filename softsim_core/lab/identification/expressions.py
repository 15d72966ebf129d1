"""Expressions of parameters in plain data: strings such as `= 1 / compliance`."""

from __future__ import annotations

import ast
import math
import operator
from collections.abc import Callable, Mapping
from typing import Any, Final

from softsim_core.base import SceneError, known_names

MARK: Final = "="
"""Prefix of an expression."""

_BINARY: Final[Mapping[type, Callable[[float, float], float]]] = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
    ast.Div: operator.truediv,
    ast.Pow: operator.pow,
}


def replace_expressions(data: Any, values: Mapping[str, float]) -> Any:
    """Return plain data in which expressions are replaced, by the values of the names in them.

    Raises:
        SceneError: an expression has another form, an unknown name, or no finite value.
    """
    if isinstance(data, Mapping):
        return {key: replace_expressions(each, values) for key, each in data.items()}
    if isinstance(data, list | tuple):
        return [replace_expressions(each, values) for each in data]
    if isinstance(data, str) and data.startswith(MARK):
        return evaluate_expression(data, values)
    return data


def names_in(data: Any) -> set[str]:
    """Return the names that the expressions in plain data use.

    Raises:
        SceneError: an expression has another form.
    """
    if isinstance(data, Mapping):
        return set().union(*(names_in(each) for each in data.values()))
    if isinstance(data, list | tuple):
        return set().union(*(names_in(each) for each in data))
    if isinstance(data, str) and data.startswith(MARK):
        return {node.id for node in ast.walk(_parse_expression(data)) if isinstance(node, ast.Name)}
    return set()


def evaluate_expression(expression: str, values: Mapping[str, float]) -> float:
    """Evaluate an expression of numbers, names, + - * / ** and brackets.

    It raises the errors of `replace_expressions`.
    """
    try:
        value = _value(_parse_expression(expression), values, expression)
    except SceneError:  # SceneError is a ValueError, which the next clause would catch
        raise
    except (ArithmeticError, ValueError):
        value = math.nan
    if not math.isfinite(value):
        raise SceneError(f"the expression {expression!r} has no finite value; bound its parameters otherwise")
    return value


def _parse_expression(expression: str) -> ast.expr:
    try:
        return ast.parse(expression.removeprefix(MARK).strip(), mode="eval").body
    except (SyntaxError, ValueError, RecursionError, MemoryError):
        raise _make_expression_error(expression) from None


def _make_expression_error(expression: str) -> SceneError:
    return SceneError(
        f"the expression {expression[:80]!r} must be of numbers, names of parameters, + - * / ** and brackets"
    )


def _value(node: ast.expr, values: Mapping[str, float], expression: str) -> float:
    if isinstance(node, ast.Constant) and isinstance(node.value, int | float):
        return float(node.value)
    if isinstance(node, ast.Name):
        if node.id not in values:
            hint = known_names(node.id, values, "the parameters are")
            raise SceneError(f"the expression {expression!r} names {node.id!r}; {hint}")
        return values[node.id]
    if isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.USub | ast.UAdd):
        inner = _value(node.operand, values, expression)
        return -inner if isinstance(node.op, ast.USub) else inner
    if isinstance(node, ast.BinOp) and type(node.op) in _BINARY:
        left, right = (_value(each, values, expression) for each in (node.left, node.right))
        value = _BINARY[type(node.op)](left, right)
        return float(value) if isinstance(value, int | float) else math.nan
    raise _make_expression_error(expression)
