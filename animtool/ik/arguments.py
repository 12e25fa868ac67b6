"""Checks of the arguments of public IK functions."""

from __future__ import annotations

from collections.abc import Callable
from functools import wraps
from typing import ParamSpec, TypeVar

from animtool.core.loaded import check_loaded
from animtool.ik.goals import Targets
from animtool.ik.problem import Problem

P = ParamSpec("P")
Result = TypeVar("Result")


def checks_arguments(
    options_class: type,
) -> Callable[[Callable[P, Result]], Callable[P, Result]]:
    """Return a decorator that checks the types of problem, start, targets and options.

    The functions raise `TypeError` for an argument of another kind, or in the place of
    another.
    """

    def decorate(
        function: Callable[P, Result],
    ) -> Callable[P, Result]:
        name = function.__name__

        @wraps(function)
        def checked(*args: P.args, **kwargs: P.kwargs) -> Result:
            names = ("problem", "start", "targets", "options")
            values = dict(zip(names, args, strict=False)) | kwargs
            if "problem" in values:
                check_loaded(values["problem"], Problem, "problem")
            if isinstance(values.get("start"), Targets):
                message = f"start is Targets, not a pose; write {name}(problem, None, "
                raise TypeError(f"{message}targets) to start at the rest pose")
            if "targets" in values and "start" not in values:
                message = f"{name}() has no start; write {name}(problem, None, targets)"
                raise TypeError(f"{message} to start at the rest pose")
            if "targets" in values:
                check_loaded(values["targets"], Targets, "targets")
            if values.get("options") is not None:
                check_loaded(values["options"], options_class, "options")
            return function(*args, **kwargs)

        return checked

    return decorate
