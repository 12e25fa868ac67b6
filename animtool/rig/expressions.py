"""Arithmetic expressions of rig files, evaluated on arrays.

A small part of Python's grammar: ``+ - * /``, numbers, names, and calls to the
functions of `FUNCTIONS`. Nothing else is evaluated: no index, no power operator, and
attributes or text only as the name of a joint's coordinate, where these are allowed.
"""

from __future__ import annotations

import ast
import copy
import re
import sys
import warnings
from collections.abc import Callable, Iterator, Mapping
from dataclasses import field
from itertools import accumulate
from keyword import iskeyword
from typing import Any

import numpy as np

from animtool.core.array_types import FloatArray
from animtool.core.errors import excerpt
from animtool.core.record import dataclass

MAX_EXPRESSION_LENGTH = 1000
MAX_TREE_DEPTH = 60
MAX_NESTED_BRACKETS = 90


def _smoothstep(low: Any, high: Any, x: Any) -> Any:
    """Interpolate from 0 at low to 1 at high with zero slope at both ends."""
    range_width = np.where(np.equal(low, high), 1.0, np.subtract(high, low))
    u = np.clip((x - low) / range_width, 0.0, 1.0)
    return np.where(
        np.equal(low, high), np.where(x < low, 0.0, 1.0), u * u * (3 - 2 * u)
    )


def _lerp(a: Any, b: Any, t: Any) -> Any:
    """Interpolate linearly from a to b."""
    return a + (b - a) * t


def _clamp(x: Any, low: Any, high: Any) -> Any:
    """Clamp x to a range."""
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
# Symbol of each binary operator.
_OPERATORS: dict[type[ast.operator], str] = {
    ast.Add: "+",
    ast.Sub: "-",
    ast.Mult: "*",
    ast.Div: "/",
}
# Function and number of arguments of each operation of a program.
_OPERATIONS: dict[str, tuple[Callable[..., Any], int]] = {
    **FUNCTIONS,
    "+": (np.add, 2),
    "-": (np.subtract, 2),
    "*": (np.multiply, 2),
    "/": (np.divide, 2),
    "neg": (np.negative, 1),
}


@dataclass(frozen=True, slots=True)
class Expression:
    """A parsed expression over controls and joint coordinates."""

    text: str  # as spelled in the file
    # Controls, and coordinates such as ``elbow.angle``, that it reads, sorted.
    names: tuple[str, ...]
    _tree: ast.expr = field(repr=False, compare=False)
    # Operations in reverse Polish notation, see `postfix_program`.
    _program: tuple[tuple[str, Any], ...] = field(repr=False, compare=False)

    def evaluate(self, values_by_name: Mapping[str, FloatArray]) -> FloatArray:
        """Evaluate on arrays that broadcast; NaN or infinite where undefined.

        >>> wave = parse_expression("clamp(grin * 2, 0, 1)")
        >>> wave.evaluate({"grin": np.array([0.25, 3.0])}).tolist()
        [0.5, 1.0]
        """
        stack: list[Any] = []
        with np.errstate(all="ignore"):
            for kind, value in self._program:
                if kind == "call":
                    function, argument_count = _OPERATIONS[value]
                    stack[-argument_count:] = [function(*stack[-argument_count:])]
                else:
                    stack.append(value if kind == "number" else values_by_name[value])
        return np.asarray(stack[0], np.float64)

    def postfix_program(self) -> list[tuple[str, float | str]]:
        """Return the expression in reverse Polish notation, for a stack machine.

        ``("number", x)``, ``("name", NAME)``, or ``("call", FUNCTION)``, with operators
        named ``+ - * / neg``.

        >>> parse_expression("2 * x").postfix_program()
        [('number', 2.0), ('name', 'x'), ('call', '*')]
        """
        return list(self._program)

    def scaled_text(self, factor_by_name: Mapping[str, float], factor: float) -> str:
        """Return the text with names and result multiplied by factors.

        >>> parse_expression("sin(x) + 1").scaled_text({"x": 2.0}, 0.5)
        '(sin(x * 2.0) + 1) * 0.5'
        """
        tree = _NameScaler(factor_by_name).visit(copy.deepcopy(self._tree))
        if factor != 1.0:
            tree = ast.BinOp(tree, ast.Mult(), ast.Constant(factor))
        return ast.unparse(ast.fix_missing_locations(tree))

    def with_renamed_inputs(self, new_name_by_input: Mapping[str, str]) -> Expression:
        """Return the expression with its inputs renamed.

        >>> parse_expression("a + b").with_renamed_inputs({"a": "c"}).text
        'c + b'
        """
        if not any(new_name_by_input.get(name, name) != name for name in self.names):
            return self
        tree = _NameReplacer(new_name_by_input).visit(copy.deepcopy(self._tree))
        return parse_expression(ast.unparse(tree), allows_coordinates=True)


