"""The pass ``retarget``: a take brought onto another rig."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from dataclasses import replace
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np

from animtool.core.arguments import argument
from animtool.core.array_types import FloatArray, IntArray
from animtool.core.errors import (
    Fault,
    FormatError,
    OptionError,
    Severity,
    counted,
    listed,
)
from animtool.core.options import with_text_values
from animtool.core.quantities import length_text
from animtool.core.record import dataclass
from animtool.motion.motion import Motion
from animtool.motion.passes import (
    MOTION_PARTS,
    OptionChecks,
    Pass,
    PassContext,
    PassthroughTracks,
    Scope,
    TakePart,
)
from animtool.motion.take import Take, TakeStream
from animtool.retarget.anatomy import anatomy
from animtool.retarget.legs import leg_of
from animtool.retarget.map import JointMap
from animtool.retarget.motion import Retargeting, transfer_of
from animtool.retarget.options import RetargetOptions
from animtool.retarget.pairing import map_joints
from animtool.retarget.props import Props
from animtool.retarget.report import scores_of
from animtool.retarget.roles import (
    CONTROL,
    END,
    FINGERS,
    MITTEN,
    TWIST,
    base_role,
)
from animtool.retarget.standing import stands_along
from animtool.rig.kinematics import forward
from animtool.rig.placed import at_origin
from animtool.rig.skeleton import Rig

# Whether enough of a take is paired for its motion to be that of the rig.

# Bones that a whole limb has.
LIMBS = {"arm": ("upper_arm", "forearm", "hand"), "leg": ("thigh", "shin", "foot")}
# Least share of the joints that move in a take that are paired [1].
PAIRED = 1 / 3
# Joints that say nothing of how a body moves: some takes have hundreds of them.
_DETAIL = {*FINGERS, MITTEN, "toe", "jaw", "eye", TWIST, END, CONTROL}
_ENDS = {"head", "hand", "foot"}
MAX_NAMED = 6
# Share of its length at rest that a bone keeps at most that has none [1].
NO_LENGTH = 1e-4


def lacking_pairs(
    source: Rig, found: JointMap, follows: IntArray, moving: Collection[int]
) -> Fault | None:
    """Return why a take does not fit a rig (MAP010); None where it does.

    Args:
        source: The skeleton of the take, of J joints.
        found: Which joints follow which.
        follows: Which joint of the source each of the target follows ``(K,)``.
        moving: Joints of the source that move; where none does, all count.
    """
    roles = found.source.roles
    used = {pair.source for pair in found.pairs} | {*follows.tolist()}
    used |= {j for chain in found.chains for j in chain.source}
    limbs = _limbs(roles)
    whole = [name for name, joints in limbs.items() if used.issuperset(joints)]
    body = _body(source, roles)
    counts = [j for j in body if j in moving] or body
    paired = [j for j in counts if j in used]
    if len(paired) >= PAIRED * len(counts) and (whole or not limbs):
        return None
    message = (
        f"{len(paired)} of {counted(len(counts), 'moving joint')} of {source.name!r} "
        f"are paired"
    )
    if limbs and not whole:
        message += f", and none of its limbs ({listed(sorted(limbs), MAX_NAMED)})"
    hint = (
        "write a map file, or retarget what is paired with "
        f"{argument('force_fit', True)}, "
    )
    hint += "in a pass force_fit: true"
    return Fault("MAP010", message, hint=hint)


def collapsed(source: Rig, found: JointMap, longest: FloatArray) -> Fault | None:
    """Return which limbs of a take have bones without length (MAP011); None for none.

    Args:
        source: The skeleton of the take, of J joints.
        found: Which joints follow which.
        longest: How far its joints get from their parents, at most ``(J,)`` [m].
    """
    roles = found.source.roles
    lengths = np.linalg.norm(source.rest_translations, axis=1)
    lost = (longest <= NO_LENGTH * lengths) & (lengths > 0) & (source.parents >= 0)
    bones = sorted(
        {
            j
            for joints in _limbs(roles).values()
            for bottom, top in ((joints[-1], joints[0]),)
            for j in source.upwards(bottom)
            if lost[j] and j != top and top in source.upwards(j)
        }
    )
    if not bones:
        return None
    names = listed([repr(source.names[j]) for j in bones], MAX_NAMED)
    message = (
        f"{counted(len(bones), 'limb bone')} of {source.name!r} have zero length in "
        f"every frame, but up to {length_text(float(lengths[bones].max()))} at rest: "
        f"{names} are at their parents' positions"
    )
    hint = (
        f"for a BVH, {argument('source.positions', 'offsets')} uses the OFFSETs; "
        f"{argument('force_fit', True)}, in a pass "
    )
    hint += "force_fit: true, retargets it as it is"
    return Fault("MAP011", message, hint=hint)


def nothing_paired(source: Rig, roles: tuple[str, ...], target: Rig) -> Fault | None:
    """Return that nothing of a body is paired (MAP010); None for what is no body."""
    limbs = _limbs(roles)
    if not limbs:
        return None
    message = f"no joint of {source.name!r} maps to one of {target.name!r}, and none "
    message += f"of its limbs ({listed(sorted(limbs), MAX_NAMED)})"
    return Fault("MAP010", message, hint="choose another rig, or write a map file")


def _limbs(roles: tuple[str, ...]) -> dict[str, list[int]]:
    """Return the joints of the limbs that a skeleton has whole, by name."""
    found = {}
    for name, bones in LIMBS.items():
        for side, text in (("l", "left"), ("r", "right")):
            own = [f"{bone}_{side}" for bone in bones]
            if {*own} <= {*roles}:
                found[f"{text} {name}"] = [roles.index(role) for role in own]
    return found


def _body(rig: Rig, roles: tuple[str, ...]) -> list[int]:
    """Return the joints of a skeleton without fingers, toes, face and twists."""
    made = []
    for j, role in enumerate(roles):
        ends = {base_role(roles[k]) for k in rig.upwards(j)[1:]} & _ENDS
        if base_role(role) not in _DETAIL and not (ends and not role):
            made.append(j)
    return made


@with_text_values(RetargetOptions)
@dataclass(frozen=True)
class RetargetPassOptions:
    """The rig that the take goes onto, and the options of `RetargetOptions`."""

    rig: Path | None = None  # the file of the rig


def onto_rig(
    stream: TakeStream,
    rig: Rig,
    options: RetargetOptions,
    *,
    same: bool = False,
    props: Props | None = None,
) -> tuple[Retargeting, JointMap, list[Fault]]:
    """Return a take on its way to another rig, the map of joints, and what is odd.

    Args:
        stream: The take.
        rig: The rig that it goes onto.
        options: How.
        same: Whether feet are held on legs like those of the source, too.
        props: Tracks of the take that hands may hold.

    Raises:
        FormatError: The map file cannot be read, or names joints that neither has; or
            too little is paired (MAP010), or limbs have no length (MAP011).
        OptionError: Nothing maps (MAP004), or the rest frame is none of the take's
            (MAP006).
    """
    _check_bound(options)
    as_rig = options.rest == "rig"
    frame = None if isinstance(options.rest, str) else options.rest
    rest, blocks = _rest(stream.blocks, frame)
    first = next(blocks)
    found = _paired(stream.rig, rig, options, _positions(stream.rig, first, rest))
    notices = list(found.notices)
    # How a stage turns its character is part of the motion, and not of how it rests.
    source = at_origin(stream.rig)
    stands = None
    if stream.details.get("up_choice") != "stated":
        stands = stands_along(source, first, found.source.roles)
    if stands is not None:
        message = (
            f"the body stands along {stands}, though the take's up axis is "
            f"{source.up}; "
        )
        message += f"using {stands} up"
        hint = (
            f"confirm with {argument('source.up', stands)}, or write "
            f"{argument('source.up', source.up)} if it lies"
        )
        notices.append(Fault("MAP009", message, hint=hint, severity=Severity.WARNING))
        source = replace(source, up=stands)
    transfer = transfer_of(source, rig, found, rest, as_rig=as_rig)
    notices += _scale_warnings(transfer.scale)
    fps = float(stream.fps / stream.step)
    lock = not options.free_feet
    motions = chain([first], blocks)
    hands = options.hold_hands
    made = Retargeting(
        transfer, found, motions, fps, lock=lock, same=same, hands=hands, props=props
    )
    lacking = lacking_pairs(source, found, transfer.follows, made.moving)
    if options.map is not None:
        lacking = None
    lacking = collapsed(source, found, made.longest) or lacking
    if lacking is not None and not options.force_fit and not same:
        raise FormatError(lacking)
    made.forced = [] if lacking is None else [lacking]
    contacts = made.standing.contacts if lock else ()
    if contacts and not any(own.any.any() for own in contacts):
        message = "no foot is planted in any frame: none is held"
        hint = "does the take show a person with legs, for more than two frames?"
        notices.append(Fault("MAP007", message, hint=hint, severity=Severity.NOTE))
    return made, found, notices


def _paired(
    source: Rig, target: Rig, options: RetargetOptions, positions: FloatArray
) -> JointMap:
    """Return which joints follow which; ``positions``: of the source's ``(J, 3)``."""
    try:
        return map_joints(
            source,
            target,
            preset=options.preset,
            target_preset=options.target_preset,
            map_file=options.map,
            mode=options.by,
            source_positions=positions,
        )
    except OptionError as error:
        if error.code == "MAP004":
            roles = anatomy(source, preset=options.preset, positions=positions).roles
            nothing = nothing_paired(source, roles, target)
            if nothing is not None:
                raise FormatError(nothing) from error
        raise


