"""Joints that options name, by name or by pattern."""

from __future__ import annotations

from collections.abc import Sequence
from fnmatch import fnmatchcase

from animtool.errors import Fault, OptionError, excerpt, listed
from animtool.rig.skeleton import Rig
from animtool.similar import similar


def joint_index(rig: Rig, name: str, option: str) -> int:
    """Return the index of a joint.

    Raises:
        OptionError: The rig has none of that name (SCN012).
    """
    if name not in rig.names:
        raise _unknown(rig, name, option)
    return rig.index(name)


def joints_matching(
    rig: Rig, patterns: str | Sequence[str], *, children: bool = False
) -> list[int]:
    """Return the joints that names or glob patterns choose, ascending.

    Args:
        rig: J joints.
        patterns: One or several, such as ``LeftArm`` or ``Left*``; letters must agree
            in case.
        children: Take everything below a chosen joint too.

    Raises:
        OptionError: A pattern matches no joint (SCN012).

    >>> from animtool.rig.skeleton import Joint
    >>> arm = Rig("arm", (Joint("a", -1), Joint("b", 0), Joint("c", -1)))
    >>> joints_matching(arm, ["a"], children=True)
    [0, 1]
    """
    chosen = [False] * len(rig.joints)
    for pattern in [patterns] if isinstance(patterns, str) else patterns:
        matches = [fnmatchcase(name, pattern) for name in rig.names]
        if not any(matches):
            raise _unknown(rig, pattern, "joints")
        chosen = [a or b for a, b in zip(chosen, matches, strict=True)]
    if children:
        for i, joint in enumerate(rig.joints):
            chosen[i] = chosen[i] or (joint.parent >= 0 and chosen[joint.parent])
    return [i for i, one in enumerate(chosen) if one]


def _unknown(rig: Rig, name: str, option: str) -> OptionError:
    near = similar(name, rig.names)
    message = f"{option}: no joint is {excerpt(name)}; there are {listed(rig.names)}"
    hint = f"did you mean {near}?" if near else None
    return OptionError(Fault("SCN012", message, hint=hint))