def parse_expression(text: str, *, allows_coordinates: bool = False) -> Expression:
    """Parse an expression; `ValueError` if too long or not allowed.

    With ``allows_coordinates`` it may read those of joints: ``elbow.angle``, in quotes
    if the joint's name is not a Python identifier: ``'rig:elbow.angle'``.
    """
    if len(text) > MAX_EXPRESSION_LENGTH:
        raise ValueError(
            f"has {len(text)} characters; the limit is {MAX_EXPRESSION_LENGTH}"
        )
    # Python's parser runs out of memory on more nested brackets.
    depths = accumulate((c in "([{") - (c in ")]}") for c in text)
    if max(depths, default=0) > MAX_NESTED_BRACKETS:
        raise ValueError(f"is nested deeper than {MAX_NESTED_BRACKETS}")
    try:
        # Python warns about expressions that are refused below.
        with warnings.catch_warnings(action="ignore"):
            tree = ast.parse(text.strip(), mode="eval").body
    except (SyntaxError, ValueError, RecursionError) as error:
        raise ValueError(_syntax_fault(text.strip(), error)) from error
    names: set[str] = set()
    _check_node(tree, text.strip(), names, 0, allows_coordinates=allows_coordinates)
    program = tuple(_postfix_program(tree))
    return Expression(text, tuple(sorted(names)), tree, program)


CONDITION_FAULT = (
    "conditions are not allowed; smoothstep(low, high, x) rises from 0 to 1"
)


def _syntax_fault(text: str, error: Exception) -> str:
    """Return a message that explains an expression's syntax error."""
    if isinstance(error, RecursionError | MemoryError):
        return "the expression is nested too deep"
    offset = (getattr(error, "offset", None) or 1) - 1
    if offset >= len(text) or text.rstrip().endswith(tuple("+-*/,(")):
        return "the expression ends too early"
    text_before, after_text = text[:offset].rstrip(), text[offset:]
    if after_text.startswith("?"):
        return CONDITION_FAULT
    if re.search(r"[\w.)]$", text_before) and re.match(r"[A-Za-z_(]", after_text):
        message = f"no operator before {excerpt(after_text)}; "
        return f"{message}write {text_before} * {after_text}"
    if unit_match := re.match(r"[0-9.]+(mm|cm|m|in|ft|deg|rad|s)\b", after_text):
        return f"{excerpt(unit_match[0])} has a unit: write numbers in the rig's units"
    message = f"the expression has a syntax error at {excerpt(after_text)}; "
    hint = "write numbers, names, + - * / and functions, as in 2 * sin(x)"
    if text.startswith("=") and (bare_text := text.lstrip("= ")):
        message, hint = "an expression has no '=' in front; ", f"write {bare_text}"
    return message + hint


def _coordinate_name(node: ast.expr) -> str | None:
    """Return the coordinate ``JOINT.PART`` that a node names; None for other nodes."""
    match node:
        case ast.Constant(value=str(name)):
            return name
        case ast.Attribute(value=ast.Name(id=name), attr=part):
            return f"{name}.{part}"
        case ast.Attribute(value=ast.Attribute() as value, attr=part):
            prefix = _coordinate_name(value)
            return prefix and f"{prefix}.{part}"
    return None


def _name_node(name: str) -> ast.expr:
    """Return a syntax node for a control or coordinate name."""
    first, *parts = words = name.split(".")
    if not all(word.isidentifier() and not iskeyword(word) for word in words):
        return ast.Constant(name)
    node: ast.expr = ast.Name(first)
    for part in parts:
        node = ast.Attribute(node, part)
    return node


class _NameReplacer(ast.NodeTransformer):
    """Replaces the control and coordinate names in an expression."""

    def __init__(self, new_name_by_input: Mapping[str, str]) -> None:
        self.new_name_by_input = new_name_by_input

    def visit(self, node: ast.AST) -> Any:
        """Return the replacement of a node."""
        name = _read_name(node)
        if name is not None:
            return _name_node(self.new_name_by_input.get(name, name))
        return self.generic_visit(node)

    def visit_Call(self, node: ast.Call) -> ast.Call:
        """Rename the arguments of a call, but not the function."""
        node.args = [self.visit(argument) for argument in node.args]
        return node


