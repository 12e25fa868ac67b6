"""USD layers, read and written: the only package that imports pxr."""

from __future__ import annotations

from typing import TYPE_CHECKING

from animtool.lazy import lazy_names

if TYPE_CHECKING:
    from animtool.usd.takes import write as write

_PUBLIC = {"write": "animtool.usd.takes"}

__all__ = sorted(_PUBLIC)  # noqa: PLE0605 - the table above is the list

__getattr__, __dir__ = lazy_names(__name__, _PUBLIC)
