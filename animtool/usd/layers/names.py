"""Legal, distinct USD names for joints, and their original names."""

from __future__ import annotations

from collections.abc import Sequence

from pxr import Sdf

from animtool.core.errors import Fault, Severity, excerpt
from animtool.core.names import numbered_names
from animtool.core.record import dataclass
from animtool.rig.skeleton import Joint

# The variant set of a library with a variant per take.
TAKE_SET = "take"


@dataclass(frozen=True, slots=True)
class UsdNames:
    """Names for the joints of a rig."""

    names: list[str]  # legal, distinct names
    # Source names by legal name, if they differ.
    originals: dict[str, str]
    notices: list[Fault]  # a warning for each pair of names that became equal


def plain_text(name: str) -> str:
    r"""Return a text that USD accepts: invalid bytes are replaced.

    File names may contain such bytes.

    >>> plain_text("walk\udcff")
    'walk?'
    """
    return name.encode("utf-8", "replace").decode("utf-8")


def legal_name(name: str) -> str:
    """Return the name with every illegal character replaced by ``_``.

    >>> legal_name("rig:Arm.L"), legal_name("2nd")
    ('rig_Arm_L', '_2nd')
    """
    name = plain_text(name)
    if Sdf.Path.IsValidIdentifier(name):
        return name
    legal = "".join(c if Sdf.Path.IsValidIdentifier("a" + c) else "_" for c in name)
    return legal if Sdf.Path.IsValidIdentifier(legal) else "_" + legal


def joint_names(joints: Sequence[Joint], strip_namespaces: int = 0) -> UsdNames:
    """Return names for joints, optionally without namespaces (``ns:``)."""
    short_names = []
    for joint in joints:
        namespaces = joint.name.split(":")
        short_names.append(
            ":".join(namespaces[min(strip_namespaces, len(namespaces) - 1) :])
        )
    return distinct_names(
        [joint.name for joint in joints],
        short_names,
        # A name that was already numbered is not a collision.
        [joint.source_name or joint.name for joint in joints],
    )


def distinct_names(
    original_names: Sequence[str], proposed: Sequence[str], sources: Sequence[str]
) -> UsdNames:
    """Return legal, distinct names."""
    names: list[str] = []
    originals: dict[str, str] = {}
    first_source: dict[str, str] = {}
    notices: list[Fault] = []
    legals = list(map(legal_name, proposed))
    rows = zip(original_names, legals, numbered_names(legals), sources, strict=True)
    for name, legal, unique, source in rows:
        if unique != legal:
            notices.append(
                Fault(
                    "USD101",
                    f"{excerpt(first_source[legal])} and {excerpt(name)} both become "
                    f"{excerpt(legal)} in USD; the second is written as {unique!r}",
                    severity=Severity.WARNING,
                )
            )
        first_source[unique] = name
        names.append(unique)
        if unique != source:
            originals[unique] = source
    return UsdNames(names, originals, notices)


@dataclass(frozen=True, slots=True)
class RigPaths:
    """Prim paths of a character."""

    model: str  # the component, ``/hero``
    root: str  # the SkelRoot, ``/hero/Rig``
    skeleton: str  # the Skeleton, ``/hero/Rig/Skel``
    animation: str  # the SkelAnimation, ``/hero/Rig/Anim``
    binding: str  # the prim that carries ``skel:animationSource``

    @staticmethod
    def below(model: str) -> RigPaths:
        """Return the default paths below a model."""
        root = f"{model}/Rig"
        return RigPaths(model, root, f"{root}/Skel", f"{root}/Anim", root)
