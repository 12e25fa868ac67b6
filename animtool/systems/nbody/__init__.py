"""N-body gravity: bodies and galaxies that attract each other."""

from __future__ import annotations

from typing import TYPE_CHECKING

from animtool.systems.nbody.spec import NbodyModel as Spec

if TYPE_CHECKING:
    from animtool.systems.nbody.nbody import Nbody
    from animtool.systems.simulation import SimContext

__all__ = ["Spec", "build"]


def build(spec: Spec, context: SimContext) -> Nbody:
    """Return bodies at their beginning; what moves them is imported now."""
    from animtool.systems.nbody.nbody import Nbody

    return Nbody(spec, context)
