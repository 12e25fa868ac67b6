"""Inverse kinematics: poses that bring joints to goals, limits kept."""

from animtool.ik.goals import Goal, Targets
from animtool.ik.methods import IkMethod
from animtool.ik.problem import Problem, build
from animtool.ik.result import IkResult, IkStatus
from animtool.ik.solve import IkOptions, solve

__all__ = [
    "Goal",
    "IkMethod",
    "IkOptions",
    "IkResult",
    "IkStatus",
    "Problem",
    "Targets",
    "build",
    "solve",
]
