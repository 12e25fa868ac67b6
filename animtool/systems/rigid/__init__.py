"""Rigid bodies: they fall, tumble, collide, stack and hang on joints."""

from __future__ import annotations

from typing import TYPE_CHECKING

from animtool.systems.rigid.spec import RigidModel as Spec

if TYPE_CHECKING:
    from animtool.systems.rigid.simulation import RigidSimulation
    from animtool.systems.simulation import SimContext

__all__ = ["Spec", "build"]


def build(spec: Spec, context: SimContext) -> RigidSimulation:
    """Return bodies at their beginning; what moves them is imported now."""
    from animtool.systems.rigid.simulation import RigidSimulation

    return RigidSimulation.of(spec, context)
