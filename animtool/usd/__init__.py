"""USD layers, read and written: the only package that imports pxr."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from animtool.usd.takes import write as write

__all__ = ["write"]


def __getattr__(name: str) -> object:
    """Import `write` when it is first used."""
    if name != "write":
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from animtool.usd.takes import write

    globals()[name] = write
    return write
