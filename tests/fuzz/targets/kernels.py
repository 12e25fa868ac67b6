"""The compiled kernels, called with arguments of which one or two are spoiled."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from animtool import _kernels
from fuzz.arguments import leaves, spoiled
from fuzz.guarded import Guarded
from fuzz.kernels import makers, unbounded

ABOUT = "functions and classes of the kernels; arrays end at guarded pages"

VALID = 0.2


def make(_: Path) -> Callable[[np.random.Generator], str]:
    """Return what runs a case, which needs no folder."""
    calls, unsure = makers(), unbounded()
    names = sorted(calls)
    memory = Guarded()

    def run(rng: np.random.Generator) -> str:
        name = names[rng.integers(len(names))]
        arguments = calls[name](rng)
        valid = rng.random() < VALID
        if not valid:
            for _ in range(int(min(rng.geometric(0.8), 2))):
                paths = leaves(arguments)
                path = paths[rng.integers(len(paths))]
                arguments = spoiled(rng, arguments, path)
        before = _finite(arguments)
        memory.clear()
        placed = _placed(memory, arguments, at_end=bool(rng.integers(2)))
        try:
            result = call(name, placed)
        except (ValueError, TypeError):
            if valid:
                raise
            return f"{name} refused"
        if valid and name not in unsure:
            kept = _finite(result) and _finite(placed) >= before
            assert kept, f"{name}: the result is not finite"
        return f"{name} valid" if valid else f"{name} done"

    return run


def call(name: str, arguments: dict[str, Any]) -> Any:
    """Call a function, a class or a method of the kernels."""
    owner, _, method = name.partition(".")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        if method:
            others = {k: v for k, v in arguments.items() if k != "self"}
            return getattr(arguments["self"], method)(**others)
        return getattr(_kernels, owner)(**arguments)


def _placed(memory: Guarded, value: Any, *, at_end: bool) -> Any:
    if isinstance(value, dict):
        return {k: _placed(memory, v, at_end=at_end) for k, v in value.items()}
    if isinstance(value, tuple | list):
        return type(value)(_placed(memory, one, at_end=at_end) for one in value)
    if isinstance(value, np.ndarray) and value.flags.c_contiguous:
        return memory.place(value, at_end=at_end)
    return value


def _finite(value: Any) -> bool:
    if isinstance(value, dict):
        return all(_finite(one) for one in value.values())
    if isinstance(value, tuple | list):
        return all(_finite(one) for one in value)
    if isinstance(value, np.ndarray | float):
        return bool(np.isfinite(value).all())
    return True
