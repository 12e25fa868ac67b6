"""What is wrong with a USD layer: our checks, and those that USD brings along."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from animtool.usd.checks.run import check_layer as check_layer

__all__ = ["check_layer"]


def __getattr__(name: str) -> object:
    """Import `check_layer` when it is first used."""
    if name != "check_layer":
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from animtool.usd.checks.run import check_layer

    return check_layer
