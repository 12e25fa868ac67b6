"""Molecular dynamics: Lennard-Jones atoms and charges in a periodic box."""

from __future__ import annotations

from typing import TYPE_CHECKING

from animtool.systems.molecules.spec import MoleculesModel as Spec

if TYPE_CHECKING:
    from animtool.systems.molecules.molecules import Molecules
    from animtool.systems.simulation import SimContext

__all__ = ["Spec", "build"]


def build(spec: Spec, context: SimContext) -> Molecules:
    """Return atoms at their beginning; what moves them is imported now."""
    from animtool.systems.molecules.molecules import Molecules

    return Molecules(spec, context)
