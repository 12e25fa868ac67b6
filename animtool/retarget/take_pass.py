"""The pass ``retarget``: transfers takes onto another rig."""

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
    refuse,
    warning,
)
from animtool.core.options import with_text_values
from animtool.core.quantities import length_text, plain_number
from animtool.core.record import dataclass
from animtool.documents.versions import file_of_kind
from animtool.maths import so3
from animtool.motion.motion import Motion
from animtool.motion.passes import (
    MOTION_PARTS,
    FrameScope,
    OptionChecks,
    Pass,
    PassContext,
    PassthroughTracks,
    TakePart,
)
from animtool.motion.take import TakeStream
from animtool.retarget.anatomy import find_anatomy
from animtool.retarget.file import load_map
from animtool.retarget.implausible_motion import (
    CAPTURE_FORMATS,
    GroundCheck,
    fast_motion_warning,
)
from animtool.retarget.map import JointMap
from animtool.retarget.motion import Retargeting, build_transfer
from animtool.retarget.names import check_presets
from animtool.retarget.options import RetargetOptions
from animtool.retarget.pairing import map_joints
from animtool.retarget.props import PropTracks
from animtool.retarget.report import fit_scores
from animtool.retarget.roles import (
    CONTROL,
    END,
    FINGER_ROLES,
    MITTEN_ROLE,
    TWIST,
    base_role,
)
from animtool.retarget.root_position import root_warning
from animtool.retarget.standing import (
    UP_AXIS_HINTS,
    find_standing_axis,
    has_swapped_channels,
    unit_warnings,
)
from animtool.retarget.swapped_sides import swapped_sides_warning
from animtool.retarget.transfer import Transfer
from animtool.retarget.verdict import is_likely_scale
from animtool.rig.kinematics import forward_kinematics
from animtool.rig.placed import at_origin
from animtool.rig.skeleton import Rig

# Limbs in the same pose at rest differ by less [deg]; an A-pose differs by 30 or more.
MAX_REST_DIFFERENCE = 20.0
# Bones of a complete limb.
LIMB_BONES = {"arm": ("upper_arm", "forearm", "hand"), "leg": ("thigh", "shin", "foot")}
# Minimum fraction of a take's moving joints that are paired [1].
MIN_PAIRED_FRACTION = 1 / 3
# Joints irrelevant to body motion: some takes have hundreds of them.
_DETAIL_ROLES = {*FINGER_ROLES, MITTEN_ROLE, "toe", "jaw", "eye", TWIST, END, CONTROL}
_END_ROLES = {"head", "hand", "foot"}
MAX_LISTED_LIMBS = 6
# A bone shorter than this fraction of its rest length has no length [1].
ZERO_LENGTH_FRACTION = 1e-4


def insufficient_pairs_fault(
    source: Rig,
    joint_map: JointMap,
    source_joints: IntArray,
    moving_joints: Collection[int],
) -> Fault | None:
    """Return a fault if too few joints of a take are mapped (MAP010), else None.

    ``source_joints`` ``(K,)`` are the source joints of the target joints. If none of
    the source's joints is in ``moving_joints``, all count.
    """
    roles = joint_map.source.roles
    used_joints = {pair.source for pair in joint_map.pairs} | {*source_joints.tolist()}
    used_joints |= {j for chain in joint_map.chains for j in chain.source}
    limbs = _complete_limbs(roles)
    intact_limbs = [
        name for name, joints in limbs.items() if used_joints.issuperset(joints)
    ]
    body_joints = _body_joints(source, roles)
    relevant_joints = [j for j in body_joints if j in moving_joints] or body_joints
    paired_joints = [j for j in relevant_joints if j in used_joints]
    if len(paired_joints) >= MIN_PAIRED_FRACTION * len(relevant_joints) and (
        intact_limbs or not limbs
    ):
        return None
    joints_text = counted(len(relevant_joints), "moving joint")
    message = f"{len(paired_joints)} of {joints_text} of {source.name!r} are paired"
    if limbs and not intact_limbs:
        limbs_text = listed(sorted(limbs), MAX_LISTED_LIMBS)
        message += f", and none of its limbs ({limbs_text})"
    hint = "write a map file, or retarget what is paired with "
    hint += f"{argument('force_fit', True)}, in a pass force_fit: true"
    return Fault("MAP010", message, hint=hint)


