"""The ways of solving, and which problems each can serve."""

from __future__ import annotations

from animtool.errors import Fault, OptionError, listed
from animtool.ik.options import IkMethod
from animtool.ik.problem import Problem
from animtool.ik.two_bone import misfit
from animtool.rig.skeleton import JointType

# Numbers of the methods in the kernel.
KERNEL_METHODS = {
    IkMethod.AUTO: 0,
    IkMethod.DAMPED: 0,
    IkMethod.TWO_BONE: 0,
    IkMethod.GRADIENT: 1,
    IkMethod.NEWTON: 2,
    IkMethod.CCD: 3,
    IkMethod.FABRIK: 4,
}


def serving(problem: Problem) -> list[IkMethod]:
    """Return the methods that can serve a problem.

    >>> from animtool.ik.goals import Goal
    >>> from animtool.ik.problem import build
    >>> from animtool.rig.skeleton import Joint, JointType, Rig
    >>> door = Rig("door", (Joint("hinge", -1, JointType.PIN),))
    >>> problem = build(door, [Goal("hinge", position=0.0, orientation=1.0)])
    >>> [str(method) for method in serving(problem)]
    ['auto', 'damped', 'gradient', 'newton', 'ccd']
    """
    return [method for method in IkMethod if _obstacle(problem, method) is None]


def check_method(problem: Problem, method: IkMethod) -> None:
    """Raise where a method cannot serve a problem.

    Raises:
        OptionError: Why it cannot, or that there is none of that name, and which
            methods can (IK015).
    """
    if method not in set(IkMethod):
        hint = f"methods for this problem: {', '.join(serving(problem))}"
        raise OptionError(Fault("IK015", f"no method is {method!r}", hint=hint))
    obstacle = _obstacle(problem, method)
    if obstacle is None:
        return
    hint = f"methods for this problem: {', '.join(serving(problem))}"
    if method == IkMethod.FABRIK and _sliding(problem):
        hint += "; or choose joints that do not travel, or a root below them"
    raise OptionError(Fault("IK015", f"{method} {obstacle}", hint=hint))


def _obstacle(problem: Problem, method: IkMethod) -> str | None:
    """Return what of a problem a method cannot serve."""
    if method in {IkMethod.AUTO, IkMethod.DAMPED}:
        return None
    if method == IkMethod.TWO_BONE:
        reason = misfit(problem)
        return reason and f"does not fit: {reason}"
    plain = {IkMethod.CCD, IkMethod.FABRIK}
    kinds = [kind for goal in problem.goals for kind in goal.kinds]
    slides = _sliding(problem)
    levels = bool(problem.chain.goals[:, 3].any())
    rules = [
        (levels, {*plain, IkMethod.GRADIENT, IkMethod.NEWTON}, "heeds no priorities"),
        (problem.rest_weight > 0, plain, "heeds no preference for a pose"),
        *((not kind.pulls, plain, f"heeds no {kind.targets}") for kind in kinds),
        (
            any(kind.turning for kind in kinds),
            {IkMethod.FABRIK},
            "is for positions only",
        ),
        (bool(slides), {IkMethod.FABRIK}, _stiff(slides)),
    ]
    found = (why for holds, methods, why in rules if holds and method in methods)
    return next(found, None)


def _sliding(problem: Problem) -> list[str]:
    """Return the names of the problem's joints that travel."""
    rig = problem.rig
    kinds = {JointType.FREE, JointType.PRISMATIC}
    return [n for n in problem.joints if rig.joints[rig.index(n)].type in kinds]


def _stiff(sliding: list[str]) -> str:
    return f"is for joints that turn only, and {listed(sliding)} may travel"
