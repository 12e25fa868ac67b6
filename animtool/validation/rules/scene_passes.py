"""The passes and the frames of a scene."""

from __future__ import annotations

from collections.abc import Iterator
from fractions import Fraction

from animtool.config import find_config
from animtool.errors import Fault
from animtool.passes import Pass, TakePart
from animtool.rates import rate_label
from animtool.validation.subjects.scene import SceneSubject

# Rates that differ by less are meant to be one: 24 and 23.976, 30 and 29.97 [1].
NEAR_RATES = Fraction(1, 50)

# What these come to is stated, not how: a take may have it already.
_STATES = frozenset({"ik", "resample"})
# Joints stay where they are in the world, whatever the table says.
_IN_PLACE = frozenset({"root_motion"})


def idle(subject: SceneSubject) -> Iterator[Fault]:
    """Yield passes that change nothing (SCN201)."""
    for i in subject.idle:
        name = subject.scene.passes[i].pass_.name
        if name in _STATES:
            continue
        message = f"the pass {name} changes nothing"
        hint = "leave it out, or give it the options that do"
        yield subject.fault("SCN201", subject.at_pass(i), message, hint)


def outside_take(subject: SceneSubject) -> Iterator[Fault]:
    """Yield a range that reaches beyond what there is to write (SCN202)."""
    yield from _outside(subject, "SCN202", "reaches beyond the take", wholly=False)


def without_frames(subject: SceneSubject) -> Iterator[Fault]:
    """Yield a range in which there is nothing to write (SCN211)."""
    yield from _outside(subject, "SCN211", "has no frame of the take", wholly=True)


def _outside(
    subject: SceneSubject, code: str, how: str, *, wholly: bool
) -> Iterator[Fault]:
    """Yield a range that is outside the take, wholly or in part."""
    scene, clock = subject.scene, subject.take.clock
    wanted, start = scene.bake.frame_range, _start(subject)
    if wanted is None or start is None:
        return
    last = start + clock.duration * (scene.bake.fps or clock.fps)
    if start <= wanted.first and wanted.last <= last:
        return
    if wholly != (wanted.last < start or wanted.first > last):
        return
    what, at = "range", ("range",)
    if scene.bake.shot is not None:
        what, at = "cut with its handles,", ("shot",)
    message = (
        f"the {what} from {wanted.first} to {wanted.last} {how}, "
        f"which the output numbers {float(start):g} to {float(last):g}"
    )
    hint = "frames count as the output does, from its start"
    yield subject.fault(code, at, message, hint)


def _start(subject: SceneSubject) -> Fraction | None:
    """Return the first time code of the output; None where a rig layer decides."""
    bake = subject.scene.bake
    if bake.start is not None or bake.rig_layer is not None:
        return bake.start
    if subject.start is not None:
        return subject.start
    return find_config(subject.scene.path).start or Fraction(1)


def near_rate(subject: SceneSubject) -> Iterator[Fault]:
    """Yield a rate that is nearly that of the take (SCN205)."""
    given, own = subject.scene.bake.fps, subject.take.clock.rate
    if given is None or given == own or abs(given - own) > NEAR_RATES * own:
        return
    message = f"the output has {rate_label(given)}, and the take {rate_label(own)}"
    hint = "leave fps out; of a BVH that states a wrong rate, source.fps says the true"
    yield subject.fault("SCN205", ("fps",), message, hint)


def undone_goals(subject: SceneSubject) -> Iterator[Fault]:
    """Yield passes that change poses which `ik` has brought to targets (SCN210)."""
    solved = ""
    for i, entry in enumerate(subject.scene.passes):
        if i in subject.solved:
            solved = entry.place.where
        elif solved and _moves(entry.pass_) and i not in subject.idle:
            message = (
                f"the pass {entry.pass_.name} moves what {solved} brought to targets"
            )
            hint = "put ik behind it"
            yield subject.fault("SCN210", subject.at_pass(i), message, hint)


def _moves(pass_: Pass) -> bool:
    """Return whether a pass changes poses, and not only when they are."""
    retimes = TakePart.CLOCK in pass_.changes
    return (
        TakePart.JOINTS in pass_.changes and not retimes and pass_.name not in _IN_PLACE
    )