def zero_length_fault(
    source: Rig, joint_map: JointMap, max_bone_lengths: FloatArray
) -> Fault | None:
    """Return a fault that lists the limbs with zero-length bones (MAP011), or None.

    ``max_bone_lengths`` are the largest distances of source joints from their parents
    in the take ``(J,)`` [m].
    """
    roles = joint_map.source.roles
    rest_lengths = np.linalg.norm(source.rest_translations, axis=1)
    has_collapsed = (max_bone_lengths <= ZERO_LENGTH_FRACTION * rest_lengths) & (
        rest_lengths > 0
    )
    has_collapsed &= source.parents >= 0
    limb_joints: set[int] = set()
    for start_joint, *_, end_joint in _complete_limbs(roles).values():
        path = source.upwards(end_joint)
        if start_joint in path:
            limb_joints.update(path[: path.index(start_joint)])
    bones = sorted(j for j in limb_joints if has_collapsed[j])
    if not bones:
        return None
    bones_text = listed([repr(source.names[j]) for j in bones], MAX_LISTED_LIMBS)
    rest_length_text = length_text(float(rest_lengths[bones].max()))
    message = (
        f"{counted(len(bones), 'limb bone')} of {source.name!r} have zero length in "
        f"every frame, but up to {rest_length_text} at rest: "
        f"{bones_text} are at their parents' positions"
    )
    hint = (
        f"for a BVH, {argument('source.positions', 'offsets')} uses the OFFSETs; "
        f"{argument('force_fit', True)}, in a pass force_fit: true, retargets it as it "
        "is"
    )
    return Fault("MAP011", message, hint=hint)


def _complete_limbs(roles: tuple[str, ...]) -> dict[str, list[int]]:
    """Return the joints of a skeleton's complete limbs, by name."""
    joints_by_limb = {}
    for name, bones in LIMB_BONES.items():
        for side, text in (("l", "left"), ("r", "right")):
            bone_roles = [f"{bone}_{side}" for bone in bones]
            if {*bone_roles} <= {*roles}:
                joints_by_limb[f"{text} {name}"] = [
                    roles.index(role) for role in bone_roles
                ]
    return joints_by_limb


def _body_joints(rig: Rig, roles: tuple[str, ...]) -> list[int]:
    """Return the joints of a skeleton except fingers, toes, face and twist joints."""
    joints = []
    for j, role in enumerate(roles):
        end_roles = {base_role(roles[k]) for k in rig.upwards(j)[1:]} & _END_ROLES
        if base_role(role) not in _DETAIL_ROLES and not (end_roles and not role):
            joints.append(j)
    return joints


@with_text_values(RetargetOptions)
@dataclass(frozen=True)
class RetargetPassOptions:
    """The target rig, and the options of `RetargetOptions`."""

    rig: Path | None = None  # the rig file


