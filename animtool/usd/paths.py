"""Where the prims of a character are."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class RigPaths:
    """Where a character's prims are.

    Attributes:
        model: The component, ``/hero``.
        root: The SkelRoot, ``/hero/Rig``.
        skeleton: The Skeleton, ``/hero/Rig/Skel``.
        animation: The SkelAnimation, ``/hero/Rig/Anim``.
        binding: The prim that carries ``skel:animationSource``.
    """

    model: str
    root: str
    skeleton: str
    animation: str
    binding: str

    @staticmethod
    def below(model: str) -> RigPaths:
        """Return the usual paths below a model."""
        root = f"{model}/Rig"
        return RigPaths(model, root, f"{root}/Skel", f"{root}/Anim", root)
