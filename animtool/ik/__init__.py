"""Inverse kinematics: poses that reach goals within joint limits."""

from __future__ import annotations

from typing import TYPE_CHECKING

from animtool.core.plugins import lazy_names

if TYPE_CHECKING:
    from animtool.ik.clip_path import FollowOptions as FollowOptions
    from animtool.ik.clip_solver import follow as follow
    from animtool.ik.file import load_targets as load_targets
    from animtool.ik.goals import Goal as Goal
    from animtool.ik.goals import Targets as Targets
    from animtool.ik.jumps import Jump as Jump
    from animtool.ik.matching import Matched as Matched
    from animtool.ik.matching import match as match
    from animtool.ik.on_take import solve_take as solve_take
    from animtool.ik.options import IkMethod as IkMethod
    from animtool.ik.options import IkOptions as IkOptions
    from animtool.ik.options import TakeOptions as TakeOptions
    from animtool.ik.path import smooth as smooth
    from animtool.ik.problem import Problem as Problem
    from animtool.ik.problem import build as build
    from animtool.ik.result import IkResult as IkResult
    from animtool.ik.result import IkStatus as IkStatus
    from animtool.ik.session import Session as Session
    from animtool.ik.solving import solve as solve
    from animtool.ik.take_run import TakeIk as TakeIk
    from animtool.ik.tracks import TargetTracks as TargetTracks

_PUBLIC = {
    "FollowOptions": "animtool.ik.clip_path",
    "Goal": "animtool.ik.goals",
    "IkMethod": "animtool.ik.options",
    "IkOptions": "animtool.ik.options",
    "IkResult": "animtool.ik.result",
    "IkStatus": "animtool.ik.result",
    "Jump": "animtool.ik.jumps",
    "Matched": "animtool.ik.matching",
    "Problem": "animtool.ik.problem",
    "Session": "animtool.ik.session",
    "TakeIk": "animtool.ik.take_run",
    "TakeOptions": "animtool.ik.options",
    "TargetTracks": "animtool.ik.tracks",
    "Targets": "animtool.ik.goals",
    "build": "animtool.ik.problem",
    "follow": "animtool.ik.clip_solver",
    "load_targets": "animtool.ik.file",
    "match": "animtool.ik.matching",
    "smooth": "animtool.ik.path",
    "solve": "animtool.ik.solving",
    "solve_take": "animtool.ik.on_take",
}

__all__ = sorted(_PUBLIC)  # noqa: PLE0605 - the table above is the list

if not TYPE_CHECKING:  # type checkers know the names that are imported, and no others
    __getattr__, __dir__ = lazy_names(__name__, _PUBLIC)
