"""Validation of USD layers: animtool's checks and USD's own validators."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from animtool.usd.checks.run import check_layer as check_layer
    from animtool.usd.checks.run import inspect_layer as inspect_layer

__all__ = ["check_layer", "inspect_layer"]


def __getattr__(name: str) -> object:
    """Import the functions on first use."""
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from animtool.usd.checks import run

    return getattr(run, name)
