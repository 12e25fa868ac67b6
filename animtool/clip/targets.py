"""What the channels of a clip may move, on a rig."""

from __future__ import annotations

from collections.abc import Iterable

from animtool.documents.names import nearest
from animtool.errors import Fault, OptionError
from animtool.rig.skeleton import Rig
from animtool.rig.targets import KEYED_PARTS, nearest_part, split_part


def target_kind(target: str, rig: Rig | None) -> str | Fault:
    """Return what a target of a rig is, or what is wrong with it.

    One of control, shape, angle, slide, translation, rotation, scale. Where the rig is
    not known, all names are right.

    >>> from animtool.rig.skeleton import Joint, JointType
    >>> arm = Rig("arm", (Joint("elbow", -1, JointType.PIN),))
    >>> target_kind("joint/elbow.angle", arm)
    'angle'
    >>> print(target_kind("joint/elbow.slide", arm))
    CLIP003 a pin joint has no slide, it has angle, local_translation, \
local_rotation, scale
    """
    group, _, name = target.partition("/")
    if group in {"control", "shape"} and name:
        if rig is None:
            return group
        props = rig.controls if group == "control" else rig.shapes
        names = [prop.name for prop in props]
        if name not in names:
            return Fault(
                "CLIP002", f"{name!r} is no {group}", hint=nearest(name, names)
            )
        return group
    if group != "joint" or not name:
        hint = "control/NAME, shape/NAME or joint/NAME.PART"
        return Fault("CLIP001", f"{target!r} is no target", hint=hint)
    return _joint_kind(name, rig)


def _joint_kind(name: str, rig: Rig | None) -> str | Fault:
    joint, part = split_part(name, KEYED_PARTS)
    if not part:
        hint = f"a joint's name and one of .{', .'.join(KEYED_PARTS)}"
        hint = nearest_part(name, KEYED_PARTS) or hint
        return Fault("CLIP001", f"{name!r} names no part of a joint", hint=hint)
    kind = {"angle": "angle", "slide": "slide", "scale": "scale"}.get(
        part, "rotation" if part.endswith("rotation") else "translation"
    )
    if rig is None:
        return kind
    if joint not in rig.names:
        hint = nearest(joint, rig.names)
        return Fault("CLIP002", f"{joint!r} is no joint", hint=hint)
    found = rig.joints[rig.index(joint)]
    if found.type not in KEYED_PARTS[part]:
        fitting = [p for p, types in KEYED_PARTS.items() if found.type in types]
        message = f"a {found.type} joint has no {part}"
        return Fault("CLIP003", message, hint=f"it has {', '.join(fitting)}")
    return kind


def check_targets(targets: Iterable[str], rig: Rig) -> None:
    """Refuse targets that a rig has not.

    Raises:
        OptionError: With a fault for each.
    """
    found = [target_kind(target, rig) for target in targets]
    faults = [fault for fault in found if isinstance(fault, Fault)]
    if faults:
        raise OptionError(faults)