def retarget_stream(
    stream: TakeStream,
    rig: Rig,
    options: RetargetOptions,
    *,
    plants_similar_legs: bool = False,
    props: PropTracks | None = None,
) -> tuple[Retargeting, JointMap, list[Fault]]:
    """Return the retargeting of a take, the joint map, and its warnings.

    With ``plants_similar_legs``, feet are also planted on legs like those of the
    source. ``props`` are tracks of the take that hands may grip.
    """
    _check_warn_above(options)
    has_same_rest = options.rest == "rig"
    frame = None if isinstance(options.rest, str) else options.rest
    rest_rotations, blocks = _read_rest_frame(stream.blocks, frame)
    first_block = next(blocks)
    positions = _standing_positions(stream.rig, first_block, rest_rotations)
    joint_map = _pair_joints(stream.rig, rig, options, positions)
    notices = list(joint_map.notices)
    notices += _unused_option_warnings(stream.rig, rig, options, positions, joint_map)
    # A stage's rotation of its character is motion, not part of its rest pose.
    source = at_origin(stream.rig)
    stance_axis = find_standing_axis(source, first_block, joint_map.source.roles)
    is_swapped = has_swapped_channels(stream.notices)
    if is_swapped:
        stance_axis = None
    if stance_axis is not None and stream.details.get("up_choice") == "stated":
        stated_option = argument("source.up", source.up)
        message = f"the body stands along {stance_axis}, but {stated_option} was given"
        hint = f"read it with {argument('source.up', stance_axis)}"
        notices.append(warning("MOT214", message, hint))
    elif stance_axis is not None:
        message = f"the body stands along {stance_axis}, though the take's up axis is "
        message += f"{source.up}; using {stance_axis} up"
        file_format = stream.details.get("format")
        hint = f"confirm with {argument('source.up', stance_axis)}, or write "
        hint += f"{argument('source.up', source.up)} if it lies"
        if file_format in UP_AXIS_HINTS:  # the file states it
            hint = UP_AXIS_HINTS[str(file_format)].format(stance_axis)
            hint += " if it does not lie"
        notices.append(warning("MAP009", message, hint))
        source = replace(source, up=stance_axis)
    transfer = build_transfer(
        source, rig, joint_map, rest_rotations, has_same_rest=has_same_rest
    )
    notices += _fit_warnings(stream, transfer, joint_map if has_same_rest else None)
    known_codes = {notice.code for notice in (*notices, *stream.notices)}
    notices += [
        notice
        for notice in (() if is_swapped else _source_warnings(stream, first_block))
        if notice.code not in known_codes
    ]
    ground_check = GroundCheck(stream)
    retargeting = Retargeting(
        transfer,
        joint_map,
        ground_check.recorded_blocks(chain([first_block], blocks)),
        float(stream.fps / stream.step),
        lock=not options.free_feet,
        plants_similar_legs=plants_similar_legs,
        hands=options.hold_hands,
        props=props,
    )
    retargeting.rest_frame, retargeting.ground_check = frame, ground_check
    fault = zero_length_fault(source, joint_map, retargeting.max_bone_lengths)
    few_pairs_fault = insufficient_pairs_fault(
        source, joint_map, transfer.source_joints, retargeting.moving_joints
    )
    notices += _few_entries_warning(few_pairs_fault, options)
    fault = fault or (few_pairs_fault if options.map is None else None)
    if fault is not None and not options.force_fit and not plants_similar_legs:
        raise FormatError(fault)
    retargeting.ignored_errors = [] if fault is None else [fault]
    contacts = () if options.free_feet else retargeting.contact_frames.contacts
    if contacts and not any(foot_contacts.any.any() for foot_contacts in contacts):
        message = "no foot is planted in any frame, so no foot is held"
        hint = "is it a character with legs, and is the take longer than two frames?"
        notices.append(Fault("MAP007", message, hint=hint, severity=Severity.NOTE))
    return retargeting, joint_map, notices


_DEFAULT_OPTIONS = RetargetOptions()


def _few_entries_warning(fault: Fault | None, options: RetargetOptions) -> list[Fault]:
    """Return a warning about a map with few pairs, unless it keeps the others at rest.

    ``fault`` tells how many joints are paired.
    """
    if fault is None or options.map is None or options.force_fit:
        return []
    file = load_map(options.map)
    if "others" in file.model.model_fields_set and file.model.others == "none":
        return []
    message, hint = f"{fault.message}: all others stay at rest", "add entries"
    if file.model.others == "none":
        hint = "write `others: auto` to pair the others by their names too, or "
        hint += "`others: none` if they are to stay"
    lines = (file.document.position(("joints",))[0],)
    return [
        replace(
            fault,
            message=message,
            path=str(options.map),
            lines=lines,
            hint=hint,
            severity=Severity.WARNING,
        )
    ]


