"""One-line bugs in Python: what a person mistypes, found in the syntax tree.

Left alone are documentation, annotations, imports, errors that are raised and their
messages, help texts, logging and assertions. A bug is one that compiles.
"""

from __future__ import annotations

import ast
import re

from mutation.mutants import Edit

COMPARISONS = {
    ast.Lt: ("<", "<="), ast.LtE: ("<=", "<"), ast.Gt: (">", ">="),
    ast.GtE: (">=", ">"), ast.Eq: ("==", "!="), ast.NotEq: ("!=", "=="),
    ast.Is: ("is", "is not"),
    ast.IsNot: ("is not", "is"), ast.In: ("in", "not in"), ast.NotIn: ("not in", "in"),
}  # fmt: skip
ARITHMETIC = {
    ast.Add: ("+", "-"), ast.Sub: ("-", "+"), ast.Mult: ("*", "/"), ast.Div: ("/", "*"),
    ast.FloorDiv: ("//", "/"), ast.Mod: ("%", "//"), ast.Pow: ("**", "*"),
    ast.BitAnd: ("&", "|"), ast.BitOr: ("|", "&"),
}  # fmt: skip
RIVALS = {
    "min": "max", "minimum": "maximum", "argmin": "argmax", "any": "all",
    "floor": "ceil", "sin": "cos", "fmin": "fmax", "startswith": "endswith",
    "rstrip": "lstrip", "zeros": "ones", "append": "extend",
}  # fmt: skip
RIVALS |= {rival: name for name, rival in RIVALS.items()}
# Calls whose result is often as fit as what they are given.
DROPPED = {
    "abs", "conj", "conjugate", "copy", "cumsum", "deg2rad", "degrees", "inv",
    "inverse", "invert", "lower", "normalize", "normalized", "norm", "rad2deg",
    "radians", "reversed", "sort", "sorted", "strip", "unwrap",
}  # fmt: skip
# Declares a key of a file: what stands before its default is documentation.
KEY = "key"
# Calls whose arguments have no order.
UNORDERED = {
    "allclose", "array_equal", "gcd", "hypot", "isclose", "lcm", "max", "maximum",
    "min", "minimum",
}  # fmt: skip
# Arguments that are read by people alone, how a picture looks, what holds of classes.
WORDS = {
    "color", "description", "encoding", "epilog", "errors", "examples", "fillstyle",
    "fontsize", "frozen", "help", "hint", "linestyle", "linewidth", "marker",
    "markersize", "message", "metavar", "name", "repr", "short_help", "slots",
    "stacklevel", "title",
}  # fmt: skip
UNIT = re.compile(r"^(?:[A-Z][A-Z_]+|.*(?:unit|scale|_per_|factor|sign).*)$")
TYPE = re.compile(r"(?:\w+\.)*[A-Z]+[a-z]\w*")
# Numbers from here on, and up to there, are wrong by a factor rather than by one.
MANY, NEAR_ZERO = 100, 1e-3

LOGGERS = {"log", "_log", "logger", "_logger", "logging"}
Function = ast.FunctionDef | ast.AsyncFunctionDef


def edits(source: str) -> list[Edit]:
    """Return each bug of each line of a source, in its order."""
    finder = _Finder(source)
    finder.visit(ast.parse(source))
    return sorted(set(finder.found), key=lambda one: (one.line, one.start, one.text))


