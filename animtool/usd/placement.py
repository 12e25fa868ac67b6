"""Where a stage has its characters, and whether it is the shot that a path is of."""

from __future__ import annotations

from typing import Any

from pxr import Kind, Sdf, Usd, UsdSkel

from animtool.errors import Fault, OptionError, listed
from animtool.usd.rig_prims import find_skeletons

MAX_NAMED = 40


def character_paths(stage: Any) -> list[str]:
    """Return the prims that stand for the characters of a stage.

    Of each Skeleton that is the component it is part of, else its SkelRoot.
    """
    found = [_character(skeleton.GetPrim()) for skeleton in find_skeletons(stage)]
    return list(dict.fromkeys(found))


def _character(skeleton: Any) -> str:
    root = UsdSkel.Root.Find(skeleton)
    prim = top = root.GetPrim() if root else skeleton
    while prim and not prim.IsPseudoRoot():
        if Kind.Registry.IsA(Usd.ModelAPI(prim).GetKind(), Kind.Tokens.component):
            return str(prim.GetPath())
        prim = prim.GetParent()
    return str(top.GetPath())


def holds_character(stage: Any, prim_path: str, where: str) -> bool:
    """Return whether a stage has a character at a path, or is a rig to put there.

    A rig alone has one character, at the top, and nothing where the path begins: a
    shot will have it at the path. Any other stage is the shot itself, in which the
    path must be that of a character.

    Args:
        stage: The stage.
        prim_path: Where the character is, or will be.
        where: The file, for messages.

    Raises:
        OptionError: It is the shot, and the path is of no character in it (USD033).
    """
    if find_skeletons(stage, prim_path):
        return True
    characters = character_paths(stage)
    if not characters or _is_rig_alone(stage, prim_path, characters):
        return False
    there = listed(characters, MAX_NAMED)
    message = f"has no character at {prim_path}, but at {there}"
    hint = "only a file of one rig alone may be given a path that it lacks"
    raise OptionError(Fault("USD033", message, where, (), hint))


def _is_rig_alone(stage: Any, prim_path: str, characters: list[str]) -> bool:
    if stage.GetPrimAtPath(Sdf.Path(prim_path).GetPrefixes()[0]):
        return False
    if len(characters) > 1:
        return False
    prim = stage.GetPrimAtPath(characters[0])
    # A component further down is what a shot, or a set, refers to.
    below = Sdf.Path(characters[0]).pathElementCount > 1
    is_model = Kind.Registry.IsA(Usd.ModelAPI(prim).GetKind(), Kind.Tokens.component)
    return not (below and is_model)
