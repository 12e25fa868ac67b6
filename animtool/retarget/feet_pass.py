"""The pass ``feet``: holds the planted feet of a take in place."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from animtool.core.errors import Fault, OptionError, Severity, warning
from animtool.core.record import dataclass
from animtool.motion.motion import Motion
from animtool.motion.passes import FrameScope, Pass, PassContext, TakePart
from animtool.motion.take import Take, TakeStream
from animtool.retarget.legs import leg_joints
from animtool.retarget.options import RetargetOptions
from animtool.retarget.report import fit_scores
from animtool.retarget.take_pass import retarget_stream


@dataclass(frozen=True, slots=True)
class FeetOptions:
    """How feet are identified.

    Attributes:
        map: A map file that names leg and foot joints; None detects them.
    """

    map: Path | None = None


def no_body_warning(error: OptionError) -> Fault:
    """Return the warning for an error that means no body was found; raise others."""
    if error.code != "MAP004":
        raise error
    message = "no person was recognised in the take: it is unchanged"
    hint = "name its joints in a map file, or skip what needs a person"
    return warning("CAP105", message, hint)


def lock_feet(take: Take, options: FeetOptions, context: PassContext) -> Take:
    """Return a take whose planted feet stay in place; legs and hips are adjusted."""
    path = None if options.map is None else context.folder / options.map
    retarget_options = RetargetOptions(map=path)
    try:
        retargeting, _, notices = retarget_stream(
            TakeStream.of(take), take.rig, retarget_options, plants_similar_legs=True
        )
    except OptionError as error:
        context.notices.append(no_body_warning(error))
        return take
    # A stated up axis that is wrong was reported when the take was read.
    is_up_axis_reported = any(
        notice.code == "MOT214" and notice.severity is Severity.WARNING
        for notice in take.notices
    )
    context.notices.extend(
        notice
        for notice in notices
        if not (is_up_axis_reported and notice.code == "MAP009")
    )
    if retargeting.contact_frames.placed_feet is None:
        return take
    motion = Motion.concatenate(list(retargeting.blocks()))
    context.scores.append(fit_scores(retargeting.report()))
    skeleton = retargeting.transfer.target
    joints_of_legs = {
        leg_joints(skeleton, side)[0] for side in retargeting.contact_frames.sides
    }
    for j, parent in enumerate(take.rig.parents.tolist()):
        if parent in joints_of_legs:
            joints_of_legs.add(j)
    rotating_joints = np.array(sorted(joints_of_legs))
    root = np.array([max(skeleton.first_joint("hips"), 0)])
    rotations = motion.rotations.gather(rotating_joints)
    planted_motion = replace(
        take.motion,
        rotations=take.motion.rotations.put(rotating_joints, rotations),
        translations=take.motion.translations.put(
            root, motion.translations.gather(root)
        ),
    )
    return replace(take, motion=planted_motion)


FEET = Pass(
    "feet",
    "Hold planted feet in place",
    FeetOptions,
    FrameScope.CLIP,
    lock_feet,
    reads=frozenset({TakePart.RIG, TakePart.JOINTS, TakePart.CLOCK}),
    changes=frozenset({TakePart.JOINTS}),
)