class _Finder(ast.NodeVisitor):
    """Collects the bugs of a tree."""

    def __init__(self, source: str) -> None:
        self.lines = source.split("\n")
        self.found: list[Edit] = []

    def place(self, line: int, offset: int) -> int:
        """Return the column of characters of an offset in bytes."""
        return len(self.lines[line - 1].encode()[:offset].decode())

    def text(self, node: ast.AST) -> str | None:
        """Return what stands for a node, None where that is longer than its line."""
        if node.lineno != node.end_lineno:
            return None
        start, end = self.span(node)
        return self.lines[node.lineno - 1][start:end]

    def span(self, node: ast.AST) -> tuple[int, int]:
        """Return the columns of a node of one line."""
        line: int = node.lineno
        return (
            self.place(line, node.col_offset),
            self.place(line, node.end_col_offset),
        )

    def put(self, node: ast.AST, text: str, kind: str) -> None:
        """Replace a node of one line."""
        if self.text(node) is not None:
            self.add(node.lineno, *self.span(node), text, kind)

    def add(self, line: int, start: int, end: int, text: str, kind: str) -> None:
        """Replace a part of a line."""
        self.found.append(Edit(line, start, end, text, kind))

    def between(
        self, left: ast.AST, right: ast.AST, old: str, new: str, kind: str
    ) -> None:
        """Replace an operator between two nodes."""
        words = old.replace(" ", r"\s+")
        pattern = re.compile(rf"\b{words}\b" if old[0].isalpha() else re.escape(old))
        for number in range(left.end_lineno, right.lineno + 1):
            line = self.lines[number - 1]
            start, end = 0, len(line)
            if number == left.end_lineno:
                start = self.place(number, left.end_col_offset)
            if number == right.lineno:
                end = self.place(number, right.col_offset)
            if match := pattern.search(line, start, end):
                self.add(number, *match.span(), new, kind)
                return

    # What is left alone.

    def skip(self, node: ast.AST) -> None:
        """Look for nothing in a node."""

    visit_Import = visit_ImportFrom = visit_Raise = visit_Assert = skip
    visit_JoinedStr = skip

    def visit_AnnAssign(self, node: ast.AnnAssign) -> None:
        """Look at the value, not at its type."""
        if node.value is not None:
            self.visit(node.value)

    def visit_arg(self, node: ast.arg) -> None:
        """Leave the annotation."""

    def visit_FunctionDef(self, node: Function) -> None:
        """Look at defaults and statements, not at types."""
        if any(ast.unparse(one).endswith("overload") for one in node.decorator_list):
            return
        for part in (*node.decorator_list, node.args, *node.body):
            self.visit(part)

    visit_AsyncFunctionDef = visit_FunctionDef

    def visit_Assign(self, node: ast.Assign) -> None:
        """Look at what is assigned, except names of the module and aliases of types."""
        target = node.targets[0]
        if isinstance(target, ast.Name):
            alias = isinstance(node.value, ast.Subscript | ast.BinOp) and re.fullmatch(
                r"_?[A-Z][a-z]\w*", target.id
            )
            if target.id.startswith("__") or alias:
                return
        self.generic_visit(node)

    def visit_keyword(self, node: ast.keyword) -> None:
        """Leave what is read by people alone."""
        if node.arg not in WORDS | {"axis"}:
            self.visit(node.value)

    # Operators.

    def visit_Compare(self, node: ast.Compare) -> None:
        """Change each comparison."""
        left = node.left
        for operator, right in zip(node.ops, node.comparators, strict=True):
            self.between(left, right, *COMPARISONS[type(operator)], "comparison")
            left = right
        self.generic_visit(node)

    def visit_BoolOp(self, node: ast.BoolOp) -> None:
        """Take or for and."""
        pair = ("and", "or") if isinstance(node.op, ast.And) else ("or", "and")
        for left, right in zip(node.values, node.values[1:], strict=False):
            self.between(left, right, *pair, "logic")
        self.generic_visit(node)

    def visit_BinOp(self, node: ast.BinOp) -> None:
        """Swap arithmetic, drop factors; texts, lists and unions of types stay."""
        told = (ast.JoinedStr, ast.List, ast.Tuple, ast.Dict, ast.Set)
        sides = (node.left, node.right)
        if not any(
            isinstance(one, told)
            or (isinstance(one, ast.Constant) and isinstance(one.value, str | None))
            or TYPE.fullmatch(self.text(one) or "")
            for one in sides
        ):
            if type(node.op) in ARITHMETIC:
                self.between(*sides, *ARITHMETIC[type(node.op)], "arithmetic")
            if isinstance(node.op, ast.Mult | ast.Div):
                self.factors(node)
            left, right = self.text(node.left), self.text(node.right)
            if isinstance(node.op, ast.MatMult) and left and right:
                self.put(node, f"{right} @ {left}", "order")
        self.generic_visit(node)

    def factors(self, node: ast.BinOp) -> None:
        """Drop a factor that looks like a unit."""
        pairs = [(node.right, node.left)]
        if isinstance(node.op, ast.Mult):
            pairs.append((node.left, node.right))
        for factor, rest in pairs:
            name = (self.text(factor) or "").rpartition(".")[2]
            if isinstance(factor, ast.Constant) or UNIT.match(name):
                kept = self.text(rest)
                if kept is not None:
                    self.put(node, kept, "factor")

    def visit_AugAssign(self, node: ast.AugAssign) -> None:
        """Swap what is done in place."""
        if type(node.op) in ARITHMETIC:
            old, new = ARITHMETIC[type(node.op)]
            self.between(node.target, node.value, f"{old}=", f"{new}=", "arithmetic")
        self.generic_visit(node)

    def visit_UnaryOp(self, node: ast.UnaryOp) -> None:
        """Drop not, - and ~."""
        operand = self.text(node.operand)
        if operand is not None and not isinstance(node.op, ast.UAdd):
            kind = "negation" if isinstance(node.op, ast.Not) else "sign"
            self.put(node, operand, kind)
        self.generic_visit(node)

    def visit_Constant(self, node: ast.Constant) -> None:
        """Take a number off by one, or another truth."""
        value = node.value
        if isinstance(value, bool):
            self.put(node, str(not value), "truth")
        elif isinstance(value, int):
            near = value < MANY
            self.put(node, str(value + 1 if near else value * 10), "constant")
            if value > 1:
                self.put(node, str(value - 1 if near else value // 10), "constant")
        elif isinstance(value, float):
            changed = value * 10 if 0 < value <= NEAR_ZERO else value + 1
            self.put(node, repr(float(f"{changed:.12g}")), "constant")

    # Expressions.

    def visit_Subscript(self, node: ast.Subscript) -> None:
        """Take a neighbour's index, or a bound off by one."""
        parts = node.slice.elts if isinstance(node.slice, ast.Tuple) else [node.slice]
        for part in parts:
            index = _whole(part)
            if index is not None:
                others = {0: (1, -1), 1: (0,), -1: (0,)}.get(index, (index - 1,))
                for other in others:
                    self.put(part, str(other), "index")
            elif isinstance(part, ast.Slice):
                self.bounds(part)
        self.visit(node.value)
        for part in parts:
            if _whole(part) is None and not isinstance(part, ast.Slice):
                self.visit(part)

    def bounds(self, node: ast.Slice) -> None:
        """Move the bounds of a slice by one."""
        for bound in (node.lower, node.upper):
            if bound is None:
                continue
            number, text = _whole(bound), self.text(bound)
            if number is not None:
                self.put(bound, str(number + 1), "slice")
                self.put(bound, str(number - 1), "slice")
            elif text is not None:
                self.put(bound, f"({text}) + 1", "slice")
                self.visit(bound)
        if node.step is not None and (text := self.text(node.step)):
            self.put(node.step, "1", "slice")

    def visit_Attribute(self, node: ast.Attribute) -> None:
        """Drop a transposition."""
        value = self.text(node.value)
        if node.attr in {"T", "mT"} and value is not None:
            self.put(node, value, "inverse")
        self.generic_visit(node)

    def visit_Call(self, node: ast.Call) -> None:
        """Take a rival function, drop a call or an argument, swap two arguments."""
        function = node.func
        base = function.value if isinstance(function, ast.Attribute) else None
        if isinstance(base, ast.Name) and base.id in LOGGERS:
            return
        name = getattr(function, "attr", getattr(function, "id", ""))
        if name == KEY:
            for keyword in node.keywords:
                self.visit(keyword)
            return
        if name in RIVALS and self.text(function):
            end = self.place(function.end_lineno, function.end_col_offset)
            line: int = function.end_lineno
            self.add(line, end - len(name), end, RIVALS[name], "function")
        if name in DROPPED:
            kept = node.args[0] if node.args else base
            if kept is not None and (text := self.text(kept)) is not None:
                self.put(node, f"list({text})" if name == "sorted" else text, "inverse")
        if name not in UNORDERED:
            for left, right in zip(node.args, node.args[1:], strict=False):
                self.swap(left, right)
        for keyword in node.keywords:
            self.drop(node, keyword)
        self.generic_visit(node)

    def swap(self, left: ast.expr, right: ast.expr) -> None:
        """Swap two plain arguments."""
        plain = ast.Name | ast.Attribute
        if not (isinstance(left, plain) and isinstance(right, plain)):
            return
        first, second = self.text(left), self.text(right)
        if first and second and first != second and left.lineno == right.lineno:
            gap = self.lines[left.lineno - 1][self.span(left)[1] : self.span(right)[0]]
            start, end = self.span(left)[0], self.span(right)[1]
            self.add(left.lineno, start, end, f"{second}{gap}{first}", "order")

    def drop(self, call: ast.Call, keyword: ast.keyword) -> None:
        """Drop an argument by name; an axis becomes another."""
        text = self.text(keyword)
        if keyword.arg is None or keyword.arg in WORDS or text is None:
            return
        axis = _whole(keyword.value)
        if keyword.arg == "axis" and axis is not None:
            self.put(
                keyword.value, str({0: 1, 1: 0, -1: 0}.get(axis, axis - 1)), "axis"
            )
            return
        line = self.lines[keyword.lineno - 1]
        start, end = self.span(keyword)
        after = re.compile(r",\s*").match(line, end)
        before = re.compile(r",\s*$").search(line[:start])
        if after:
            end = after.end()
        elif before:
            start = before.start()
        elif len(call.args) + len(call.keywords) > 1:
            return
        self.add(keyword.lineno, start, end, "", "keyword")

    def visit_IfExp(self, node: ast.IfExp) -> None:
        """Force the condition."""
        self.force(node.test)
        self.generic_visit(node)

    def visit_comprehension(self, node: ast.comprehension) -> None:
        """Force the conditions."""
        for test in node.ifs:
            self.put(test, "True", "condition")
        self.generic_visit(node)

    def force(self, test: ast.expr) -> None:
        """Take a condition for true and for false."""
        for forced in ("True", "False"):
            self.put(test, forced, "condition")

    # Statements.

    def visit_If(self, node: ast.If) -> None:
        """Force the condition; what is for the type checker alone stays."""
        if "TYPE_CHECKING" in ast.unparse(node.test):
            return
        self.force(node.test)
        self.generic_visit(node)

    def visit_While(self, node: ast.While) -> None:
        """Never begin."""
        self.put(node.test, "False", "condition")
        self.generic_visit(node)

    def visit_Expr(self, node: ast.Expr) -> None:
        """Remove a call that is made for its effect."""
        if isinstance(node.value, ast.Constant):
            return
        before = len(self.found)
        self.generic_visit(node)
        logged = isinstance(node.value, ast.Call) and len(self.found) == before
        if isinstance(node.value, ast.Call) and not (logged and _logs(node.value)):
            self.put(node, "pass", "statement")

    def visit_Break(self, node: ast.Break) -> None:
        """Go on."""
        self.put(node, "continue", "jump")

    def visit_Continue(self, node: ast.Continue) -> None:
        """Stop."""
        self.put(node, "break", "jump")

    def visit_Return(self, node: ast.Return) -> None:
        """Return two values the other way round."""
        if isinstance(node.value, ast.Tuple) and len(node.value.elts) == 2:
            self.swap(*node.value.elts)
        self.generic_visit(node)


def _whole(node: ast.expr) -> int | None:
    """Return the value of a whole number, with or without its sign."""
    sign = 1
    if isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.USub):
        sign, node = -1, node.operand
    value = getattr(node, "value", None)
    if isinstance(node, ast.Constant) and type(value) is int:
        return sign * value
    return None


def _logs(call: ast.Call) -> bool:
    """Return whether a call is one of a logger."""
    return isinstance(call.func, ast.Attribute) and (
        isinstance(call.func.value, ast.Name) and call.func.value.id in LOGGERS
    )
