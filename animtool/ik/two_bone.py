"""The limb of two bones, in closed form: a ball, then a pin across both, or two balls.

The elbow opens until the tip is as far from the root as its target is, then the
shoulder turns it there by the shortest way, and about the line to the target until the
elbow lies towards the pole.
"""

from __future__ import annotations

import numpy as np

from animtool.core.array_types import BoolArray, FloatArray
from animtool.core.record import dataclass
from animtool.ik.chain import BALL, PIN, Chain
from animtool.ik.goals import COLUMNS, PARTS, WEIGHT
from animtool.ik.problem import Problem
from animtool.maths import so3

# A pin is across a bone within this [1].
ACROSS = 1e-12
# Lengths below this share of the limb's are none.
NO_LENGTH = 1e-12


@dataclass(frozen=True, slots=True)
class LimbSolution:
    """Poses of a limb, lengths in shares of the problem's."""

    coordinates: FloatArray  # of the chain ``(B, C)``
    misses: FloatArray  # of position, orientation, aim and pole ``(B, 1, 4)``
    # Rows that keep the limits ``(B,)``; the others need another solver.
    valid: BoolArray


def misfit(problem: Problem) -> str | None:
    """Return why a problem is no limb of two bones with one position to reach."""
    nodes, goal = problem.chain.nodes, problem.goals[0]
    if len(problem.goals) != 1:
        return "the problem has more than one goal"
    asked = {kind.name for kind in goal.kinds}
    if "position" not in asked or not asked <= {"position", "pole"}:
        return "the goal is not a position, with or without a pole"
    if problem.rest_weight > 0:
        return "a pose is preferred"
    # A ball that hangs on nothing, and a joint of its own on it.
    if nodes[:, :2].tolist() != [[BALL, -1], [nodes[-1, 0], 0]] or nodes[1, 3]:
        return "the joints that move are not a ball joint and a child of it"
    return _stiffness(problem.chain)


def fits(problem: Problem) -> bool:
    """Return whether a problem is a limb of two bones with one position to reach."""
    return misfit(problem) is None


def _stiffness(chain: Chain) -> str | None:
    """Return why the joints do not open, close and turn the limb all the way."""
    if not _unlimited(chain.numbers[0]):
        return "its first joint has limits"
    upper, lower = (bone[0] for bone in _bones(chain, np.ones((1, 1))))
    if min(np.linalg.norm(upper), np.linalg.norm(lower)) < NO_LENGTH:
        return "a bone has no length"
    if chain.nodes[1, 0] == BALL:
        limited = not _unlimited(chain.numbers[1])
        return "its second joint is a ball with limits" if limited else None
    axis = _rest(chain, 1)[:, 2]
    bone, tool = chain.goal_numbers[0, 2], chain.goal_numbers[0, 5]
    across = max(abs(axis @ upper), abs(bone), abs(tool))
    plain = chain.numbers[1, 12] == 1 and chain.numbers[1, 13] == 0
    if chain.nodes[1, 0] == PIN and plain and across < ACROSS:
        return None
    return "its second joint does not rotate about an axis across both bones"


