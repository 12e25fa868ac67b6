"""What systems that are joined have in common."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from animtool._types import FloatArray
from animtool.scene.springs.setup import SpringSetup, Wind
from animtool.sim.springs import SelfContact, SpringOptions

_OPTIONS = ("solver", "step", "error", "stretch")
_OWN = ("gravity", "radius", "speed_limit", "self_contact", "preroll", "settle")


@dataclass(frozen=True, slots=True, eq=False)
class Shared:
    """How a system of bodies is simulated.

    Attributes:
        options: Solver and steps.
        gravity: ``(3,)`` [m/s²].
        radius: What is kept from colliders [m].
        speed_limit: Pins that go faster were put elsewhere [m/s].
        self_contact: How they keep apart from themselves and each other.
        preroll: Time before 0 s that they begin in [s].
        settle: Whether they begin at rest.
        wind: The air that faces bear; None is none.
    """

    options: SpringOptions
    gravity: FloatArray
    radius: float
    speed_limit: float
    self_contact: SelfContact | None
    preroll: float
    settle: bool
    wind: Wind | None


def shared(setups: Sequence[SpringSetup]) -> Shared:
    """Return what bodies have in common: what any of them states."""
    first = setups[0]
    found = {name: _value(first, name) for name in (*_OPTIONS, *_OWN)}
    for setup in setups:
        found |= {name: _value(setup, name) for name in found if name in setup.given}
    options = {name: found.pop(name) for name in _OPTIONS}
    return Shared(replace(first.options, **options), wind=_faced(setups), **found)


def conflicts(setups: Sequence[SpringSetup]) -> Iterator[tuple[int, str, int]]:
    """Yield what bodies that are joined state differently.

    Yields:
        The body, the key, and the body that states it before.
    """
    meets = any(setup.colliders or setup.characters or setup.meshes for setup in setups)
    for name in (*_OPTIONS, *_OWN, "wind"):
        if name == "radius" and not meets:
            continue
        stating = [i for i, setup in enumerate(setups) if _states(setup, name)]
        for i in stating[1:]:
            one, other = (_value(setups[k], name) for k in (stating[0], i))
            if not _same(one, other):
                yield i, name, stating[0]


def _states(setup: SpringSetup, name: str) -> bool:
    if name == "wind":
        return setup.wind is not None and setup.wind.faces is not None
    return name in setup.given


def _value(setup: SpringSetup, name: str) -> Any:
    return getattr(setup.options if name in _OPTIONS else setup, name)


def _same(one: Any, other: Any) -> bool:
    if isinstance(one, Wind):
        return one.same(other)
    return bool(np.array_equal(one, other))


def _faced(setups: Sequence[SpringSetup]) -> Wind | None:
    winds = [setup.wind for setup in setups if _states(setup, "wind")]
    return winds[0] if winds else None
