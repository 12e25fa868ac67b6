"""Particles of several systems that are one."""

from __future__ import annotations

from collections.abc import Sequence
from typing import cast

import numpy as np

from animtool._types import IntArray
from animtool.documents.document import Document, Location
from animtool.errors import Fault, OptionError
from animtool.scene.entries import SceneSystem
from animtool.scene.springs.bodies import SpringBody
from animtool.scene.springs.pins import Join, numbered
from animtool.scene.springs.setup import SpringSetup
from animtool.scene.springs.sharing import conflicts
from animtool.sim.springs import Solver
from animtool.sim.springs.options import check_keeping_apart


def check_joins(document: Document, members: Sequence[SceneSystem]) -> None:
    """Note what keeps systems from being one.

    Args:
        document: Where faults are noted.
        members: Those that are joined.
    """
    setups = [cast(SpringSetup, member.setup) for member in members]
    bodies = {
        member.name: setup.body for member, setup in zip(members, setups, strict=True)
    }
    for setup in setups:
        for join in setup.joins:
            for at, fault in _faults(join, bodies[join.system]):
                document.add(fault.code, at, fault.message, fault.hint)
    for i, key, before in conflicts(setups):
        message = f"{key} is another than that of {members[before].name}: they are "
        message += "joined, and simulated as one"
        at = (*setups[i].at, key)
        document.add("SIM054", at, message, "state it once, or twice the same")
    _check_solver(document, setups)


def _check_solver(document: Document, setups: Sequence[SpringSetup]) -> None:
    """Note a solver that does not keep apart what another system wants apart."""
    if not any(setup.self_contact for setup in setups):
        return
    for setup in setups:
        # One that wants it itself has been told.
        if setup.self_contact is None and "solver" in setup.given:
            try:
                check_keeping_apart(Solver(setup.options.solver))
            except OptionError as error:
                fault, at = error.faults[0], (*setup.at, "solver")
                document.add(fault.code, at, fault.message, fault.hint)


def _faults(join: Join, other: SpringBody) -> list[tuple[Location, Fault]]:
    numbers, faults = numbered(join.others, other)
    found = [((*join.at[1], i), fault) for i, fault in faults]
    if not faults and len(numbers) not in {1, len(join.particles)}:
        message = f"{len(join.particles)} particles are joined to {len(numbers)}"
        hint = "name as many, or one for all"
        found.append((join.at[1], Fault("SIM054", message, hint=hint)))
    return found


def join_pairs(
    names: Sequence[str], setups: Sequence[SpringSetup], starts: IntArray
) -> IntArray:
    """Return particles that become one with others, and these ``(J, 2)``.

    Args:
        names: Of the systems that are joined.
        setups: What they are made of.
        starts: Number of the first particle of each among all.
    """
    pairs = [np.zeros((0, 2), np.int64)]
    for setup, start in zip(setups, starts, strict=False):
        for join in setup.joins:
            k = list(names).index(join.system)
            others = np.array(numbered(join.others, setups[k].body)[0])
            two = np.broadcast_arrays(join.particles + start, others + starts[k])
            pairs.append(np.stack(two, axis=1))
    return np.concatenate(pairs)
