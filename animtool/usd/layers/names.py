"""Legal, unique USD names for joints, and their original names."""

from __future__ import annotations

from collections.abc import Sequence

from pxr import Sdf

from animtool.core.errors import Fault, Severity, excerpt
from animtool.core.names import numbered_names
from animtool.core.record import dataclass
from animtool.rig.skeleton import Joint

# Variant set of a clip library, with one variant per take.
TAKE_SET = "take"


@dataclass(frozen=True, slots=True)
class UsdNames:
    """Names for the joints of a rig."""

    names: list[str]  # legal, unique names
    # Source names by legal name, if they differ.
    sources_by_legal_name: dict[str, str]
    notices: list[Fault]  # one warning per name that another already uses


def valid_text(name: str) -> str:
    r"""Return a text with invalid bytes replaced, so that USD accepts it.

    File names may contain such bytes.

    >>> valid_text("walk\udcff")
    'walk?'
    """
    return name.encode("utf-8", "replace").decode("utf-8")


def legal_name(name: str) -> str:
    """Return the name with every illegal character replaced by ``_``.

    >>> legal_name("rig:Arm.L"), legal_name("2nd")
    ('rig_Arm_L', '_2nd')
    """
    name = valid_text(name)
    if Sdf.Path.IsValidIdentifier(name):
        return name
    legal_text = "".join(
        c if Sdf.Path.IsValidIdentifier("a" + c) else "_" for c in name
    )
    return legal_text if Sdf.Path.IsValidIdentifier(legal_text) else "_" + legal_text


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
        # A name that the source already numbered is not a collision.
        [joint.source_name or joint.name for joint in joints],
    )


def distinct_names(
    original_names: Sequence[str], proposed_names: Sequence[str], sources: Sequence[str]
) -> UsdNames:
    """Return legal, unique names; numbers are appended to duplicates."""
    names: list[str] = []
    sources_by_legal_name: dict[str, str] = {}
    original_by_unique_name: dict[str, str] = {}
    notices: list[Fault] = []
    legal_names = list(map(legal_name, proposed_names))
    rows = zip(
        original_names, legal_names, numbered_names(legal_names), sources, strict=True
    )
    for name, legal, unique, source in rows:
        if unique != legal:
            notices.append(
                Fault(
                    "USD101",
                    f"{excerpt(original_by_unique_name[legal])} and {excerpt(name)} "
                    f"both become {excerpt(legal)} in USD; the second is written "
                    f"as {unique!r}",
                    severity=Severity.WARNING,
                )
            )
        original_by_unique_name[unique] = name
        names.append(unique)
        if unique != source:
            sources_by_legal_name[unique] = source
    return UsdNames(names, sources_by_legal_name, notices)


def replace_prefix(path: object, old: str, new: str) -> str:
    """Return a prim path with the path of an ancestor replaced.

    >>> replace_prefix("/hero/Rig/Skel", "/hero", "/World/hero")
    '/World/hero/Rig/Skel'
    """
    return str(Sdf.Path(path).ReplacePrefix(Sdf.Path(old), Sdf.Path(new)))


@dataclass(frozen=True, slots=True)
class RigPaths:
    """Prim paths of a character."""

    model: str  # the component, ``/hero``
    root: str  # the SkelRoot, ``/hero/Rig``
    skeleton: str  # the Skeleton, ``/hero/Rig/Skel``
    animation: str  # the SkelAnimation, ``/hero/Rig/Anim``
    binding: str  # the prim with ``skel:animationSource``

    @staticmethod
    def from_model(model: str) -> RigPaths:
        """Return the default paths below a model."""
        root = f"{model}/Rig"
        return RigPaths(model, root, f"{root}/Skel", f"{root}/Anim", root)

    def with_model(self, model: str) -> RigPaths:
        """Return the paths with the path of the model replaced."""
        paths = (self.model, self.root, self.skeleton, self.animation, self.binding)
        return RigPaths(*(replace_prefix(path, self.model, model) for path in paths))
