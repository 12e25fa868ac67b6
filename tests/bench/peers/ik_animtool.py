"""animtool: many problems in a call, or with ``single`` a session's call for each."""

import sys
from collections.abc import Iterator

import numpy as np
from adapters.ik import from_file, read_goals, read_rig, to_file
from clock import Taken, now, since
from ik_problems import PARTS, Array, Case
from ik_serve import Asked, Solved, Solver, serve

from animtool.ik import IkOptions, Session, Targets, build, solve
from animtool.maths import so3
from animtool.rig.joints import local_from_coordinates
from animtool.rig.kinematics import forward_kinematics


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
        world = forward_kinematics(rig, local.translations, local.rotations)
        owners = self.case.owners
        turns, points = world.linear[0, owners], world.positions[0, owners]
        offsets = np.array([e["offset"] for e in self.case.effectors])
        return turns, points + (turns @ offsets[..., None])[..., 0]

    def solve(self, starts: Array, frames: range, asked: Asked) -> Iterator[Solved]:
        yield from self._call(starts, frames, self._options(asked))

    def follow(self, start: Array, frames: range, asked: Asked) -> Iterator[Solved]:
        yield from self._call(start, frames, self._options(asked, warm=True))

    def _options(self, asked: Asked, *, warm: bool = False) -> IkOptions:
        share = asked.position / self.problem.length
        return IkOptions(tolerance=share, angle_tolerance=asked.angle, warm=warm)

    def _call(
        self, starts: Array, frames: range, options: IkOptions
    ) -> Iterator[Solved]:
        """Yield what one call for all frames gives.

        A problem's wall time is what the solver counted for it, and an even share of
        the rest of the call; its CPU time is an even share of that of the call.
        """
        given = from_file(self.case.model, starts)
        given = given if starts.ndim > 1 else given[0]
        targets = self._targets(slice(frames.start, frames.stop))
        began = now()
        result = solve(self.problem, given, targets, options)
        taken = since(began)
        rest = (taken.wall - result.seconds.sum()) / len(frames)
        poses = to_file(self.case.model, result.coordinates)
        for pose, seconds in zip(poses, result.seconds.tolist(), strict=True):
            yield pose, Taken(seconds + rest, taken.cpu / len(frames))

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
    """The same with a session, and a call of it for each problem."""

    def solve(self, starts: Array, frames: range, asked: Asked) -> Iterator[Solved]:
        session = self._session(self._options(asked))
        for start, frame in zip(starts, frames, strict=True):
            yield self._one(session, start, frame)

    def follow(self, start: Array, frames: range, asked: Asked) -> Iterator[Solved]:
        session, pose = self._session(self._options(asked, warm=True)), start
        for frame in frames:
            pose, taken = self._one(session, pose, frame)
            yield pose, taken

    def _session(self, options: IkOptions) -> Session:
        return Session(self.problem.rig, *self.problem.goals, options=options)

    def _one(self, session: Session, start: Array, frame: int) -> Solved:
        (given,) = from_file(self.case.model, start)
        fields = (self.targets.positions, self.targets.rotations, self.targets.aims)
        parts = [np.asarray(field)[frame] for field in fields if field is not None]
        values = {
            goal.joint: tuple([part[e] for part in parts])
            for e, goal in enumerate(self.problem.goals)
        }
        began = now()
        result = session.solve(values, start=given)
        taken = since(began)
        return to_file(self.case.model, result.coordinates)[0], taken


def build_case(case: Case) -> Solver:
    return (Single if "single" in sys.argv[1:] else Animtool)(case)


if __name__ == "__main__":
    serve(build_case)
