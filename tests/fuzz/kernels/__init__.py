"""Valid arguments of the kernels, one module for each family of them.

A module has ``CALLS``: from the name of a function or class of `animtool._kernels`, or
of a method as ``Class.method``, to what makes its arguments from a generator of random
numbers. A method's first argument is the object, named ``self``. ``UNBOUNDED`` names
those whose results may be infinite or NaN though their arguments are valid.

Arguments are small, valid and take a millisecond at most. They are arrays, numbers,
bytes, None, objects of the kernels, and tuples or lists of these.
"""

from __future__ import annotations

import importlib
import pkgutil
from collections.abc import Callable
from typing import Any

import numpy as np

from animtool import _kernels

__all__ = ["Maker", "exported", "makers", "unbounded"]

Maker = Callable[[np.random.Generator], dict[str, Any]]


def exported() -> set[str]:
    """Return the names of all functions, classes and methods of the kernels."""
    names = set()
    for name, value in vars(_kernels).items():
        if name.startswith("_") or not callable(value):
            continue
        names.add(name)
        if isinstance(value, type):
            methods = (key for key in vars(value) if not key.startswith("_"))
            names |= {f"{name}.{method}" for method in methods}
    return names


def makers() -> dict[str, Maker]:
    """Return what makes the arguments, of each name."""
    return {name: make for family in _families() for name, make in family.CALLS.items()}


def unbounded() -> set[str]:
    """Return the names whose results need not be finite."""
    return {name for family in _families() for name in family.UNBOUNDED}


def _families() -> list[Any]:
    found = sorted(module.name for module in pkgutil.iter_modules(__path__))
    return [importlib.import_module(f"{__name__}.{name}") for name in found]
