"""Validation of USD layers: animtool's checks and USD's own validators."""

from __future__ import annotations

from typing import TYPE_CHECKING

from animtool.core.plugins import lazy_names

if TYPE_CHECKING:
    from animtool.usd.checks.run import check_layer as check_layer
    from animtool.usd.checks.run import inspect_layer as inspect_layer

__all__ = ["check_layer", "inspect_layer"]

if not TYPE_CHECKING:  # type checkers only know the imported names
    __getattr__, __dir__ = lazy_names(
        __name__, dict.fromkeys(__all__, "animtool.usd.checks.run")
    )
