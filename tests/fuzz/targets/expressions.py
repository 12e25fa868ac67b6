"""Expressions of rigs: read, and those that are read evaluated."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import NoReturn

import numpy as np

from animtool.rig.expressions import FUNCTIONS, MAX_EXPRESSION_LENGTH, parse_expression
from fuzz.mutations import pick, spoil

ABOUT = "expressions over controls, read and evaluated"

SEEDS = [
    b"clamp(grin, 0, 1)",
    b"curl * .1 + 3e-2 / (1 - curl)",
    b"lerp(a, b, smoothstep(0, 1, -c))",
    b"pow(abs(sin(a * pi)), 2) - atan2(b, max(c, 1e-9))",
    b"log(a) + exp(b) + sqrt(c) + floor(a) * sign(b) + ceil(tan(c)) + min(cos(a), b)",
]
SIGNS = "+-*/%@(),.:=<>[]{}'\"\\~!|&^;#"
WORDS = [
    *(*SIGNS, "**", "//", "==", "lambda a: a", "a if b else c", "not a", "await a"),
    *("a.b", "a[0]", "f'{a}'", "__import__('os')", "9**9**9", "1" * 400, "1e400"),
    *("0x7f", "1j", "...", "(yield)", "a := 1", "*a", "**a", "True", "None", "nan"),
    *("\n", "\t", "\x00", "\x1b", "\ud800", "ﬁ", "(" * 300, "-" * 400, "a+" * 200),
    *("pi", "inf", *FUNCTIONS),
]


def make(folder: Path) -> Callable[[np.random.Generator], str]:
    """Return what runs a case; it writes no files."""
    del folder
    arrays = np.array([[-1.0, 0.0, 0.5, 1e30], [0.25, 1.0, -3.0, 1e-30]])

    def run(rng: np.random.Generator) -> str:
        if rng.random() < 0.5:
            text = spoil(rng, pick(rng, SEEDS)).decode("utf-8", "surrogateescape")
        else:
            text = "".join(_piece(rng) for _ in range(int(min(rng.geometric(0.1), 60))))
        try:
            made = parse_expression(text)
        except ValueError as error:
            return (
                "refused" if len(str(error)) < MAX_EXPRESSION_LENGTH else _fail(error)
            )
        values = {name: arrays[i % 2] for i, name in enumerate(made.names)}
        found = made.evaluate(values)
        assert found.dtype == np.float64
        assert found.shape in {(), (4,)}
        return "evaluated"

    return run


def _fail(error: ValueError) -> NoReturn:
    raise AssertionError(f"a message of {len(str(error))} letters")


def _piece(rng: np.random.Generator) -> str:
    kind = rng.integers(4)
    if kind == 0:
        return WORDS[int(rng.integers(len(WORDS)))]
    if kind == 1:
        return " "
    return pick(rng, SEEDS).decode() if kind == 2 else "abc"[int(rng.integers(3))]
