"""Arithmetic that a rig file may hold, over whole arrays of control values.

A small part of Python's grammar: ``+ - * /``, numbers, names, and calls to the
functions of `FUNCTIONS`. Nothing else is evaluated: no attribute, no index, no
power operator, no text.
"""

from __future__ import annotations

import ast
import sys
import warnings
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from itertools import accumulate
from typing import Any

import numpy as np

from animtool._types import FloatArray

LONGEST = 1000
DEEPEST = 60
MAX_BRACKETS = 90


def _smoothstep(low: Any, high: Any, x: Any) -> Any:
    width = np.where(np.equal(low, high), 1.0, np.subtract(high, low))
    u = np.clip((x - low) / width, 0.0, 1.0)
    return np.where(
        np.equal(low, high), np.where(x < low, 0.0, 1.0), u * u * (3 - 2 * u)
    )


def _lerp(a: Any, b: Any, t: Any) -> Any:
    return a + (b - a) * t


def _clamp(x: Any, low: Any, high: Any) -> Any:
    return np.minimum(np.maximum(x, low), high)


# Name: function and number of arguments.
FUNCTIONS: dict[str, tuple[Callable[..., Any], int]] = {
    "abs": (np.abs, 1),
    "atan2": (np.arctan2, 2),
    "ceil": (np.ceil, 1),
    "clamp": (_clamp, 3),
    "cos": (np.cos, 1),
    "exp": (np.exp, 1),
    "floor": (np.floor, 1),
    "lerp": (_lerp, 3),
    "log": (np.log, 1),
    "max": (np.maximum, 2),
    "min": (np.minimum, 2),
    "pow": (np.float_power, 2),
    "sign": (np.sign, 1),
    "sin": (np.sin, 1),
    "smoothstep": (_smoothstep, 3),
    "sqrt": (np.sqrt, 1),
    "tan": (np.tan, 1),
}

_CONSTANTS = {"pi": np.pi}
_OPERATORS: dict[type[ast.operator], Callable[[Any, Any], Any]] = {
    ast.Add: np.add,
    ast.Sub: np.subtract,
    ast.Mult: np.multiply,
    ast.Div: np.divide,
}


@dataclass(frozen=True, slots=True)
class Expression:
    """A checked expression."""

    text: str  # as written
    names: tuple[str, ...]  # the control names that it reads, sorted
    _tree: ast.expr = field(repr=False, compare=False)

    def evaluate(self, values: Mapping[str, FloatArray]) -> FloatArray:
        """Return the expression over arrays that broadcast; not finite where undefined.

        >>> wave = parse_expression("clamp(grin * 2, 0, 1)")
        >>> wave.evaluate({"grin": np.array([0.25, 3.0])}).tolist()
        [0.5, 1.0]
        """
        with np.errstate(all="ignore"):
            return np.asarray(_value(self._tree, values), np.float64)


def parse_expression(text: str) -> Expression:
    """Return the expression of a text, or a `ValueError`: too long, or not allowed."""
    if len(text) > LONGEST:
        raise ValueError(f"is {len(text)} characters long; {LONGEST} are allowed")
    # Python's parser takes more brackets in brackets for a lack of memory.
    depths = accumulate((c in "([{") - (c in ")]}") for c in text)
    if max(depths, default=0) > MAX_BRACKETS:
        raise ValueError(f"is nested deeper than {MAX_BRACKETS}")
    try:
        # Python warns of what is refused below.
        with warnings.catch_warnings(action="ignore"):
            tree = ast.parse(text.strip(), mode="eval").body
    except (SyntaxError, ValueError, RecursionError) as error:
        reason = getattr(error, "msg", None) or "too deep"
        raise ValueError(f"is no expression: {reason}") from error
    names: set[str] = set()
    _check(tree, text.strip(), names, 0)
    return Expression(text, tuple(sorted(names)), tree)


def _check(node: ast.expr, text: str, names: set[str], depth: int) -> None:
    if depth > DEEPEST:
        raise ValueError(f"is nested deeper than {DEEPEST}")
    inner: list[ast.expr]
    match node:
        case ast.Constant(value=number):
            _check_number(number)
            inner = []
        case ast.Name(id=name):
            if name not in _CONSTANTS:
                names.add(name)
            inner = []
        case ast.UnaryOp(op=ast.UAdd() | ast.USub(), operand=operand):
            inner = [operand]
        case ast.BinOp(left=left, op=operator, right=right) if (
            type(operator) in _OPERATORS
        ):
            inner = [left, right]
        case ast.Call(func=ast.Name(id=name), args=inner, keywords=[]):
            if name not in FUNCTIONS:
                allowed = ", ".join(FUNCTIONS)
                raise ValueError(f"{name!r} is no function; allowed: {allowed}")
            if len(inner) != FUNCTIONS[name][1]:
                expected = FUNCTIONS[name][1]
                raise ValueError(f"{name} takes {expected} values, not {len(inner)}")
        case ast.BinOp(op=ast.Pow()):
            raise ValueError("'**' is not allowed; pow(a, b) is")
        case _:
            shown = (ast.get_source_segment(text, node) or text)[:40]
            raise ValueError(f"{shown!r} is not allowed; + - * / and functions are")
    for child in inner:
        _check(child, text, names, depth + 1)


def _check_number(number: object) -> None:
    if isinstance(number, bool) or not isinstance(number, int | float):
        raise ValueError(f"{str(number)[:40]!r} is not allowed")  # noqa: TRY004
    if not abs(number) <= sys.float_info.max:
        raise ValueError("a number is beyond float64")


def _value(node: ast.expr, values: Mapping[str, FloatArray]) -> Any:
    match node:
        case ast.Constant(value=number):
            return np.float64(number)  # type: ignore[arg-type]
        case ast.Name(id=name):
            return _CONSTANTS[name] if name in _CONSTANTS else values[name]
        case ast.UnaryOp(op=operator, operand=operand):
            value = _value(operand, values)
            return -value if isinstance(operator, ast.USub) else value
        case ast.BinOp(left=left, op=operator, right=right):
            apply = _OPERATORS[type(operator)]
            return apply(_value(left, values), _value(right, values))
        case ast.Call(func=ast.Name(id=name), args=arguments):
            return FUNCTIONS[name][0](*(_value(a, values) for a in arguments))
        case _:
            raise AssertionError(ast.dump(node))
