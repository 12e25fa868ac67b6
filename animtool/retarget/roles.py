"""Roles of body joints, such as ``hips``, ``forearm_l`` and ``index_2_r``.

Several joints may share a role, as a chain: extra joints within an upper arm all are
``upper_arm_l``. Fingers have a role for each joint: 0 is the metacarpal, 1 to 3 the
phalanges; a thumb has 1 (its metacarpal) to 3.
"""

from __future__ import annotations

from enum import StrEnum
from typing import Literal, TypeAlias

from animtool.core.errors import Fault
from animtool.core.record import dataclass

CENTER_ROLES = ("root", "hips", "pelvis", "spine", "neck", "head", "jaw")
ARM_ROLES = ("clavicle", "upper_arm", "forearm", "hand")
# Joints between hips and thigh belong to the pelvis.
LEG_ROLES = ("pelvis", "thigh", "shin", "foot", "toe")
DIGITS = ("thumb", "index", "middle", "ring", "pinky")
FINGER_ROLES = tuple(
    f"{digit}_{i}" for digit in DIGITS for i in range(digit == "thumb", 4)
)
# All fingers but the thumb as one, as in a mitten.
MITTEN_ROLE = "fingers"
SIDED_ROLES = (*ARM_ROLES, *LEG_ROLES, *FINGER_ROLES, MITTEN_ROLE, "eye")
SIDES = ("l", "r")
ROLES: tuple[str, ...] = (
    *CENTER_ROLES,
    *(f"{r}_{s}" for s in SIDES for r in SIDED_ROLES),
)
# Kinds of joints that have no role.
TWIST, END, CONTROL = "twist", "end", "control"


# Evidence for pairs: names and structure; names only; structure only; or joints of the
# same name or role one to one, for takes that only need other names.
MapMode: TypeAlias = Literal["auto", "names", "structure", "rename"]


class RoleSource(StrEnum):
    """Evidence for the role of a joint."""

    PRESET = "preset"  # its name belongs to a naming convention
    NAME = "name"  # its name contains a word that many conventions use
    STRUCTURE = "structure"  # its position in the tree
    FILE = "file"  # stated in a map file
    NONE = ""


@dataclass(frozen=True, slots=True)
class Anatomy:
    """The roles of a skeleton's J joints, each with its evidence and confidence."""

    # One of `ROLES`, or `TWIST`, `END`, `CONTROL` or empty, per joint ``(J,)``.
    roles: tuple[str, ...]
    evidence: tuple[RoleSource, ...]  # ``(J,)``
    confidence: tuple[float, ...]  # 0 to 1 ``(J,)``
    preset: str = ""  # the naming convention; empty for none
    notices: tuple[Fault, ...] = ()

    def chain(self, role: str) -> tuple[int, ...]:
        """Return the joints of a role, parents before children."""
        return tuple(j for j, joint_role in enumerate(self.roles) if joint_role == role)


def base_role(role: str) -> str:
    """Strip the side suffix from a role.

    >>> base_role("upper_arm_l"), base_role("spine")
    ('upper_arm', 'spine')
    """
    return role[:-2] if role[-2:] in {"_l", "_r"} else role
