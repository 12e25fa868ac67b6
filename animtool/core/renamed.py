"""Old names of public attributes and arguments, which warn and work for one version."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from functools import wraps
from typing import Any, ParamSpec, TypeVar

Parameters = ParamSpec("Parameters")
Result = TypeVar("Result")


class _OldAttribute:
    """Descriptor of an old name: returns the attribute of the new name."""

    def __init__(self, old: str, new: str) -> None:
        self.old, self.new = old, new

    def __get__(self, instance: Any, owner: type) -> Any:
        """Return the attribute of the new name, with a warning."""
        _warn(f"{owner.__name__}.{self.old}", self.new)
        return getattr(owner if instance is None else instance, self.new)


def rename_attributes(owner: type, **new_names: str) -> None:
    """Give a class the old names of some of its attributes.

    >>> class Box:
    ...     size = 3
    >>> rename_attributes(Box, extent="size")
    >>> with warnings.catch_warnings(action="ignore"):
    ...     Box().extent
    3
    """
    for old, new in new_names.items():
        setattr(owner, old, _OldAttribute(old, new))


def renamed_arguments(
    **new_names: str,
) -> Callable[[Callable[Parameters, Result]], Callable[Parameters, Result]]:
    """Return a decorator with which a function takes old names of its arguments.

    >>> @renamed_arguments(extent="size")
    ... def half(size: float) -> float:
    ...     return size / 2
    >>> with warnings.catch_warnings(action="ignore"):
    ...     half(extent=3.0)
    1.5
    """

    def decorated(
        function: Callable[Parameters, Result],
    ) -> Callable[Parameters, Result]:
        @wraps(function)
        def call(*args: Parameters.args, **named: Parameters.kwargs) -> Result:
            for old, new in new_names.items():
                if old in named:
                    _warn(f"{function.__name__}({old}=)", new)
                    named[new] = named.pop(old)
            return function(*args, **named)

        return call

    return decorated


def _warn(old: str, new: str) -> None:
    warnings.warn(f"{old} is now called {new}", DeprecationWarning, stacklevel=3)
