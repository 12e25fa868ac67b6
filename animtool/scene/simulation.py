"""What a scene simulates, under way."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, Protocol, TypeAlias, cast

from animtool.errors import Fault
from animtool.plugins import load_object
from animtool.scene.entries import SceneSystem
from animtool.scene.system_kinds import SYSTEM_KINDS, SystemSetup

__all__ = ["Simulation", "open_systems"]


class Simulation(Protocol):
    """A system under way."""

    @property
    def notices(self) -> list[Fault]:
        """What is odd about it so far."""

    def at(self, t: float) -> Any:
        """Return what there is at a time [s], as the writer of its kind takes it.

        Times do not descend.
        """


Opener: TypeAlias = Callable[[SystemSetup], Simulation]


def open_systems(systems: Sequence[SceneSystem]) -> list[Simulation]:
    """Return systems at their beginnings; the first frame is at 0 s.

    Raises:
        FormatError: Something makes no sense, at the place of its system.
    """
    opened = []
    for system in systems:
        opener = cast(Opener, load_object(SYSTEM_KINDS[system.kind].opener))
        with system.place.blamed():
            opened.append(opener(system.setup))
    return opened