def _rest(
    blocks: Iterator[Motion], frame: int | None
) -> tuple[FloatArray | None, Iterator[Motion]]:
    """Return local turns of the frame that is the rest pose ``(J, 4)``, and all blocks.

    Raises:
        OptionError: There is no such frame (MAP006).
    """
    if frame is None:
        return None, blocks
    held, count = [], 0
    for motion in blocks:
        held.append(motion)
        if count < frame <= count + motion.frames:
            turns = motion.select(slice(frame - 1 - count, frame - count)).rotations
            return turns.dense()[0], chain(held, blocks)
        count += motion.frames
    message = f"the rest pose is frame {frame}, but the take has {count}"
    raise OptionError(Fault("MAP006", message, where="rest"))


def _positions(rig: Rig, first: Motion, rest: FloatArray | None) -> FloatArray:
    """Return where joints are in a pose of a person who stands ``(J, 3)`` [m].

    That of the rest pose, or of the first frame: of a skeleton that has none.
    """
    start = first.select(slice(0, 1))
    turns = start.rotations.dense() if rest is None else rest[None]
    return np.asarray(forward(rig, start.translations.dense(), turns).positions[0])


# Between these a person, a child, a giant and a doll stand; beyond them it is rather a
# unit that is wrong, of which the smallest step but one is 10.
LIKELY_SCALES = (1 / 9, 9.0)