def solve_limb(
    problem: Problem,
    starts: FloatArray,
    targets: FloatArray,
    sought: FloatArray,
    scales: FloatArray,
) -> LimbSolution:
    """Return the poses of limbs from the chain's coordinates and packed targets.

    Args:
        problem: One that `fits`.
        starts: ``(B, C)``: the side to which a pin bends, and the way a limb without
            pole is turned.
        targets: ``(B, 1, W)``, that misses are told of.
        sought: The same, brought into reach where extension eases out.
        scales: What the bones are multiplied by ``(B, 1)``.

    Limits of the method: a target within 1e-12 of the root, or one exactly behind the
    start's direction, leaves the plane of the limb open without a pole; a pole on the
    line from root to target leaves it as it was.
    """
    chain = problem.chain
    base = chain.numbers[0, 9:12]
    upper, lower = _bones(chain, scales)
    q = starts.copy()
    # A pole by itself is no matter of reach: another solver turns the limb to it.
    placed, poled = active_goals(problem, targets)
    towards = sought[:, 0, :3] - base
    distance = np.linalg.norm(towards, axis=1)
    lengths = np.linalg.norm(upper, axis=1), np.linalg.norm(lower, axis=1)
    opened = bend(*lengths, distance)
    valid = _open_elbow(chain, q, upper, lower, opened)
    tip = _tip(chain, q, upper, lower)
    _turn_shoulder(chain, q, tip, towards)
    if poled.any():
        pole = targets[:, 0, COLUMNS["pole"]] - base
        _turn_to_pole(chain, q, upper, towards, np.where(poled[:, None], pole, 0.0))
    q[~placed] = starts[~placed]
    misses = np.zeros((len(q), 1, len(PARTS)))
    reached = so3.rotate(_world(chain, q), tip)
    away = np.linalg.norm(targets[:, 0, :3] - base - reached, axis=1)
    misses[:, 0, PARTS.index("position")] = np.where(placed, away, 0.0)
    if poled.any():
        angle = _angle_about(reached, so3.rotate(_world(chain, q), upper), pole)
        misses[:, 0, PARTS.index("pole")] = np.where(poled, np.abs(angle), 0.0)
    return LimbSolution(q, misses, np.where(placed, valid, ~poled))


def active_goals(problem: Problem, targets: FloatArray) -> tuple[BoolArray, BoolArray]:
    """Return where the limb's position and its pole are asked for ``(B,)`` each."""
    goal = problem.goals[0]
    placed, poled = (targets[:, 0, WEIGHT[part]] for part in ("position", "pole"))
    return goal.position * placed > 0, goal.pole * poled > 0


def _unlimited(numbers: FloatArray) -> bool:
    low_side = np.array([np.inf, np.inf, -np.inf, np.inf])
    return bool((numbers[14:18] == low_side).all())


def _rest(chain: Chain, node: int) -> FloatArray:
    return chain.numbers[node, :9].reshape(3, 3)


