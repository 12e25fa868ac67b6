"""Flocks: members that attract, align and repel those whom they see."""

from __future__ import annotations

from typing import TYPE_CHECKING

from animtool.systems.flocks.spec import FlocksModel as Spec

if TYPE_CHECKING:
    from animtool.systems.flocks.flock import Flock
    from animtool.systems.simulation import SimContext

__all__ = ["Spec", "build"]


def build(spec: Spec, context: SimContext) -> Flock:
    """Return a flock at its beginning; what moves it is imported now."""
    from animtool.systems.flocks.flock import Flock

    return Flock(spec, context)
