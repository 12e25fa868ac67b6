"""What a targets file asks for."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path

from animtool.errors import Fault
from animtool.ik.file import load_targets
from animtool.ik.tracks import PARTS
from animtool.rates import rate_label


@dataclass(frozen=True, slots=True)
class GoalDescription:
    """A goal in words.

    Attributes:
        effector: As the file names it.
        asks: Which parts it gives a value.
        held: Its held spans, first and last frame.
    """

    effector: str
    asks: tuple[str, ...]
    held: tuple[tuple[float, float], ...]


@dataclass(frozen=True, slots=True)
class TargetsDescription:
    """A targets file, its effectors not compared with a rig.

    Attributes:
        path: The file.
        fps: Frames a second; empty where it does not say.
        first: First frame, of its range or of all that it mentions.
        last: Last frame.
        goals: Its goals.
        notices: What is odd about it.
    """

    path: Path
    fps: str
    first: float
    last: float
    goals: tuple[GoalDescription, ...]
    notices: tuple[Fault, ...]

    def as_dict(self) -> dict[str, object]:
        """Return it as plain values for a JSON report."""
        notices = [notice.as_dict() for notice in self.notices]
        return {**asdict(self), "path": str(self.path), "notices": notices}


def describe_targets(path: Path) -> TargetsDescription:
    """Return what a targets file asks for.

    Raises:
        FormatError: It is malformed, with every fault that shows without a rig.
    """
    tracks = load_targets(path)
    clock = tracks.clock
    goals = tuple(
        GoalDescription(
            track.name,
            tuple(part for part in PARTS if track.goal.weights[PARTS.index(part)]),
            track.spans,
        )
        for track in tracks.goals
    )
    return TargetsDescription(
        path,
        "" if tracks.fps is None else rate_label(tracks.fps),
        float(clock.start),
        float(clock.start + (clock.count - 1) * clock.step),
        goals,
        tracks.notices,
    )
