"""Writes a take as an OpenSim motion file (MOT or STO)."""

from __future__ import annotations

import numpy as np

from animtool.core.array_types import FloatArray
from animtool.core.errors import Fault, OptionError, Severity, listed, names_fault
from animtool.formats.mot.coordinates import (
    Coordinate,
    column_names,
    convert_columns_to_coordinates,
    convert_coordinates_to_columns,
    list_coordinates,
)
from animtool.formats.take_text import TakeText, format_rows
from animtool.maths import so3
from animtool.motion.take import Take
from animtool.rig.joints import (
    LocalTransforms,
    local_from_coordinates,
    project_to_coordinates,
)
from animtool.rig.skeleton import Rig

# Decimals of coordinates: a nanometre, and 2e-11 radians.
COORDINATE_DECIMALS = 9
# Largest error of joints that is not reported [m, rad]: a micrometre, also on a bone of
# a metre.
LOSS_TOLERANCE = 1e-6


def build_mot_text(take: Take) -> TakeText:
    """Return a take as joint coordinates over time, in degrees and metres.

    A pin or prismatic joint has a column of its name. A ball joint has ``hip_x``,
    ``hip_y`` and ``hip_z``: rotations about X, then the new Y, then the new Z. A free
    joint also has ``hip_tx``, ``hip_ty`` and ``hip_tz``, unless it never leaves its
    rest offset. Frame 1 is time 0.
    """
    rig = take.rig
    coordinates = list_coordinates(rig)
    if not coordinates:
        message = f"{rig.name!r} has no joint that moves, and a MOT holds coordinates"
        raise OptionError(Fault("MOF008", message))
    translations, rotations, scales = take.motion.dense()
    local = LocalTransforms(translations, rotations)
    joint_coordinates = project_to_coordinates(rig, local)
    values = convert_coordinates_to_columns(rig, coordinates, joint_coordinates)
    translated_joints = {
        coordinate.joint_index
        for coordinate, column in zip(coordinates, values.T, strict=True)
        if coordinate.component == "translation"
        and np.round(column, COORDINATE_DECIMALS).any()
    }
    written_columns = [
        column
        for column, coordinate in enumerate(coordinates)
        if coordinate.component != "translation"
        or coordinate.joint_index in translated_joints
    ]
    coordinates = [coordinates[column] for column in written_columns]
    values = values[:, written_columns]
    notices = _loss_warnings(take, coordinates, values, local, scales)
    rate = float(take.clock.rate)
    first_time = float((take.clock.start - 1) / take.clock.fps)
    times = first_time + np.arange(take.clock.count) / rate
    rows = np.column_stack([times, values])
    decimal_counts = [COORDINATE_DECIMALS] * rows.shape[1]
    return TakeText(
        _header_lines(rig, coordinates, len(rows)),
        format_rows(rows, decimal_counts, uses_tabs=True),
        notices,
    )


def _header_lines(rig: Rig, coordinates: list[Coordinate], row_count: int) -> list[str]:
    names = column_names(rig, coordinates)
    return [
        "Coordinates",
        "version=1",
        f"nRows={row_count}",
        f"nColumns={len(names) + 1}",
        "inDegrees=yes",
        "endheader",
        "\t".join(["time", *names]),
    ]


def _loss_warnings(
    take: Take,
    coordinates: list[Coordinate],
    values: FloatArray,
    local: LocalTransforms,
    scales: FloatArray | None,
) -> list[Fault]:
    """Return warnings about motion that coordinates cannot represent."""
    rig, warning = take.rig, Severity.WARNING
    read_back = local_from_coordinates(
        rig, convert_columns_to_coordinates(rig, coordinates, values)
    )
    translation_errors = np.abs(read_back.translations - local.translations).max(
        axis=(0, 2), initial=0
    )
    difference = so3.multiply(so3.conjugate(read_back.rotations), local.rotations)
    rotation_errors = 2 * np.abs(difference[..., :3]).max(axis=(0, 2), initial=0)
    is_inexact = np.maximum(translation_errors, rotation_errors) > LOSS_TOLERANCE
    inexact_joints = [rig.names[j] for j in np.flatnonzero(is_inexact)]
    notices = []
    if inexact_joints:
        message = "motion that the joint types do not allow is skipped: "
        hint = "free joints in the rig can hold any motion"
        notices.append(
            names_fault("MOF108", message, inexact_joints, None, hint, warning)
        )
    lost_contents = []
    if scales is not None and np.abs(scales - 1.0).max(initial=0) > LOSS_TOLERANCE:
        lost_contents.append("scales")
    weights = take.motion.weights
    if weights is not None and (weights.rest.any() or weights.values.any()):
        lost_contents.append("weights of shapes")
    lost_contents += [track.path for track in take.tracks]
    lost_contents += list(take.motion.points)
    if lost_contents:
        message = f"skipped what a MOT cannot hold: {listed(lost_contents)}"
        hint = "write USD too, which can hold them"
        notices.append(Fault("MOF109", message, None, (), hint, warning))
    return notices
