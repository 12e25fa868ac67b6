"""Old names of modules, attributes and arguments, which still work but warn."""

from __future__ import annotations

import sys
import warnings
from functools import wraps
from importlib import import_module
from importlib.machinery import ModuleSpec
from typing import TYPE_CHECKING, Any, ParamSpec, TypeVar, cast

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence
    from types import ModuleType

OLD_NAMES = {
    "animtool.clock": "animtool.core.clock",
    "animtool.errors": "animtool.core.errors",
    "animtool.markers": "animtool.motion.markers",
    "animtool.mocap": "animtool.capture",
    "animtool.mocap.cameras": "animtool.capture.cameras",
    "animtool.mocap.face": "animtool.capture.face",
    "animtool.mocap.retarget": "animtool.retarget",
    "animtool.passes": "animtool.motion.passes",
    "animtool.readers": "animtool.core.readers",
    "animtool.rules": "animtool.core.rules",
    "animtool.systems.colours": "animtool.systems.framework.colours",
    "animtool.systems.fields": "animtool.systems.framework.fields",
    "animtool.systems.interacting": "animtool.systems.framework.interacting",
    "animtool.systems.kinds": "animtool.systems.framework.kinds",
    "animtool.systems.simulation": "animtool.systems.framework.simulation",
    "animtool.systems.surfaces": "animtool.systems.framework.surfaces",
    "animtool.systems.particles.places": "animtool.systems.particles.emitter_shapes",
    "animtool.take": "animtool.motion.take",
}


def new_name(name: str) -> str | None:
    """Return the current name of a renamed module or its submodule; None for others."""
    parent_name, _, child_name = name.rpartition(".")
    if name in OLD_NAMES or not parent_name:
        return OLD_NAMES.get(name)
    parent = new_name(parent_name)
    return parent and f"{parent}.{child_name}"


class _OldNameFinder:
    """Import finder of renamed modules by their old names.

    The class has the methods that ``importlib.abc`` requires of a finder and a loader;
    importing that module would load 40 others.
    """

    def create_module(self, _: ModuleSpec) -> None:
        """Return None: Python creates the module as usual."""

    def find_spec(
        self, name: str, _path: Sequence[str] | None, _: ModuleType | None = None
    ) -> ModuleSpec | None:
        """Return the module spec of an old name; None for other names."""
        if not new_name(name):
            return None
        # From now on first, since later finders would find modules below the new name.
        sys.meta_path.remove(cast(Any, self))
        sys.meta_path.insert(0, cast(Any, self))
        return ModuleSpec(name, cast(Any, self))

    def exec_module(self, module: ModuleType) -> None:
        """Replace a module under an old name by the module of the new name."""
        new_module = new_name(module.__name__)
        assert new_module is not None
        text = f"{module.__name__} is now called {new_module}"
        warnings.warn(text, DeprecationWarning, stacklevel=2)
        sys.modules[module.__name__] = import_module(new_module)


Parameters = ParamSpec("Parameters")
Result = TypeVar("Result")


class _OldAttribute:
    """Descriptor of an old attribute name that returns the renamed attribute."""

    def __init__(self, old_name: str, new_name: str) -> None:
        self.old_name, self.new_name = old_name, new_name

    def __get__(self, instance: Any, owner: type) -> Any:
        """Return the attribute of the new name and warn."""
        _warn(f"{owner.__name__}.{self.old_name}", self.new_name)
        return getattr(owner if instance is None else instance, self.new_name)


def rename_attributes(owner: type, **new_names: str) -> None:
    """Make attributes of a class accessible by their old names.

    >>> class Box:
    ...     size = 3
    >>> rename_attributes(Box, extent="size")
    >>> with warnings.catch_warnings(action="ignore"):
    ...     Box().extent
    3
    """
    for old_name, new_name in new_names.items():
        setattr(owner, old_name, _OldAttribute(old_name, new_name))


def renamed_arguments(
    **new_names: str,
) -> Callable[[Callable[Parameters, Result]], Callable[Parameters, Result]]:
    """Return a decorator that lets a function accept old names of its arguments.

    >>> @renamed_arguments(extent="size")
    ... def half(size: float) -> float:
    ...     return size / 2
    >>> with warnings.catch_warnings(action="ignore"):
    ...     half(extent=3.0)
    1.5
    """

    def decorate(
        function: Callable[Parameters, Result],
    ) -> Callable[Parameters, Result]:
        @wraps(function)
        def call_with_new_names(
            *args: Parameters.args, **keyword_arguments: Parameters.kwargs
        ) -> Result:
            for old_name, new_name in new_names.items():
                if old_name in keyword_arguments:
                    name = function.__qualname__.removesuffix(".__init__")
                    _warn(f"{name}({old_name}=)", new_name)
                    keyword_arguments[new_name] = keyword_arguments.pop(old_name)
            return function(*args, **keyword_arguments)

        return call_with_new_names

    return decorate


def old_objects(module: str, **objects: type) -> Callable[[str], type]:
    """Return the ``__getattr__`` of a module whose classes have old names.

    objects: Classes by their old names.
    """

    def find_object(name: str) -> type:
        if name not in objects:
            raise AttributeError(f"module {module!r} has no attribute {name!r}")
        _warn(f"{module}.{name}", objects[name].__name__)
        return objects[name]

    return find_object


def _warn(old_text: str, new_text: str) -> None:
    warnings.warn(
        f"{old_text} is now called {new_text}", DeprecationWarning, stacklevel=3
    )


# Added last: used only when an old name is imported.
sys.meta_path.append(cast(Any, _OldNameFinder()))
