"""What of systems will tear, found by simulating them before they are written."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from animtool._types import BoolArray
from animtool.scene.entries import SceneSystem
from animtool.scene.progress import Progress
from animtool.scene.systems.character_motion import CharacterMotion
from animtool.scene.systems.links import simulated_with
from animtool.scene.systems.simulation import Tearable, located_systems, open_systems


def predicted_tears(
    systems: Sequence[SceneSystem],
    wanted: Sequence[int],
    times: Sequence[float],
    own: CharacterMotion | None = None,
    progress: Progress = None,
) -> Mapping[int, BoolArray]:
    """Return which springs of some systems are torn in the end ``(S,)``.

    A mesh that parts has all its points from the first frame on, so that it keeps its
    topology: what will tear must be known before anything is written. Systems that
    these do not need are left out, and do not change them.

    ``times`` [s].
    """
    numbers = simulated_with(systems, wanted)
    opened = open_systems([systems[i] for i in numbers], times[-1], own)
    found = {i: one for i, one in zip(numbers, opened, strict=True) if i in wanted}
    for k, t in enumerate(times):
        for i, one in found.items():
            with located_systems([systems[i]]):
                one.at(t)
        if progress is not None:
            progress((k + 1) / len(times))
    return {i: one.torn for i, one in found.items() if isinstance(one, Tearable)}
