"""Frames of one problem through time: smooth, without discontinuities, as a whole."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from animtool import _kernels
from animtool._types import ArrayLike, BoolArray, FloatArray, IntArray
from animtool.errors import Fault, OptionError
from animtool.ik.chain import BALL, difference, seamless, unwound
from animtool.ik.goals import COLUMNS, KINDS, WEIGHTS, Targets, TargetValue, by_unit
from animtool.ik.limbs import Extension, extend
from animtool.ik.problem import Problem
from animtool.ik.result import IkResult, IkStatus, Jump
from animtool.ik.solving import WARM_DAMPING, IkOptions, chain_targets, pose_rows
from animtool.ik.sub_rig import following
from animtool.maths import so3
from animtool.rig.joints import coordinate_slices

# Rounds of Gauss-Newton at most, each over all frames.
ROUNDS = 30
# Of the preference for where a path was when its speed is evened out.
HARDLY = 1e-6
# A joint jumps that moves by more than this [rad], or share of the chain's length, and
# this a second, and so many times what the targets move by, all together.
MIN_JUMP, MIN_SPEED, MORE_THAN_TARGETS = 0.1, 8.0, 4.0
# Slower ones are named too, where the joint moves so many times farther than within
# so many frames before and after.
MORE_THAN_NEIGHBOURS, NEIGHBOURS = 4.0, 2


@dataclass(frozen=True)
class Path:
    """Frames of one problem, as the solver takes them.

    Attributes:
        problem: What was asked.
        targets: ``(F, E, W)``.
        limbs: How far the limbs of eased and stretching goals go.
        drifts: Motion from frame to frame that is not to be evened out ``(F - 1, D)``.
        options: Tolerances.
    """

    problem: Problem
    targets: FloatArray
    limbs: Extension
    drifts: FloatArray
    options: IkOptions

    def frames(self, rows: slice) -> Path:
        """Return a stretch of it."""
        drifts = self.drifts[rows.start : rows.stop - 1]
        picked = np.arange(len(self.targets))[rows]
        targets, limbs = self.targets[rows], self.limbs[picked]
        return replace(self, targets=targets, limbs=limbs, drifts=drifts)

    def steps(self, poses: FloatArray) -> FloatArray:
        """Return how poses ``(F, C)`` move from frame to frame, less the drifts."""
        return difference(self.problem.chain, poses[:-1], poses[1:]) - self.drifts

    def smoothed(
        self, poses: FloatArray, acceleration: float
    ) -> tuple[FloatArray, FloatArray]:
        """Return poses ``(F, C)`` of less acceleration, and misses ``(F, E, 4)``."""
        weights = (1.0, 0.0, acceleration)
        return self._run(poses, weights, (0, len(poses)), ROUNDS)

    def evened(
        self, poses: FloatArray, *, opened: bool = False
    ) -> tuple[FloatArray, FloatArray]:
        """Return poses that go from the first to the last at an even speed.

        The last stays, and so does the first unless it is ``opened``.
        """
        moving = (0 if opened else 1, len(poses) - 1)
        return self._run(poses, (HARDLY, 1.0, 0.0), moving, ROUNDS)

    def measured(self, poses: FloatArray) -> FloatArray:
        """Return what poses miss ``(F, E, 4)``."""
        return self._run(poses, (1.0, 0.0, 0.0), (0, 0), 0)[1]

    def excesses(self, misses: FloatArray) -> FloatArray:
        """Return by how many tolerances each goal is missed ``(F, E)``."""
        tolerances = by_unit(self.options.tolerance, self.options.angle_tolerance)
        return np.asarray((misses / tolerances).max(axis=2, initial=0.0))

    def excess(self, misses: FloatArray) -> FloatArray:
        """Return by how many tolerances each frame misses its goals ``(F,)``."""
        return np.asarray(self.excesses(misses).max(axis=1, initial=0.0))

    def _run(
        self,
        poses: FloatArray,
        weights: tuple[float, float, float],
        moving: tuple[int, int],
        rounds: int,
    ) -> tuple[FloatArray, FloatArray]:
        chain = self.problem.chain
        smoothed = _kernels.smooth_ik(
            chain.nodes,
            chain.numbers,
            chain.goals,
            chain.goal_numbers,
            unwound(chain, poses),
            self.targets,
            self.limbs.sought,
            self.limbs.scales,
            self.drifts,
            *weights,
            *moving,
            self.options.tolerance,
            self.options.angle_tolerance,
            WARM_DAMPING,
            rounds,
        )
        return smoothed[0], smoothed[1]


def path_of(
    problem: Problem, targets: Targets, start: ArrayLike | None, options: IkOptions
) -> Path:
    """Return the frames of a problem; ``start`` ``(F, Q)`` is the motion they keep."""
    packed = chain_targets(problem, targets)
    drifts = np.zeros((max(len(packed) - 1, 0), problem.degrees))
    if start is not None and np.ndim(start) == 2:
        own = problem.chain.from_rig(pose_rows(problem, start, len(packed), "start"))
        drifts = difference(problem.chain, own[:-1], own[1:])
    return Path(problem, packed, extend(problem.limbs, packed), drifts, options)


def explained(path: Path, fps: float) -> FloatArray:
    """Return how far joints may go from frame to frame ``(F - 1,)``.

    In radians, and shares of the problem's length.
    """
    return np.asarray(MIN_JUMP + MIN_SPEED / fps + _by_targets(path))


def _by_targets(path: Path) -> FloatArray:
    """Return how far joints may go with their targets ``(F - 1,)``."""
    targets = path.targets
    weighed = targets[:, :, WEIGHTS] > 0
    asked = weighed[1:] & weighed[:-1]
    goals = np.array([goal.weights for goal in path.problem.goals]) > 0
    moves = np.stack(
        [_moves(kind.value, targets[:, :, COLUMNS[kind.name]]) for kind in KINDS],
        axis=2,
    )
    most = np.where(asked & goals, moves, 0.0).max(axis=(1, 2), initial=0.0)
    own = np.abs(path.drifts).max(axis=1, initial=0.0)
    return np.asarray(MORE_THAN_TARGETS * (most + own))


def _moves(value: TargetValue, targets: FloatArray) -> FloatArray:
    """Return how far targets ``(F, E, W)`` move ``(F - 1, E)``, or turn [rad]."""
    if value is TargetValue.ROTATION:
        return so3.angle_between(targets[1:], targets[:-1])
    return np.asarray(np.linalg.norm(np.diff(targets, axis=0), axis=2))


def strain(path: Path, poses: FloatArray, allowed: FloatArray) -> float:
    """Return the largest step of poses ``(F, C)``, in shares of what is a jump."""
    steps = np.abs(path.steps(poses)).max(axis=1, initial=0.0)
    return float((steps / allowed).max(initial=0.0))


def jumping(path: Path, poses: FloatArray, allowed: FloatArray) -> IntArray:
    """Return the frames to which a joint jumps."""
    steps = np.abs(path.steps(poses)).max(axis=1, initial=0.0)
    return np.flatnonzero(steps > allowed) + 1


def named(path: Path, poses: FloatArray, allowed: FloatArray) -> tuple[Jump, ...]:
    """Return the jumps of poses: frame, joint and size.

    Those too of joints that jerk, slower, out of rest and back to it. One from a limit
    to that a whole turn away is none: the joint stays as it is.
    """
    steps = np.abs(seamless(path.problem.chain, path.steps(poses)))
    joints = _joints(path.problem)
    jumps = []
    far = np.where((steps > allowed[:, None]) | _jerking(path, steps), steps, 0.0)
    for frame in np.flatnonzero(far.any(axis=1)) + 1:
        d = int(far[frame - 1].argmax())
        jumps.append(Jump(int(frame), joints[d], float(steps[frame - 1, d])))
    return tuple(jumps)


def _jerking(path: Path, steps: FloatArray) -> BoolArray:
    """Return which steps ``(F - 1, D)`` are far larger than those about them."""
    around = np.zeros_like(steps)
    for away in range(1, NEIGHBOURS + 1):
        around[away:] = np.maximum(around[away:], steps[:-away])
        around[:-away] = np.maximum(around[:-away], steps[away:])
    least = np.maximum(
        MORE_THAN_NEIGHBOURS * around, (MIN_JUMP + _by_targets(path))[:, None]
    )
    jerks = steps > least
    # Of the first and the last, nothing is known on one side.
    jerks[:1] = jerks[-1:] = False
    return np.asarray(jerks, np.bool_)


def _joints(problem: Problem) -> list[str]:
    """Return the joint of each degree of freedom."""
    rig, chain = problem.rig, problem.chain
    owners = [
        joint.name
        for joint, place in zip(rig.joints, coordinate_slices(rig), strict=True)
        for _ in range(place.stop - place.start)
    ]
    names: list[str] = []
    for kind, _, column, follows in chain.nodes[:, :4]:
        if not follows:
            name = owners[int(chain.columns[column])]
            names += [name] * (3 if kind == BALL else 1)
    return names


def smooth(
    result: IkResult,
    targets: Targets,
    seconds: float,
    *,
    fps: float,
    start: ArrayLike | None = None,
    options: IkOptions | None = None,
) -> IkResult:
    """Return the poses of a clip with less acceleration of the joints.

    Over all frames at once, the sum of ``|q - q0|^2 + seconds^4 |q''|^2`` is brought
    down, where q0 are the poses given: what the goals leave free and changes within
    less than ``seconds`` is evened out, a slower motion stays (the smoothing of
    E. Whittaker, On a new method of graduation, 1923, with second derivatives). Goals
    that are reached stay within the tolerance; in frames that miss one, all goals stay
    where these have them. Limits are kept.

    Args:
        result: F frames of one problem, in the order of time.
        targets: What was asked.
        seconds: Time over which motion is evened out [s]; 0 changes nothing, and .03
            to .3 serve most clips.
        fps: Frames a second.
        start: Poses ``(F, Q)`` of a clip whose own acceleration is kept; only that of
            the change from it is brought down.
        options: Tolerances.

    Raises:
        OptionError: ``seconds`` is less than 0 or ``fps`` not more than 0 (IK014);
            targets or start do not fit (IK010 to IK013).

    Limits of the method: the poses are the least near by; where a path has to turn
    from one way round to another, the turn stays. A goal that jumps makes joints jump.
    It holds the Jacobians of all frames, F M D numbers.
    """
    options = options or IkOptions()
    faults = rate_faults(seconds, fps)
    if faults:
        raise OptionError(faults)
    if seconds == 0 or len(result.coordinates) < 3:
        return result
    path = path_of(result.problem, targets, start, options)
    poses = result.problem.chain.from_rig(result.coordinates)
    poses, misses = path.smoothed(poses, (seconds * fps) ** 4)
    return at_poses(result, poses, misses, path)


def rate_faults(seconds: float, fps: float) -> list[Fault]:
    """Return what is wrong with a time to smooth over, and a rate."""
    faults = []
    if not (np.isfinite(seconds) and seconds >= 0):
        faults.append(Fault("IK014", f"smooth must be at least 0, not {seconds}"))
    if not (np.isfinite(fps) and fps > 0):
        faults.append(Fault("IK014", f"fps must be more than 0, not {fps}"))
    return faults


def at_poses(
    result: IkResult, poses: FloatArray, misses: FloatArray, path: Path
) -> IkResult:
    """Return a result with other poses of the chain ``(F, C)``."""
    chain = result.problem.chain
    met = path.excess(misses) <= 1
    statuses = tuple(
        IkStatus.CONVERGED
        if good
        else IkStatus.NEAREST
        if status is IkStatus.CONVERGED
        else status
        for good, status in zip(met, result.statuses, strict=True)
    )
    return replace(
        result,
        coordinates=following(
            result.problem.rig,
            chain.into_rig(poses, result.coordinates),
            result.problem.joints,
        ),
        statuses=statuses,
        misses=misses * by_unit(chain.length, 1.0),
        reached=path.excesses(misses) <= 1,
    )
