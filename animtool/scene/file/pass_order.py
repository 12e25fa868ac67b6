"""Hints for passes that use a name of a rig to which only a later pass retargets."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

from animtool.core.errors import AnimtoolError, Fault, FormatError, OptionError
from animtool.rig.skeleton import Rig
from animtool.scene.file.entries import ScenePass
from animtool.scene.sources.onto_rig import open_rig

_FIRST_NAME = re.compile(r"'([^']+)'")


@contextmanager
def with_order_hints(
    passes: Sequence[ScenePass], scene_pass: ScenePass, folder: Path
) -> Iterator[None]:
    """Add a hint to faults in a block about names that a later pass provides.

    The block applies the pass ``entry``. Paths are relative to ``folder``.
    """
    try:
        yield
    except (FormatError, OptionError) as error:
        rigs = list(_later_rigs(passes, scene_pass, folder))
        faults = [_with_move_hint(fault, scene_pass, rigs) for fault in error.faults]
        raise type(error)(faults) from error


def _later_rigs(
    passes: Sequence[ScenePass], scene_pass: ScenePass, folder: Path
) -> Iterator[Rig]:
    """Yield the rigs of later retarget passes; skip rigs that cannot be read."""
    for later_pass in passes[passes.index(scene_pass) + 1 :]:
        if later_pass.pass_.name == "retarget" and later_pass.options.rig is not None:
            try:
                yield open_rig(folder / later_pass.options.rig)[0]
            except AnimtoolError:
                continue


def _with_move_hint(fault: Fault, scene_pass: ScenePass, rigs: Sequence[Rig]) -> Fault:
    """Return a fault with a hint at the first rig that has the unknown name."""
    name_match = _FIRST_NAME.search(fault.message)
    for rig in rigs:
        named_elements = (rig.chains, rig.shapes, rig.controls, rig.attach)
        names = {
            *rig.names,
            *(element.name for group in named_elements for element in group),
        }
        if name_match and name_match[1] in names:
            hint = f"{rig.name!r} has it: move {scene_pass.pass_.name} below retarget"
            return replace(fault, hint=hint)
    return fault
