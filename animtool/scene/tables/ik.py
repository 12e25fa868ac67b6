"""Time against error of inverse kinematics, over tolerances and methods."""

from __future__ import annotations

from dataclasses import replace
from typing import ClassVar

import numpy as np

from animtool.core.errors import OptionError
from animtool.core.record import dataclass
from animtool.ik.on_take import solve_take
from animtool.ik.options import IkMethod
from animtool.ik.result import IkStatus
from animtool.ik.take_run import TakeIk
from animtool.scene.bake.progress import Progress
from animtool.scene.solves.ik import IkContext, IkJob, open_ik

# Shares of the chains' length, and radians.
TOLERANCES = (1e-2, 1e-3, 1e-4, 1e-5, 1e-6, 1e-7, 1e-8)


@dataclass(frozen=True, slots=True)
class IkTableRow:
    """One setting and what it gives."""

    setting: str  # the tolerance or the method, in words
    tolerance: float  # of positions [m]
    angle_tolerance: float  # of the others [rad]
    method: IkMethod  # which solver
    refused: str = ""  # why the method cannot solve this; empty where it can
    microseconds: float = 0.0  # of solving, a frame
    position: float = 0.0  # the worst miss [m]
    angle: float = 0.0  # the worst miss of an orientation, aim or pole [rad]
    iterations: float = 0.0  # mean of the frames
    converged: float = 0.0  # share of the frames that reached all


@dataclass(frozen=True, slots=True)
class IkTable:
    """Rows for one input."""

    frames: int  # how many were solved
    degrees: int  # degrees of freedom of the problem
    # A row for each of `TOLERANCES`, by the method asked for.
    tolerances: list[IkTableRow]
    methods: list[IkTableRow]  # A row for each `IkMethod`, at the tolerance asked for
    json_keys: ClassVar[str] = (
        "'ik_table' frames degrees_of_freedom=degrees tolerances methods"
    )


def ik_table(job: IkJob, *, progress: Progress = None) -> IkTable:
    """Solve a job in several ways, and measure each.

    Args:
        job: What to solve; nothing is written.
        progress: Called with the share done, 0 to 1.

    Raises:
        FormatError: A file is malformed.
        OptionError: The files do not fit each other, or an option makes no sense.
    """
    context = open_ik(job)
    options = job.options
    first = _solved(job, context, options.method, options.tolerance)
    length = first.problem.length
    steps = len(TOLERANCES) + len(IkMethod)
    rows: list[IkTableRow] = []

    def add(setting: str, method: IkMethod, tolerance: float, angle: float) -> None:
        row = IkTableRow(setting, tolerance, angle, method)
        rows.append(_measured(job, context, row))
        if progress is not None:
            progress(len(rows) / steps)

    for share in TOLERANCES:
        add(f"{share:.0e}", options.method, share * length, share)
    for method in IkMethod:
        add(str(method), method, options.tolerance, options.angle_tolerance)
    count = len(TOLERANCES)
    frames = len(first.statuses)
    return IkTable(frames, first.problem.degrees, rows[:count], rows[count:])


def _measured(job: IkJob, context: IkContext, row: IkTableRow) -> IkTableRow:
    try:
        solved = _solved(job, context, row.method, row.tolerance, row.angle_tolerance)
    except OptionError as error:
        return replace(row, refused=error.faults[0].message)
    misses = np.where(solved.asked, solved.misses, 0.0)
    reached = [status is IkStatus.CONVERGED for status in solved.statuses]
    return replace(
        row,
        microseconds=1e6 * solved.seconds / len(solved.statuses),
        position=float(misses[..., 0].max(initial=0.0)),
        angle=float(misses[..., 1:].max(initial=0.0)),
        iterations=float(solved.iterations.mean()),
        converged=float(np.mean(reached)),
    )


def _solved(
    job: IkJob,
    context: IkContext,
    method: IkMethod,
    tolerance: float,
    angle_tolerance: float = 1e-3,
) -> TakeIk:
    options = replace(
        job.options,
        method=method,
        tolerance=tolerance,
        angle_tolerance=angle_tolerance,
    )
    return solve_take(
        context.take, context.tracks, options, still=context.still, only=context.only
    )