def _scale_warnings(scale: float) -> list[Fault]:
    """Return a warning of a rig that is of another order of size than the take."""
    low, high = LIKELY_SCALES
    if low <= scale <= high:
        return []
    message = f"the rig is {scale:.3g} times the size of the person in the take"
    hint = (
        f"is the unit right? {argument('source.unit')} sets that of a BVH take; a "
        "rig file states its own"
    )
    return [Fault("MAP106", message, hint=hint, severity=Severity.WARNING)]


def _named_rig(options: RetargetPassOptions) -> Path:
    if options.rig is None:
        message = "rig must name the file of a rig"
        raise OptionError(Fault("CAP001", message))
    return options.rig


def _run(stream: TakeStream, options: Any, context: PassContext) -> TakeStream:
    # The take says where it goes, and not the stage that has the rig.
    rig = at_origin(Rig.load(context.folder / _named_rig(options)))
    names = RetargetOptions.__dataclass_fields__
    settings = RetargetOptions(**{name: getattr(options, name) for name in names})
    if settings.map is not None:
        settings = replace(settings, map=context.folder / settings.map)
    props = Props(stream.tracks) if stream.tracks and settings.hold_hands else None
    if props is not None:
        stream = replace(stream, blocks=props.noting(stream.blocks))
    # What is beside the rig passes by; frames stay as they are.
    beyond = PassthroughTracks(stream) if stream.tracks else None
    own = stream if beyond is None else beyond.stream
    made, _, notices = onto_rig(own, rig, settings, props=props)
    context.notices.extend(notices)
    blocks = checked_blocks(made, settings, stream.notices)
    done = replace(own, rig=rig, blocks=_scored(made, blocks, context))
    if beyond is None:
        return done
    done = beyond.restore(done)
    if props is None:
        return done
    held = {track for hand in made.standing.hands for track in hand.props}
    return replace(done, tracks=props.moved(held, made.transfer, made.lift))


