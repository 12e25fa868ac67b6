"""animtool: many problems in a call, or with ``single`` a call for each."""

import sys
import time
from collections.abc import Iterator

import numpy as np
from adapters.ik import from_file, read_goals, read_rig, to_file
from ik_problems import PARTS, Array, Case
from ik_serve import Asked, Solver, serve

from animtool.ik import IkOptions, Targets, build, solve
from animtool.maths import so3
from animtool.rig.joints import local_from_coordinates
from animtool.rig.kinematics import forward

CALLS = 3


class Animtool:
    """One problem of animtool's, with its rig."""

    def __init__(self, case: Case) -> None:
        self.case = case
        keys = {"pos": "pos", "rot": "quat", "aim": "aim"}
        wanted = {keys[part]: part for part in PARTS if part in case.targets}
        goals = read_goals(case.effectors, [wanted] * len(case.effectors))
        self.problem = build(read_rig(case.model), goals)
        given = case.targets
        turns = so3.from_matrix(given["rot"]) if "rot" in given else None
        self.targets = Targets(given.get("pos"), turns, given.get("aim"))

    def places(self, pose: Array) -> tuple[Array, Array]:
        rig = self.problem.rig
        local = local_from_coordinates(rig, from_file(self.case.model, pose))
        world = forward(rig, local.translations, local.rotations)
        owners = self.case.owners
        turns, points = world.linear[0, owners], world.positions[0, owners]
        offsets = np.array([e["offset"] for e in self.case.effectors])
        return turns, points + (turns @ offsets[..., None])[..., 0]

    def solve(
        self, starts: Array, frames: range, asked: Asked
    ) -> Iterator[tuple[Array, float]]:
        yield from self._call(starts, frames, self._options(asked))

    def follow(
        self, start: Array, frames: range, asked: Asked
    ) -> Iterator[tuple[Array, float]]:
        yield from self._call(start, frames, self._options(asked, warm=True))

    def _options(self, asked: Asked, *, warm: bool = False) -> IkOptions:
        share = asked.position / self.problem.length
        return IkOptions(tolerance=share, angle_tolerance=asked.angle, warm=warm)

    def _call(
        self, starts: Array, frames: range, options: IkOptions
    ) -> Iterator[tuple[Array, float]]:
        """Yield what one call for all frames gives.

        A problem's seconds are those that the solver counted for it, and an even
        share of those that the call took beside, of the call with the least of these.
        """
        given = from_file(self.case.model, starts)
        given = given if starts.ndim > 1 else given[0]
        targets = self._targets(slice(frames.start, frames.stop))
        least = np.inf
        # A pause in the rest of a call would fall on every problem of it.
        for _ in range(CALLS if len(frames) > 1 else 1):
            began = time.perf_counter()
            result = solve(self.problem, given, targets, options)
            seconds = time.perf_counter() - began
            rest = (seconds - result.seconds.sum()) / len(frames)
            if rest < least:
                least, best = rest, result
        poses = to_file(self.case.model, best.coordinates)
        yield from zip(poses, (best.seconds + least).tolist(), strict=True)

    def _targets(self, rows: slice) -> Targets:
        return Targets(
            *(
                None if part is None else np.asarray(part)[rows]
                for part in (
                    self.targets.positions,
                    self.targets.rotations,
                    self.targets.aims,
                )
            )
        )


class Single(Animtool):
    """The same with a call for each problem."""

    def solve(
        self, starts: Array, frames: range, asked: Asked
    ) -> Iterator[tuple[Array, float]]:
        options = self._options(asked)
        for start, frame in zip(starts, frames, strict=True):
            yield from self._call(start, range(frame, frame + 1), options)


def build_case(case: Case) -> Solver:
    return (Single if "single" in sys.argv[1:] else Animtool)(case)


if __name__ == "__main__":
    serve(build_case)
