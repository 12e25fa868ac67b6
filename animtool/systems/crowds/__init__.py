"""Crowds: agents that walk to their goals and avoid each other."""

from __future__ import annotations

from typing import TYPE_CHECKING

from animtool.systems.crowds.spec import CrowdsModel as Spec

if TYPE_CHECKING:
    from animtool.systems.crowds.crowd import Crowd
    from animtool.systems.simulation import SimContext

__all__ = ["Spec", "build"]


def build(spec: Spec, context: SimContext) -> Crowd:
    """Return a crowd at its beginning; what moves it is imported now."""
    from animtool.systems.crowds.crowd import Crowd

    return Crowd(spec, context)
