"""Fluids: particles that pressure keeps as dense as at rest."""

from __future__ import annotations

from typing import TYPE_CHECKING

from animtool.systems.fluid.spec import FluidModel as Spec

if TYPE_CHECKING:
    from animtool.systems.fluid.fluid import Fluid
    from animtool.systems.simulation import SimContext

__all__ = ["Spec", "build"]


def build(spec: Spec, context: SimContext) -> Fluid:
    """Return a fluid at its beginning; what moves it is imported now."""
    from animtool.systems.fluid.fluid import Fluid

    return Fluid(spec, context)
