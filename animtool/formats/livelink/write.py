"""Writes a take as a Live Link Face recording (CSV)."""

from __future__ import annotations

from collections.abc import Iterator
from fractions import Fraction

import numpy as np

from animtool.core.arguments import argument
from animtool.core.array_types import FloatArray
from animtool.core.errors import Fault, OptionError, Severity, names_fault
from animtool.core.timecode import nominal_rate, timecode_label
from animtool.formats.livelink.columns import (
    ANGLE_COLUMNS,
    APP_SHAPES,
    COUNT_COLUMN,
    FACE_PARTS,
    JOINTS_BY_PART,
    TIMECODE_COLUMN,
)
from animtool.formats.take_text import TakeText
from animtool.maths.euler import from_quaternion
from animtool.maths.so3 import align_signs
from animtool.motion.take import Take
from animtool.rig.head import face_rotations, head_joints
from animtool.rig.shapes import arkit_name

# Decimals, as in files of the app.
WEIGHT_DECIMALS = 10


def build_livelink_text(take: Take) -> TakeText:
    """Return a take as CSV: ARKit's 52 weights, head and eye rotations.

    The first frame is 00:00:00:00 of a clock with the take's rate, drop-frame at 29.97
    and 59.94. Shapes missing in the rig are 0. The format cannot store other shapes and
    joints; notices list the animated shapes.
    """
    shape_indices = {arkit_name(s.name): i for i, s in enumerate(take.rig.shapes)}
    shape_indices.pop(None, None)
    if not shape_indices:
        message = f"{take.rig.name!r} has no ARKit shape, which is all that this CSV "
        message += "holds"
        hint = "write USD, or keys in a .clip.yaml"
        raise OptionError(Fault("LLF008", message, hint=hint))
    rate = take.clock.rate
    try:
        nominal_rate(rate)
    except ValueError as error:
        hint = f"{argument('fps', '60')} gives it a rate that time codes can count"
        raise OptionError(Fault("LLF009", str(error), hint=hint)) from error
    weights = np.zeros((take.clock.count, len(APP_SHAPES)))
    notices = []
    if take.motion.weights is not None:
        all_weights = take.motion.weights.dense()[..., 0]
        for i, name in enumerate(APP_SHAPES):
            shape_index = shape_indices.get(arkit_name(name))
            if shape_index is not None:
                weights[:, i] = all_weights[:, shape_index]
        written_shapes = set(shape_indices.values())
        unwritten_names = [
            shape.name
            for i, shape in enumerate(take.rig.shapes)
            if i not in written_shapes and all_weights[:, i].any()
        ]
        if unwritten_names:
            message = f"{len(unwritten_names)} shapes have no column in the CSV: "
            notices.append(
                names_fault(
                    "LLF111", message, unwritten_names, severity=Severity.WARNING
                )
            )
    header = ",".join((TIMECODE_COLUMN, COUNT_COLUMN, *APP_SHAPES, *ANGLE_COLUMNS))
    return TakeText(
        [header], _csv_rows(weights, _head_and_eye_angles(take), rate), notices
    )


def _head_and_eye_angles(take: Take) -> FloatArray:
    """Return yaw, pitch and roll of head, left eye and right eye [rad] ``(F, 9)``."""
    angles = np.zeros((take.clock.count, len(ANGLE_COLUMNS)))
    joints = head_joints(take.rig)
    for k, part in enumerate(FACE_PARTS):
        joint = joints.get(JOINTS_BY_PART[part])
        if joint is None:
            continue
        local_rotations = take.motion.rotations.gather(np.array([joint]))[:, 0]
        rotations = align_signs(face_rotations(take.rig, joint, local_rotations))
        angles[:, 3 * k : 3 * k + 3] = np.radians(from_quaternion(rotations, "YXZ"))
    return angles


def _csv_rows(
    weights: FloatArray, angles: FloatArray, rate: Fraction
) -> Iterator[bytes]:
    value_count = len(APP_SHAPES) + len(ANGLE_COLUMNS)
    row_format = (
        f"%s,{value_count}," + ",".join([f"%.{WEIGHT_DECIMALS}f"] * value_count) + "\n"
    )
    # Adding 0 removes negative zeros.
    values = np.round(np.concatenate([weights, angles], axis=1), WEIGHT_DECIMALS) + 0.0
    for frame, row_values in enumerate(values.tolist()):
        yield (row_format % (format_timecode(frame, rate), *row_values)).encode()


def format_timecode(frame: int, rate: Fraction) -> str:
    """Return the timecode of a frame counted from midnight, with fractions.

    >>> format_timecode(1800, Fraction(30000, 1001)), format_timecode(61, Fraction(60))
    ('00:01:00;02.000', '00:00:01:01.000')
    """
    is_drop_frame = rate in {Fraction(30000, 1001), Fraction(60000, 1001)}
    return f"{timecode_label(frame, rate, is_drop_frame=is_drop_frame)}.000"
