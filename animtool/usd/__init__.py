"""Reads and writes USD; the only package that imports pxr."""

from __future__ import annotations

import sys
from importlib.machinery import ModuleSpec, PathFinder
from types import ModuleType
from typing import TYPE_CHECKING, Any, cast

from animtool.core.plugins import lazy_names
from animtool.core.process.signals import deferred_signals

if TYPE_CHECKING:
    from collections.abc import Sequence

    from animtool.usd.takes.author import write as write

_PUBLIC = {"write": "animtool.usd.takes.author"}

__all__ = sorted(_PUBLIC)  # noqa: PLE0605 - the table above is the list

if not TYPE_CHECKING:  # type checkers only know the imported names
    __getattr__, __dir__ = lazy_names(__name__, _PUBLIC)


class _PxrFinder:
    """Finds modules of pxr and protects their import from interrupts.

    USD's C++ loader imports the modules that a module needs, and continues if an
    interrupt ends one of these imports: the program would then run with half of USD.
    """

    @staticmethod
    def find_spec(
        name: str, path: Sequence[str] | None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        """Return the import spec of a pxr module; None for other modules."""
        if name.partition(".")[0] != "pxr":
            return None
        spec = PathFinder.find_spec(name, path, target)
        if spec is not None and spec.loader is not None:
            spec.loader = cast(Any, _UninterruptedLoader(spec.loader))
        return spec


class _UninterruptedLoader:
    """Delays signals until a module has been imported.

    It has the interface of `importlib.abc.Loader` without importing that, which loads
    40 modules.
    """

    def __init__(self, loader: Any) -> None:
        self._loader = loader

    def __getattr__(self, name: str) -> Any:
        return getattr(self._loader, name)

    def create_module(self, spec: ModuleSpec) -> ModuleType | None:
        """Return the new module, created by the original loader."""
        module: ModuleType | None = self._loader.create_module(spec)
        return module

    def exec_module(self, module: ModuleType) -> None:
        """Run a module while signals are deferred, with its original loader."""
        spec = module.__spec__
        assert spec is not None
        spec.loader = module.__loader__ = self._loader
        with deferred_signals():
            self._loader.exec_module(module)


sys.meta_path.insert(0, _PxrFinder)
