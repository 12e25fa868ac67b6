"""Scales of joints, which chains have no place for."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from animtool.errors import Fault, OptionError
from animtool.take import Take


def refuse_scales(
    take: Take, effectors: Iterable[tuple[str, str]], path: Path | None = None
) -> None:
    """Refuse scales of what an effector hangs from: a chain has lengths that stay.

    Args:
        take: Of a rig.
        effectors: Their names, and their joints.
        path: The targets file that asks for them, if there is one.

    Raises:
        OptionError: A joint is scaled, with a fault for each (TGT016).
    """
    channel = take.motion.scales
    if channel is None:
        return
    scaled = (channel.rest != 1.0).any(axis=1)
    scaled[channel.animated] |= (channel.values != 1.0).any(axis=(0, 2))
    faults = {}
    place = None if path is None else str(path)
    for effector, joint in effectors:
        j = take.rig.index(joint)
        while j >= 0:
            if scaled[j]:
                name = take.rig.names[j]
                message = f"{effector!r} hangs from {name!r}, which is scaled"
                hint = "inverse kinematics is for joints without scale"
                faults[name] = Fault("TGT016", message, place, (), hint)
            j = take.rig.joints[j].parent
    if faults:
        raise OptionError(list(faults.values()))