class _NameScaler(_NameReplacer):
    """Multiplies names by factors in an expression."""

    def __init__(self, factor_by_name: Mapping[str, float]) -> None:
        super().__init__({})
        self.factor_by_name = factor_by_name

    def visit(self, node: ast.AST) -> Any:
        """Return the replacement of a node."""
        if isinstance(node, ast.Call):
            return self.visit_Call(node)
        name = _read_name(node)
        if name is None or self.factor_by_name.get(name, 1.0) == 1.0:
            return super().visit(node)
        factor = ast.Constant(self.factor_by_name[name])
        return ast.BinOp(_name_node(name), ast.Mult(), factor)


def _read_name(node: ast.AST) -> str | None:
    """Return the control or coordinate name of a node."""
    if isinstance(node, ast.Name):
        return None if node.id in _CONSTANTS else node.id
    return _coordinate_name(node) if isinstance(node, ast.expr) else None


def _check_node(
    node: ast.expr, text: str, names: set[str], depth: int, *, allows_coordinates: bool
) -> None:
    """Raise if a node or its children are not allowed; add the names that they read."""
    if depth > MAX_TREE_DEPTH:
        raise ValueError(f"is nested deeper than {MAX_TREE_DEPTH}")
    coordinate = _coordinate_name(node)
    if coordinate is not None and allows_coordinates:
        names.add(coordinate)
        return
    if isinstance(node, ast.Attribute) and coordinate is not None:
        raise ValueError(
            f"{coordinate[:40]!r} is not allowed here: `drives` reads controls; "
            "`driven` of a joint, shape or control reads joints"
        )
    for child in _allowed_children(node, text, names):
        _check_node(
            child, text, names, depth + 1, allows_coordinates=allows_coordinates
        )


def _allowed_children(node: ast.expr, text: str, names: set[str]) -> list[ast.expr]:
    """Return the child nodes of an allowed node."""
    children: list[ast.expr]
    match node:
        case ast.Constant(value=number):
            _check_number(number)
            children = []
        case ast.Name(id=name):
            if name not in _CONSTANTS:
                names.add(name)
            children = []
        case ast.UnaryOp(op=ast.UAdd() | ast.USub(), operand=operand):
            children = [operand]
        case ast.BinOp(left=left, op=operator, right=right) if (
            type(operator) in _OPERATORS
        ):
            children = [left, right]
        case ast.Call(func=ast.Name(id=name), args=children, keywords=[]):
            if name not in FUNCTIONS:
                function_names = ", ".join(FUNCTIONS)
                raise ValueError(
                    f"unknown function {name!r}; allowed: {function_names}"
                )
            if len(children) != FUNCTIONS[name][1]:
                argument_count = FUNCTIONS[name][1]
                raise ValueError(
                    f"{name} takes {argument_count} values, not {len(children)}"
                )
        case ast.BinOp(op=ast.Pow() | ast.BitXor() as operator):
            sign = "**" if isinstance(operator, ast.Pow) else "^"
            raise ValueError(f"{sign!r} is not allowed; write pow(a, b)")
        case ast.Compare() | ast.IfExp() | ast.BoolOp():
            raise ValueError(CONDITION_FAULT)
        case _:
            source_text = (ast.get_source_segment(text, node) or text)[:40]
            raise ValueError(
                f"{source_text!r} is not allowed; use + - * / and functions"
            )
    return children


def _check_number(number: object) -> None:
    """Raise if a number is not finite or not real."""
    if isinstance(number, bool) or not isinstance(number, int | float):
        raise ValueError(f"{str(number)[:40]!r} is not allowed")  # noqa: TRY004
    if not abs(number) <= sys.float_info.max:
        raise ValueError("a number is beyond float64")


def _postfix_program(node: ast.expr) -> Iterator[tuple[str, float | str]]:
    """Yield a node's operations in reverse Polish notation."""
    name = _read_name(node)
    if name is not None:
        yield "name", name
        return
    match node:
        case ast.Constant(value=number):
            yield "number", float(number)  # type: ignore[arg-type]
        case ast.Name(id=name):
            yield "number", float(_CONSTANTS[name])
        case ast.UnaryOp(op=operator, operand=operand):
            yield from _postfix_program(operand)
            if isinstance(operator, ast.USub):
                yield "call", "neg"
        case ast.BinOp(left=left, op=operator, right=right):
            yield from _postfix_program(left)
            yield from _postfix_program(right)
            yield "call", _OPERATORS[type(operator)]
        case ast.Call(func=ast.Name(id=name), args=arguments):
            for argument in arguments:
                yield from _postfix_program(argument)
            yield "call", name
        case _:
            raise AssertionError(ast.dump(node))