def _pair_joints(
    source: Rig, target: Rig, options: RetargetOptions, source_positions: FloatArray
) -> JointMap:
    """Return the joint map, given standing source joint positions ``(J, 3)``."""
    try:
        return map_joints(
            source,
            target,
            preset=options.preset,
            target_preset=options.target_preset,
            map_file=options.map,
            mode=options.by,
            source_positions=source_positions,
        )
    except OptionError as error:
        if error.code == "MAP004":
            anatomy = find_anatomy(
                source, preset=options.preset, positions=source_positions
            )
            limbs = _complete_limbs(anatomy.roles)
            if limbs:  # else it is a prop
                message = f"no joint of {source.name!r} maps to one of "
                message += f"{target.name!r}, and none of its limbs "
                message += f"({listed(sorted(limbs), MAX_LISTED_LIMBS)})"
                hint = "choose another rig, or write a map file"
                raise FormatError(Fault("MAP010", message, hint=hint)) from error
        raise


def _unused_option_warnings(
    source: Rig,
    target: Rig,
    options: RetargetOptions,
    source_positions: FloatArray,
    joint_map: JointMap,
) -> list[Fault]:
    """Return a warning if options of pairing change nothing beside a map (MAP111)."""
    if options.map is None:
        return []
    file = load_map(options.map)
    if file.model.others == "auto":
        return []
    unused_names = []
    for name in ("by", "preset", "target_preset"):
        if getattr(options, name) != getattr(_DEFAULT_OPTIONS, name):
            other_options = replace(options, **{name: getattr(_DEFAULT_OPTIONS, name)})
            other_map = _pair_joints(source, target, other_options, source_positions)
            if all(
                getattr(joint_map, part) == getattr(other_map, part)
                for part in ("pairs", "chains", "twists")
            ):
                unused_names.append(name)
    if not unused_names:
        return []
    option_texts = [argument(name, getattr(options, name)) for name in unused_names]
    verb = "has" if len(option_texts) == 1 else "have"
    message = (
        f"{' and '.join(option_texts)} {verb} no effect: only the joints that this map "
    )
    message += "names are paired"
    lines: tuple[int, ...] = ()
    if "others" in file.model.model_fields_set:
        lines = (file.document.position(("others",))[0],)
        message += " (others: none)"
    hint = f"leave out {' and '.join(map(argument, unused_names))}, or write others: "
    hint += "auto in the map to pair the other joints too"
    return [Fault("MAP111", message, str(options.map), lines, hint, Severity.WARNING)]


def _read_rest_frame(
    blocks: Iterator[Motion], frame: int | None
) -> tuple[FloatArray | None, Iterator[Motion]]:
    """Return local rotations of the rest frame ``(J, 4)``, and all blocks."""
    if frame is None:
        return None, blocks
    read_blocks, frame_count = [], 0
    for motion in blocks:
        read_blocks.append(motion)
        if frame_count < frame <= frame_count + motion.frames:
            frame_index = frame - 1 - frame_count
            rotations = motion.select(slice(frame_index, frame_index + 1)).rotations
            return rotations.dense()[0], chain(read_blocks, blocks)
        frame_count += motion.frames
    message = f"frame {frame} is not in the take, which has frames 1-{frame_count}"
    raise OptionError(Fault("MAP006", message, where="rest"))


def _standing_positions(rig: Rig, block: Motion, rest: FloatArray | None) -> FloatArray:
    """Return joint positions in a standing pose ``(J, 3)`` [m].

    The pose is the rest pose, or the first frame if the skeleton has no rest pose.
    """
    first_frame = block.select(slice(0, 1))
    rotations = first_frame.rotations.dense() if rest is None else rest[None]
    pose = forward_kinematics(rig, first_frame.translations.dense(), rotations)
    return np.asarray(pose.positions[0])


