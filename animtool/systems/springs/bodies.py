"""The particles and springs of an entry, with the names of places on them."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, TypeAlias

import numpy as np

from animtool._types import FloatArray, IntArray
from animtool.documents.check import FileModel
from animtool.documents.document import spelled
from animtool.errors import Fault, listed
from animtool.options import OF_ENTRY, range_faults
from animtool.systems.springs import Body, Family
from animtool.systems.springs.drawing import Shape

# Of many that are odd in the same way, those that are named.
MAX_NAMED = 5
# Particles of a system, at most: their springs fit into memory.
MOST = 10_000_000
# The least mass of a system, or of a particle that has one of its own [kg].
LIGHTEST = 1e-30
# By name; None are those left out.
Families: TypeAlias = Mapping[str, Family | None]


@dataclass(frozen=True, slots=True)
class SpringBody:
    """Particles and springs as an entry has them."""

    body: Body  # particles and springs, at rest where they are
    places: Mapping[str, IntArray]  # numbers of particles by the name of their place
    shape: Shape  # what is drawn of them
    notices: tuple[Fault, ...] = ()  # what is odd about them


@dataclass(slots=True)
class BodyEntry:
    """An entry that becomes a body, and what is wrong with it.

    What is in doubt has something that stands in for it, so that the rest is checked;
    what is noted otherwise leaves no body.
    """

    spec: Any
    parts: Mapping[str, Any]
    families: Families = field(default_factory=dict)
    mass: float = 1.0  # [kg]
    faults: list[Fault] = field(default_factory=list)
    sound: bool = True  # whether nothing was noted that leaves no body

    def add(self, fault: Fault, *keys: str | int, doubt: bool = False) -> None:
        """Add a fault at a key of the entry."""
        self.faults.append(replace(fault, where=spelled(keys)))
        self.sound &= doubt

    def note(
        self, code: str, message: str, *keys: str | int, hint: str | None = None
    ) -> None:
        """Note a fault at a key of the entry."""
        self.add(Fault(code, message, hint=hint), *keys)

    def doubt(
        self, code: str, message: str, *keys: str | int, hint: str | None = None
    ) -> None:
        """Note a fault of what something stands in for."""
        self.add(Fault(code, message, hint=hint), *keys, doubt=True)

    def mass_of(self, key: str, mass: float) -> float:
        """Return a mass; what is none is noted, and 1 kg stands in for it."""
        if mass >= LIGHTEST:
            return mass
        allowed = "above 0" if mass <= 0 else f"{LIGHTEST:g} kg or more"
        self.doubt("SIM040", f"its mass must be {allowed}, not {mass:g} kg", key)
        return 1.0


def families_of(entry: BodyEntry, model: FileModel) -> Families:
    """Return the families of springs of an entry.

    One of impossible numbers is noted, and one without force stands in for it.
    """
    entries = dict(model)
    families = {
        name: None if keys is None else _family(entry, name, dict(keys))
        for name, keys in entries.items()
    }
    if not any(families.values()):
        message = "it has no springs, and its particles fall apart"
        hint = f"give it some of {', '.join(entries)}"
        entry.doubt("SIM050", message, "springs", hint=hint)
    return families


def _family(entry: BodyEntry, name: str, keys: dict[str, Any]) -> Family:
    """Return a family; ropes and strands may have the axial stiffness instead."""
    axial, stiffness = keys.get("axial_stiffness"), keys.pop("stiffness")
    if not _has_one_stiffness(entry, name, stiffness, axial, keys["rest"]):
        return Family(0.0)
    keys.pop("ways", None)  # which diagonals they are
    family = Family(stiffness or 0.0, **keys)
    faults = range_faults(family, OF_ENTRY)
    if family.rest == 0 and (family.tear or 0) > 0:
        message, hint = "springs of no length tear at once", "leave tear out"
        faults.append(Fault("SIM042", message, hint=hint, where="tear"))
    for fault in faults:
        entry.add(fault, "springs", name, fault.where or "", doubt=True)
    return Family(0.0) if faults else family


def _has_one_stiffness(
    entry: BodyEntry,
    name: str,
    stiffness: float | None,
    axial: float | None,
    rest: float,
) -> bool:
    """Note a family that has both stiffnesses or none, or axial without length."""
    both = "stiffness [N/m] of each spring, or axial_stiffness [N], force over strain"
    if axial is None:
        if stiffness is not None:
            return True
        message, where = "it has no stiffness", []
    elif stiffness is not None:
        message = "it has both stiffness and axial_stiffness"
        where = ["axial_stiffness"]
    elif rest == 0:
        message = "springs without a length at rest have no axial_stiffness"
        where, both = ["axial_stiffness"], "stiffness, or a rest above 0"
    else:
        return True
    entry.doubt("SIM190", message, "springs", name, *where, hint=f"give {both}")
    return False


def check_grid(entry: BodyEntry, what: str, resolution: Sequence[int]) -> None:
    """Note a grid of too few particles some way, or of too many."""
    if min(resolution) < 2 or math.prod(resolution) > MOST:
        *first, last = resolution
        given = f"{listed(first)} and {last}"
        message = f"{what} has 2 particles or more each way, and {MOST} at most"
        message += f", not {given}"
        entry.note("SIM050", message, "resolution")


def refuse_keys(entry: BodyEntry, model: FileModel, keys: set[str], why: str) -> None:
    """Note keys that an entry gives, and that are for what it is not, and why."""
    for key in sorted(keys & model.model_fields_set):
        entry.note("SIM050", f"{key} {why}", key)


def share_out(
    sizes: FloatArray, counts: IntArray, corners: IntArray, points: int
) -> FloatArray:
    """Return each point's share ``(N,)`` [1] of cells that divide among corners.

    Cells have sizes ``(M,)`` and so many corners ``(M,)``, cell by cell. Shares come to
    1, or are all 0 where no cell has a size.
    """
    own = np.bincount(corners, np.repeat(sizes / counts, counts), points)
    total = float(own.sum())
    return np.asarray(own / (total if total > 0 else 1.0), np.float64)


def some_of(numbers: IntArray) -> str:
    """Return the first of some numbers, and how many more there are."""
    more = len(numbers) - MAX_NAMED
    text = ", ".join(map(str, numbers[:MAX_NAMED].tolist()))
    return f"{text} and {more} more" if more > 0 else text
