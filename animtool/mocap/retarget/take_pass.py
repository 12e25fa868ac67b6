"""The pass ``retarget``: a take brought onto another rig."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from animtool._types import FloatArray
from animtool.errors import Fault, OptionError, Severity
from animtool.mocap.retarget.map import JointMap
from animtool.mocap.retarget.motion import Retargeted, retarget_take
from animtool.mocap.retarget.options import RetargetOptions
from animtool.mocap.retarget.pairing import map_joints
from animtool.mocap.retarget.report import report_of, scores_of
from animtool.options import with_written
from animtool.passes import OptionChecks, Pass, PassContext, Scope, TakePart
from animtool.rig.kinematics import forward
from animtool.rig.skeleton import Rig
from animtool.take import Take


@with_written(RetargetOptions)
@dataclass(frozen=True)
class RetargetPassOptions:
    """The rig that the take goes onto, and the options of `RetargetOptions`."""

    rig: Path | None = None  # the file of the rig


def onto_rig(
    take: Take, rig: Rig, options: RetargetOptions
) -> tuple[Retargeted, JointMap, list[Fault]]:
    """Return a take on another rig, the map of joints, and what is odd.

    Raises:
        FormatError: The map file cannot be read, or names joints that neither has.
        OptionError: Nothing maps (MAP004), or the rest frame is none of the take's
            (MAP006).
    """
    rest = _rest(take, options.rest_frame)
    found = map_joints(
        take.rig,
        rig,
        preset=options.preset,
        target_preset=options.target_preset,
        map_file=options.map,
        mode=options.by,
        source_positions=_positions(take, rest),
    )
    made = retarget_take(take, rig, found, rest=rest, lock=not options.free_feet)
    notices = list(found.notices)
    if not options.free_feet and not any(own.any.any() for own in made.contacts):
        message = "no foot stands in any frame: none is held"
        hint = "is the take of a person with legs, and longer than two frames?"
        notices.append(Fault("MAP007", message, hint=hint, severity=Severity.NOTE))
    return made, found, notices


def _rest(take: Take, frame: int | None) -> FloatArray | None:
    """Return local turns of the frame that is the rest pose ``(J, 4)``."""
    if frame is None:
        return None
    if not 1 <= frame <= take.clock.count:
        message = f"the rest pose is that of frame {frame}, and there are "
        message += f"{take.clock.count}"
        raise OptionError(Fault("MAP006", message, where="rest_frame"))
    turns: FloatArray = take.motion.rotations.dense()[frame - 1]
    return turns


def _positions(take: Take, rest: FloatArray | None) -> FloatArray:
    """Return where joints are in a pose of a person who stands ``(J, 3)`` [m].

    That of the rest pose, or of the first frame: of a skeleton that has none.
    """
    motion = take.motion
    turns = motion.rotations.dense()[:1] if rest is None else rest[None]
    places = motion.translations.dense()[:1]
    return np.asarray(forward(take.rig, places, turns).positions[0])


def _named_rig(options: RetargetPassOptions) -> Path:
    if options.rig is None:
        message = "rig must name the file of a rig"
        raise OptionError(Fault("MAP008", message))
    return options.rig


def _run(take: Take, options: Any, context: PassContext) -> Take:
    rig = Rig.load(context.folder / _named_rig(options))
    names = RetargetOptions.__dataclass_fields__
    settings = RetargetOptions(**{name: getattr(options, name) for name in names})
    if settings.map is not None:
        settings = replace(settings, map=context.folder / settings.map)
    made, found, notices = onto_rig(take, rig, settings)
    context.notices.extend(notices)
    context.scores.append(scores_of(report_of(made, found)))
    return made.take


def _checks(options: Any) -> OptionChecks:
    return {"rig": lambda: _named_rig(options)}


PASS = Pass(
    "retarget",
    "Bring the take onto another rig, feet held where they stand",
    RetargetPassOptions,
    Scope.CLIP,
    _run,
    _checks,
    reads=frozenset({TakePart.RIG, TakePart.JOINTS, TakePart.CLOCK}),
    changes=frozenset(
        {TakePart.RIG, TakePart.JOINTS, TakePart.SHAPES, TakePart.CONTROLS}
    ),
)
