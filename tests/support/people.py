"""Skeletons of a person, with the names of any convention."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from animtool.retarget.names import presets
from animtool.retarget.roles import DIGITS
from animtool.rig.skeleton import Joint, Rig

Vector = tuple[float, float, float]

# A parent each and the offset from it [m], in T pose: Y up, facing +Z.
CENTER: dict[str, tuple[str, Vector]] = {
    "hips": ("", (0, 0.95, 0)),
    "spine": ("hips", (0, 0.1, 0)),
    "spine_2": ("spine", (0, 0.12, -0.01)),
    "spine_3": ("spine_2", (0, 0.13, -0.01)),
    "neck": ("spine_3", (0, 0.18, 0.02)),
    "head": ("neck", (0, 0.1, 0.02)),
}
# Of the left side.
LIMBS: dict[str, tuple[str, Vector]] = {
    "clavicle": ("spine_3", (0.03, 0.12, 0.02)),
    "upper_arm": ("clavicle", (0.14, 0, -0.02)),
    "forearm": ("upper_arm", (0.28, 0, 0)),
    "hand": ("forearm", (0.25, 0, 0)),
    "thigh": ("hips", (0.09, -0.05, 0)),
    "shin": ("thigh", (0, -0.43, 0.01)),
    "foot": ("shin", (0, -0.41, -0.02)),
    "toe": ("foot", (0, -0.06, 0.13)),
}
_ACROSS = dict(zip(DIGITS, (0.03, 0.025, 0.003, -0.018, -0.036), strict=True))


def _fingers(*, metacarpals: bool) -> dict[str, tuple[str, Vector]]:
    joints: dict[str, tuple[str, Vector]] = {
        "thumb_1": ("hand", (0.022, -0.012, 0.026)),
        "thumb_2": ("thumb_1", (0.027, 0, 0.036)),
        "thumb_3": ("thumb_2", (0.019, 0, 0.025)),
    }
    for digit in DIGITS[1:]:
        z = _ACROSS[digit]
        if metacarpals:
            joints[f"{digit}_0"] = ("hand", (0.025, 0, z / 2))
            joints[f"{digit}_1"] = (f"{digit}_0", (0.065, 0, z / 2))
        else:
            joints[f"{digit}_1"] = ("hand", (0.09, 0, z))
        joints[f"{digit}_2"] = (f"{digit}_1", (0.04, 0, 0))
        joints[f"{digit}_3"] = (f"{digit}_2", (0.026, 0, 0))
    return joints


# Of the left hand, without and with metacarpals.
DIGIT_JOINTS = {each: _fingers(metacarpals=each) for each in (False, True)}


def person(
    rename: Callable[[str], str] = str,
    *,
    fingers: bool = True,
    metacarpals: bool = False,
) -> tuple[Rig, dict[str, str]]:
    """Return a person's rig, and the role of each joint by its name.

    Args:
        rename: The name of a joint by its role; of the spine's, ``spine``, ``spine_2``
            and ``spine_3``. Empty leaves out a joint, and what hangs on it moves up.
        fingers: Whether it has any.
        metacarpals: Whether the fingers have them.
    """
    limbs = {**LIMBS, **(DIGIT_JOINTS[metacarpals] if fingers else {})}
    tree = dict(CENTER)
    for side, sign in (("l", 1), ("r", -1)):
        for role, (parent, (x, y, z)) in limbs.items():
            above = parent if parent in CENTER else f"{parent}_{side}"
            tree[f"{role}_{side}"] = (above, (sign * x, y, z))
    return build(tree, rename)


def build(
    tree: Mapping[str, tuple[str, Vector]], rename: Callable[[str], str] = str
) -> tuple[Rig, dict[str, str]]:
    """Return the rig of a tree of roles, and the role of each joint by its name."""
    joints: list[Joint] = []
    at: dict[str, tuple[int, Vector]] = {"": (-1, (0.0, 0.0, 0.0))}
    roles: dict[str, str] = {}
    for role, (parent, offset) in tree.items():
        above, extra = at[parent]
        moved = tuple(a + b for a, b in zip(offset, extra, strict=True))
        name = rename(role)
        if not name:
            at[role] = (above, moved)
            continue
        at[role] = (len(joints), (0.0, 0.0, 0.0))
        joints.append(Joint(name, above, translation=moved))
        roles[name] = "spine" if role.startswith("spine") else role
    return Rig("person", tuple(joints)), roles


def named(preset: str) -> Callable[[str], str]:
    """Return the names of a convention, for `person`; empty where it has none."""
    table = presets()[preset].names_by_role

    def rename(role: str) -> str:
        base, _, number = role.partition("_")
        if base == "spine":
            names = table.get("spine", ())
            index = int(number or 1) - 1
            return names[index] if index < len(names) else ""
        return table.get(role, ("",))[0]

    return rename