def _size_warnings(stream: TakeStream, scale: float) -> list[Fault]:
    """Return a warning if rig and take differ in size by an order of magnitude."""
    source_codes = {notice.code for notice in stream.notices}
    if is_likely_scale(scale) or not source_codes.isdisjoint({"MOT213", "USD126"}):
        return []
    file_format = stream.details.get("format")
    if warnings := unit_warnings(stream.rig, file_format):
        return warnings
    message = f"the rig is {plain_number(scale)} times the size of the person in the "
    message += "take"
    hint = "correct the unit that the file of the take states, or units of the rig"
    if file_format in {"BVH", "glTF", "FBX"}:
        hint = f"give the unit of the take with {argument('source.unit')}, or correct "
        hint += "units of the rig"
    return [warning("MAP106", message, hint)]


def _fit_warnings(
    stream: TakeStream, transfer: Transfer, equated_map: JointMap | None
) -> list[Fault]:
    """Return warnings about sizes, and about rest poses that the map equates."""
    warnings = _size_warnings(stream, transfer.scale)
    if equated_map is not None:
        warnings += _other_rest_warnings(transfer, equated_map)
    return warnings


def _other_rest_warnings(transfer: Transfer, joint_map: JointMap) -> list[Fault]:
    """Return a warning if limbs at rest differ, although rests are equated (MAP110)."""
    aimed_transfer = Transfer.of(transfer.source, transfer.target, joint_map)
    angles = so3.angle_between(transfer.rest_alignment, aimed_transfer.rest_alignment)
    bones = {bone for limb in LIMB_BONES.values() for bone in limb[:2]}
    is_limb = [base_role(role) in bones for role in transfer.target.roles]
    angles = np.degrees(np.where(is_limb, angles, 0.0))
    if float(angles.max(initial=0.0)) < MAX_REST_DIFFERENCE:
        return []
    j = int(angles.argmax())
    source_joint = int(transfer.source_joints[j])
    joint_names = transfer.source.rig.names[source_joint], transfer.target.rig.names[j]
    message = f"with {argument('rest', 'rig')}, {joint_names[0]!r} of the take and "
    message += f"{joint_names[1]!r} of the rig count as equal at rest, but differ by "
    message += f"{angles[j]:.0f}°, as an A-pose from a T-pose"
    return [warning("MAP110", message, f"leave out {argument('rest')}")]


def _source_warnings(stream: TakeStream, first_block: Motion) -> list[Fault]:
    """Return warnings about the root, the legs and the rate of a take."""
    rate, file_format = stream.fps / stream.step, stream.details.get("format")
    notices = (
        root_warning(stream.rig, first_block, float(1 / rate)),
        swapped_sides_warning(stream.rig, first_block, str(file_format)),
    )
    fast_motion = []
    if file_format in CAPTURE_FORMATS:
        fast_motion = fast_motion_warning(stream.rig, first_block, rate, "source.fps")
    return [*filter(None, notices), *fast_motion]


def _rig_path(options: RetargetPassOptions) -> Path:
    """Return the path of the target rig; refuse options without one (CAP001)."""
    if options.rig is None:
        refuse("CAP001", "rig must name the file of a rig")
    return options.rig