def _scored(
    made: Retargeting, blocks: Iterator[Motion], context: PassContext
) -> Iterator[Motion]:
    """Yield the motion of the target, and say how well it fits at the end."""
    yield from blocks
    context.scores.append(scores_of(made.report()))


def checked_blocks(
    made: Retargeting,
    options: RetargetOptions,
    notices: list[Fault],
    path: Path | None = None,
) -> Iterator[Motion]:
    """Yield the motion of the target, and at the end add warnings of bad scores.

    path: the file that they are located at.
    """
    yield from made.blocks()
    if options.warn_above is None:
        return
    for score in scores_of(made.report()).scores:
        if score.excess > options.warn_above:
            good = replace(score, value=score.usual).text
            message = f"{score.name} {score.text}; a good take has up to {good}"
            hint = "the report names the joints; check limits, map and rest pose"
            file = None if path is None else str(path)
            fault = Fault("MAP107", message, file, (), hint, Severity.WARNING)
            notices.append(fault)


def _check_bound(options: Any) -> None:
    """Refuse a bound of scores that is none (CAP001)."""
    bound = options.warn_above
    if bound is not None and not 0 <= bound < np.inf:
        message = f"warn_above must be finite and 0 or more, not {bound:g}"
        raise OptionError(Fault("CAP001", message))


def _checks(options: Any) -> OptionChecks:
    return {
        "rig": lambda: _named_rig(options),
        "warn_above": lambda: _check_bound(options),
    }


PASS = Pass(
    "retarget",
    "Transfer the take to another rig, with planted feet held",
    RetargetPassOptions,
    Scope.WINDOW,
    _run,
    _checks,
    reads=frozenset({TakePart.RIG, TakePart.JOINTS, TakePart.CLOCK, TakePart.TRACKS}),
    changes=MOTION_PARTS | {TakePart.RIG, TakePart.TRACKS},
)


@dataclass(frozen=True, slots=True)
class FeetOptions:
    """What feet are told by.

    Attributes:
        map: A map file that says which joints are legs and feet; None finds them.
    """

    map: Path | None = None


def nobody(error: OptionError) -> Fault:
    """Return a warning that a take is of no person, where that is what is wrong."""
    if error.code != "MAP004":
        raise error
    message = "no person was recognised in the take: it is unchanged"
    hint = "name its joints in a map file, or skip what needs a person"
    return Fault("CAP105", message, hint=hint, severity=Severity.WARNING)


def held_feet(take: Take, options: FeetOptions, context: PassContext) -> Take:
    """Return a take whose feet stay where they stand; its legs and hips move for it."""
    path = None if options.map is None else context.folder / options.map
    settings = RetargetOptions(map=path)
    try:
        made, _, notices = onto_rig(TakeStream.of(take), take.rig, settings, same=True)
    except OptionError as error:
        context.notices.append(nobody(error))
        return take
    context.notices.extend(notices)
    if made.standing.placed is None:
        return take
    motion = Motion.concatenate(list(made.blocks()))
    context.scores.append(scores_of(made.report()))
    person = made.transfer.target
    legs = {leg_of(person, side)[0] for side in made.standing.sides}
    for j, parent in enumerate(take.rig.parents.tolist()):
        if parent in legs:
            legs.add(j)
    moved, root = np.array(sorted(legs)), np.array([max(person.first("hips"), 0)])
    old = take.motion
    held = replace(
        old,
        rotations=old.rotations.put(moved, motion.rotations.gather(moved)),
        translations=old.translations.put(root, motion.translations.gather(root)),
    )
    return replace(take, motion=held)


FEET = Pass(
    "feet",
    "Hold planted feet in place",
    FeetOptions,
    Scope.CLIP,
    held_feet,
    reads=frozenset({TakePart.RIG, TakePart.JOINTS, TakePart.CLOCK}),
    changes=frozenset({TakePart.JOINTS}),
)
