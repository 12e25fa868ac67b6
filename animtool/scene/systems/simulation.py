"""What a scene simulates, under way."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import (
    TYPE_CHECKING,
    Any,
    Protocol,
    TypeAlias,
    cast,
    runtime_checkable,
)

from animtool._types import BoolArray, FloatArray
from animtool.errors import Fault, FormatError, OptionError, ToleranceError
from animtool.plugins import load_object
from animtool.scene.entries import SceneSystem
from animtool.scene.progress import Phases, Progress, TimeProgress
from animtool.scene.systems.character_motion import CharacterMotion, CharacterMotions
from animtool.scene.systems.links import in_order, needed
from animtool.systems.kinds import SYSTEM_KINDS

if TYPE_CHECKING:
    from animtool.sim.trials.trial import Trial


class RunningSystem(Protocol):
    """A system under way."""

    @property
    def notices(self) -> list[Fault]:
        """What is odd about it so far."""

    def at(self, t: float) -> Any:
        """Return what there is at a time [s], as the writer of its kind takes it.

        Times do not descend.
        """

    def report(self) -> dict[str, object]:
        """Return what became of it so far, as plain values; nothing to say is none."""


@runtime_checkable
class Tearable(RunningSystem, Protocol):
    """A system under way whose surface may part."""

    @property
    def tears(self) -> bool:
        """Whether it may, as it is made."""

    @property
    def torn(self) -> BoolArray:
        """Which of its springs are torn so far ``(S,)``."""

    def part(self, torn: BoolArray) -> None:
        """Draw it so that it can part where springs of it will tear ``(S,)``."""


@dataclass(frozen=True, slots=True)
class SystemProgress:
    """Where systems tell how far they are."""

    phases: Phases  # of what comes before the first frame
    times: TimeProgress  # of the simulation itself


@dataclass
class Opening:
    """What systems that are opened may ask for."""

    last: float  # the last time that will be asked for [s]
    # Characters in motion, each read once.
    characters: CharacterMotions = field(default_factory=CharacterMotions)
    # Systems that are open, by name.
    opened: dict[str, RunningSystem] = field(default_factory=dict)
    # Where they tell how far they are; None where nobody looks.
    progress: SystemProgress | None = None

    def phase(self) -> Progress:
        """Return what work before the first frame tells its share."""
        return None if self.progress is None else self.progress.phases.phase()

    def clock(self, begin: float) -> Progress:
        """Return what a system tells the time that it reached, from its begin on."""
        return None if self.progress is None else self.progress.times.clock(begin)


# From systems that are simulated as one to these at their beginnings.
Opener: TypeAlias = Callable[[Sequence[SceneSystem], Opening], Sequence[RunningSystem]]


# From systems that are simulated as one, what opens those that they need, each time
# anew, and times to look at ``(F,)`` [s], to what can be simulated in several ways.
TrialMaker: TypeAlias = Callable[
    [Sequence[SceneSystem], Callable[[], Opening], FloatArray], "Trial"
]


@contextmanager
def located_systems(members: Sequence[SceneSystem]) -> Iterator[None]:
    """Give faults that have no file the place of systems that are simulated as one.

    That is of the first that has the key that a fault names, else of the first.
    """

    def put(fault: Fault) -> Fault:
        having = (one for one in members if one.place.key_of(fault))
        return next(having, members[0]).place.put(fault)

    try:
        yield
    except OptionError as error:
        raise FormatError(list(map(put, error.faults))) from error
    except ToleranceError as error:
        raise ToleranceError(list(map(put, error.faults))) from error


def open_systems(
    systems: Sequence[SceneSystem],
    last: float = 0.0,
    own: CharacterMotion | None = None,
    progress: SystemProgress | None = None,
) -> list[RunningSystem]:
    """Return systems at their beginnings, in their order; the first frame is at 0 s.

    ``last`` [s].
    """
    opening = Opening(last, _characters(own), progress=progress)
    return _opened(systems, opening)


def _opened(systems: Sequence[SceneSystem], opening: Opening) -> list[RunningSystem]:
    """Return systems at their beginnings, of which the opening takes note."""
    found: dict[int, RunningSystem] = {}
    for group in in_order(systems):
        members = [systems[i] for i in group]
        opener = cast(Opener, load_object(SYSTEM_KINDS[members[0].kind].opener))
        with located_systems(members):
            made = opener(members, opening)
        found |= dict(zip(group, made, strict=True))
        named = zip(members, made, strict=True)
        opening.opened |= {member.name: one for member, one in named}
    return [found[i] for i in range(len(systems))]


def _characters(own: CharacterMotion | None) -> CharacterMotions:
    characters = CharacterMotions()
    if own is not None:
        characters.found[own.path] = own
    return characters


def system_trials(
    systems: Sequence[SceneSystem],
    times: FloatArray,
    own: CharacterMotion | None = None,
) -> list[tuple[SceneSystem, Trial]]:
    """Return what can be simulated in several ways, with the first system of each.

    ``times`` ``(F,)`` [s].
    """
    last, characters = float(times[-1]), _characters(own)
    found = []
    for group in in_order(systems):
        members = [systems[i] for i in group]
        others = [systems[i] for i in needed(systems, group)]

        def rebuild(others: Sequence[SceneSystem] = others) -> Opening:
            opening = Opening(last, characters)
            _opened(others, opening)
            return opening

        maker = cast(TrialMaker, load_object(SYSTEM_KINDS[members[0].kind].trial))
        with located_systems(members):
            found.append((members[0], maker(members, rebuild, times)))
    return found
