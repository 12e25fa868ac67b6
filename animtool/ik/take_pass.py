"""The pass ``ik``: solves a take for targets, such as held feet and hands on props."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

from animtool.core.errors import Fault, OptionError, refuse
from animtool.core.options import options_of, with_text_values
from animtool.core.record import dataclass
from animtool.core.units import parse_length
from animtool.documents.versions import file_of_kind
from animtool.ik.file import load_targets
from animtool.ik.on_take import solve_take
from animtool.ik.options import TakeOptions
from animtool.ik.report import MISSED_ANGLE, MISSED_LENGTH, goal_reports, take_notices
from animtool.ik.solving import raise_faults
from animtool.ik.sub_rig import with_joint_data_of
from animtool.ik.take_run import take_option_faults
from animtool.ik.tracks import TargetTracks
from animtool.motion.passes import (
    FrameScope,
    OptionChecks,
    Pass,
    PassContext,
    PlacedJoint,
    TakePart,
)
from animtool.motion.take import Take
from animtool.rig.skeleton import Rig


@with_text_values(TakeOptions, "joints")
@dataclass(frozen=True)
class IkPassOptions:
    """The targets of the pass, and the options of `TakeOptions`."""

    targets: Path | None = None  # the targets file
    # File of a rig whose joint types, limits and chains apply to joints of the same
    # names; None uses the take's rig.
    rig: Path | None = None


def rig_and_tracks(
    take: Take, options: IkPassOptions, folder: Path
) -> tuple[Take, TargetTracks]:
    """Return a take with the rig to solve, and its target tracks.

    Args:
        take: Input of the pass.
        options: Options of the pass.
        folder: Folder of relative paths.
    """
    path = folder / _targets_file(options)
    if options.rig is not None:
        with file_of_kind(options.rig, "rig", "rig"):
            rig_file = Rig.load(folder / options.rig)
        take = replace(take, rig=with_joint_data_of(take.rig, rig_file))
    with file_of_kind(path, "targets", "targets"):
        return take, load_targets(path, take.rig)


def _run(take: Take, options: Any, context: PassContext) -> Take:
    """Run the pass: solve the take and report its misses."""
    rig = take.rig
    take, tracks = rig_and_tracks(take, options, context.folder)
    take_options = solve_options(options)
    solved_take = solve_take(take, tracks, take_options, progress=context.progress)
    context.notices.extend(tracks.notices)
    reports = goal_reports(
        solved_take,
        max(take_options.tolerance, MISSED_LENGTH),
        max(take_options.angle_tolerance, MISSED_ANGLE),
    )
    warnings = take_notices(solved_take, reports, is_smoothed=take_options.smooth > 0)
    context.notices.extend(warnings)
    times = solved_take.take.clock.times
    context.placed_joints.extend(
        PlacedJoint(track.goal.joint, track.name, times[solved_take.active[:, e, 0]])
        for e, track in enumerate(solved_take.tracks.goals)
    )
    misses = [miss for goal in reports for miss in goal.misses]
    context.errors.extend(miss.max for miss in misses if miss.is_length)
    return replace(solved_take.take, rig=rig)


def solve_options(options: Any) -> TakeOptions:
    """Return the solve options of the pass (invalid tolerance: IK014)."""
    tolerance = _parse_tolerance(options.tolerance)
    return replace(_options_without_tolerance(options), tolerance=tolerance)


def _options_without_tolerance(options: Any) -> TakeOptions:
    """Return the solve options without the tolerance, which is still text."""
    option_names = options_of(TakeOptions).keys() - {"tolerance", "angle_tolerance"}
    return TakeOptions(
        angle_tolerance=math.radians(options.angle_tolerance),
        **{name: getattr(options, name) for name in option_names},
    )


def _targets_file(options: IkPassOptions) -> Path:
    """Return the path of the targets file; raise if the option is missing (TGT013)."""
    if options.targets is None:
        refuse("TGT013", "targets must name a targets file")
    return options.targets


def _parse_tolerance(text: str) -> float:
    """Return the tolerance in metres from text such as ``0.1mm``."""
    try:
        return parse_length(text)
    except ValueError as error:
        raise OptionError(Fault("IK014", f"tolerance: {error}")) from error


def _option_checks(options: Any) -> OptionChecks:
    """Return the function that checks each option, by option name."""
    faults_by_name = take_option_faults(_options_without_tolerance(options))
    return {
        **{n: partial(raise_faults, {n: f}) for n, f in faults_by_name.items()},
        "targets": lambda: _targets_file(options),
        "tolerance": lambda: _parse_tolerance(options.tolerance),
    }


PASS = Pass(
    "ik",
    "Solve joints for targets: hold feet, put hands on props",
    IkPassOptions,
    FrameScope.CLIP,
    _run,
    _option_checks,
    reads=frozenset({TakePart.RIG, TakePart.JOINTS, TakePart.CLOCK}),
    changes=frozenset({TakePart.RIG, TakePart.JOINTS}),
    reports_progress=True,
)