def _bones(chain: Chain, scales: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the upper bones in the shoulder's frame, the lower in the elbow's."""
    bone, tool = chain.goal_numbers[0, :3], chain.goal_numbers[0, 3:6]
    return scales * chain.numbers[1, 9:12], scales * bone + tool


def bend(a: FloatArray, b: FloatArray, distance: FloatArray) -> FloatArray:
    """Return the angle between two bones' directions, 0 where straight.

    Args:
        a: Length of the upper bone ``(B,)``.
        b: Of the lower.
        distance: From root to tip, brought into reach.

    >>> bend(np.ones(2), np.ones(2), np.array([2.0, 0.0])).round(6).tolist()
    [0.0, 3.141593]
    """
    reach = np.clip(distance, np.abs(a - b), a + b)
    # The half-angle form keeps its digits at both ends.
    short = (a + b - reach) * (a + b + reach)
    long = (reach - (a - b)) * (reach + (a - b))
    tangent = np.sqrt(np.maximum(short, 0)), np.sqrt(np.maximum(long, 0))
    return np.asarray(2 * np.arctan2(*tangent))


def _open_elbow(
    chain: Chain,
    q: FloatArray,
    upper: FloatArray,
    lower: FloatArray,
    opened: FloatArray,
) -> BoolArray:
    """Set the elbow; return where its limits allow it."""
    across = upper @ _rest(chain, 1)
    if chain.nodes[1, 0] == PIN:
        lower_angle = np.arctan2(lower[:, 1], lower[:, 0])
        offset = lower_angle - np.arctan2(across[:, 1], across[:, 0])
        side = np.where(np.sin(q[:, 4] + offset) < 0, -1.0, 1.0)
        low, high = chain.numbers[1, 14:16]
        first, other = (
            _nearest_turn(s * opened - offset, q[:, 4]) for s in (side, -side)
        )
        inside = (first >= low) & (first <= high)
        q[:, 4] = np.where(inside, first, other)
        return np.asarray(inside | ((other >= low) & (other <= high)), np.bool_)
    own = q[:, 4:8]
    direction = so3.rotate(own, lower)
    axis = _unit(np.cross(across, direction), perpendicular(across))
    now = np.arctan2(
        np.sum(axis * np.cross(across, direction), axis=1),
        np.sum(across * direction, axis=1),
    )
    turned = so3.multiply(so3.from_axis_angle(axis, opened - now), own)
    q[:, 4:8] = so3.normalize(turned)
    return np.ones(len(q), np.bool_)


def _nearest_turn(angle: FloatArray, to: FloatArray) -> FloatArray:
    return np.asarray(angle + 2 * np.pi * np.round((to - angle) / (2 * np.pi)))


def _tip(
    chain: Chain, q: FloatArray, upper: FloatArray, lower: FloatArray
) -> FloatArray:
    """Return the tip in the shoulder's frame ``(B, 3)``."""
    if chain.nodes[1, 0] == PIN:
        motion = so3.from_axis_angle([0.0, 0.0, 1.0], q[:, 4])
    else:
        motion = q[:, 4:8]
    turned = so3.rotate(motion, lower)
    return np.asarray(upper + turned @ _rest(chain, 1).T)


def _world(chain: Chain, q: FloatArray) -> FloatArray:
    """Return the shoulder's rotation in the world ``(B, 4)``."""
    return so3.multiply(so3.from_matrix(_rest(chain, 0)), q[:, :4])


def _set_world(chain: Chain, q: FloatArray, world: FloatArray) -> None:
    back = so3.conjugate(so3.from_matrix(_rest(chain, 0)))
    q[:, :4] = so3.normalize(so3.multiply(back, world))


def _turn_shoulder(
    chain: Chain, q: FloatArray, tip: FloatArray, towards: FloatArray
) -> None:
    """Turn the tip to its target by the shortest way."""
    world = _world(chain, q)
    # Twice: the first turn leaves what rounding makes of a half turn.
    for _ in range(2):
        now = so3.rotate(world, tip)
        axis = _unit(np.cross(now, towards), perpendicular(now))
        angle = np.arctan2(
            np.linalg.norm(np.cross(now, towards), axis=1),
            np.sum(now * towards, axis=1),
        )
        world = so3.normalize(so3.multiply(so3.from_axis_angle(axis, angle), world))
    _set_world(chain, q, world)


def _turn_to_pole(
    chain: Chain,
    q: FloatArray,
    upper: FloatArray,
    towards: FloatArray,
    pole: FloatArray,
) -> None:
    world = _world(chain, q)
    elbow = so3.rotate(world, upper)
    axis = _unit(towards, perpendicular(towards))
    turn = so3.from_axis_angle(axis, _angle_about(towards, elbow, pole))
    _set_world(chain, q, so3.multiply(turn, world))


def _angle_about(line: FloatArray, a: FloatArray, b: FloatArray) -> FloatArray:
    """Return the signed angle from a to b, seen along a line; 0 where it is open."""
    axis = _unit(line, np.zeros_like(line))
    a = a - np.sum(a * axis, axis=1, keepdims=True) * axis
    b = b - np.sum(b * axis, axis=1, keepdims=True) * axis
    open_ = np.minimum(np.linalg.norm(a, axis=1), np.linalg.norm(b, axis=1)) < 1e-9
    angle = np.arctan2(np.sum(axis * np.cross(a, b), axis=1), np.sum(a * b, axis=1))
    return np.where(open_, 0.0, angle)


def _unit(vectors: FloatArray, otherwise: FloatArray) -> FloatArray:
    size = np.linalg.norm(vectors, axis=-1, keepdims=True)
    units = vectors / np.where(size > 0, size, 1.0)
    return np.where(size > NO_LENGTH**2, units, otherwise)


def perpendicular(vectors: FloatArray) -> FloatArray:
    """Return unit vectors at right angles to others ``(..., 3)``."""
    least = np.argmin(np.abs(vectors), axis=-1)
    crossed = np.cross(vectors, np.eye(3)[least])
    size = np.linalg.norm(crossed, axis=-1, keepdims=True)
    return np.where(size > 0, crossed / np.where(size > 0, size, 1.0), [1.0, 0.0, 0.0])
