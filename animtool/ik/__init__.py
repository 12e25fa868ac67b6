"""Inverse kinematics: poses that bring joints to goals, limits kept."""

from animtool.ik.file import load_targets
from animtool.ik.follow import FollowOptions, follow
from animtool.ik.goals import Goal, Targets
from animtool.ik.match import Matched, match
from animtool.ik.methods import IkMethod
from animtool.ik.on_take import TakeIk, solve_take
from animtool.ik.problem import Problem, build
from animtool.ik.result import IkResult, IkStatus, Jump
from animtool.ik.smooth import smooth
from animtool.ik.solve import IkOptions, solve
from animtool.ik.take_options import TakeOptions
from animtool.ik.tracks import TargetTracks

__all__ = [
    "FollowOptions",
    "Goal",
    "IkMethod",
    "IkOptions",
    "IkResult",
    "IkStatus",
    "Jump",
    "Matched",
    "Problem",
    "TakeIk",
    "TakeOptions",
    "TargetTracks",
    "Targets",
    "build",
    "follow",
    "load_targets",
    "match",
    "smooth",
    "solve",
    "solve_take",
]