def _run_pass(stream: TakeStream, options: Any, context: PassContext) -> TakeStream:
    """Return the stream retargeted onto the rig; the fit is reported at its end."""
    # The take determines root motion, not the rig's stage.
    rig_path = _rig_path(options)
    with file_of_kind(rig_path, "rig", "rig"):
        rig = at_origin(Rig.load(context.folder / rig_path))
    option_names = RetargetOptions.__dataclass_fields__
    retarget_options = RetargetOptions(
        **{name: getattr(options, name) for name in option_names}
    )
    if retarget_options.map is not None:
        retarget_options = replace(
            retarget_options, map=context.folder / retarget_options.map
        )
    props = (
        PropTracks(stream.tracks)
        if stream.tracks and retarget_options.hold_hands
        else None
    )
    if props is not None:
        stream = replace(stream, blocks=props.record_times(stream.blocks))
    # Other tracks pass through; frames stay unchanged.
    passthrough = PassthroughTracks(stream) if stream.tracks else None
    source = stream if passthrough is None else passthrough.stream
    retargeting, _, notices = retarget_stream(
        source, rig, retarget_options, props=props
    )
    context.notices.extend(notices)
    blocks = checked_blocks(retargeting, retarget_options, stream.notices)
    retargeted_stream = replace(
        source,
        rig=rig,
        blocks=_with_fit_report(retargeting, blocks, context),
        unread_meshes=None,
    )
    if passthrough is None:
        return retargeted_stream
    retargeted_stream = passthrough.restore(retargeted_stream)
    if props is None:
        return retargeted_stream
    hands, transfer = retargeting.contact_frames.hands, retargeting.transfer
    gripped_tracks = {track for hand in hands for track in hand.props}
    tracks = props.rescale_gripped(gripped_tracks, transfer, retargeting.ground_offset)
    return replace(retargeted_stream, tracks=tracks)


def _with_fit_report(
    retargeting: Retargeting, blocks: Iterator[Motion], context: PassContext
) -> Iterator[Motion]:
    """Yield the target's motion; report the fit at the end."""
    yield from blocks
    context.scores.append(fit_scores(retargeting.report()))


def checked_blocks(
    retargeting: Retargeting,
    options: RetargetOptions,
    notices: list[Fault],
    path: Path | None = None,
) -> Iterator[Motion]:
    """Yield the target's motion; add warnings of bad scores at the end.

    path: the file that the warnings refer to.
    """
    yield from retargeting.blocks()
    file_text = None if path is None else str(path)
    if retargeting.ground_check is not None:
        ground_notices = retargeting.ground_check.notices([n.code for n in notices])
        notices += [replace(notice, path=file_text) for notice in ground_notices]
    stopped_joints = retargeting.stopped_by_rest_frame
    if stopped_joints:
        message = f"with frame {options.rest} as the rest pose, limits stop "
        joints_text = listed([repr(name) for name in stopped_joints], 4)
        message += f"{joints_text} in nearly all frames"
        hint = "choose a frame in which the person stands still in the rest pose of "
        hint += f"the rig, or leave out {argument('rest')}"
        notices.append(Fault("MAP110", message, file_text, (), hint, Severity.WARNING))
    if options.warn_above is None:
        return
    for score in fit_scores(retargeting.report()).scores:
        if score.excess > options.warn_above:
            good_text = replace(score, value=score.usual).text
            message = f"{score.name} {score.text}; a good take has up to {good_text}"
            hint = "the report names the joints; check limits, map and rest pose"
            notices.append(
                Fault("MAP107", message, file_text, (), hint, Severity.WARNING)
            )


def _check_warn_above(options: Any) -> None:
    """Refuse a score bound that is negative or infinite (CAP001)."""
    bound = options.warn_above
    if bound is not None and not 0 <= bound < np.inf:
        refuse("CAP001", f"warn_above must be finite and 0 or more, not {bound:g}")


def _option_checks(options: Any) -> OptionChecks:
    """Return the function that checks each option, by option name."""
    return {
        "rig": lambda: _rig_path(options),
        "warn_above": lambda: _check_warn_above(options),
        "preset": lambda: check_presets(preset=options.preset),
        "target_preset": lambda: check_presets(target_preset=options.target_preset),
    }


PASS = Pass(
    "retarget",
    "Transfer the take to another rig, with planted feet held",
    RetargetPassOptions,
    FrameScope.WINDOW,
    _run_pass,
    _option_checks,
    reads=frozenset({TakePart.RIG, TakePart.JOINTS, TakePart.CLOCK, TakePart.TRACKS}),
    changes=MOTION_PARTS | {TakePart.RIG, TakePart.TRACKS},
)
