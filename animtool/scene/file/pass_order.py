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
    passes: Sequence[ScenePass], entry: ScenePass, folder: Path
) -> Iterator[None]:
    """In a block, add a hint to faults about names that only a later pass provides.

    The block applies the pass ``entry``. Paths are relative to ``folder``.
    """
    try:
        yield
    except (FormatError, OptionError) as error:
        rigs = list(_later_rigs(passes, entry, folder))
        faults = [_with_move_hint(fault, entry, rigs) for fault in error.faults]
        raise type(error)(faults) from error


def _later_rigs(
    passes: Sequence[ScenePass], entry: ScenePass, folder: Path
) -> Iterator[Rig]:
    """Yield the rigs of later retarget passes; skip rigs that cannot be read."""
    for later_pass in passes[passes.index(entry) + 1 :]:
        if later_pass.pass_.name == "retarget" and later_pass.options.rig is not None:
            try:
                yield open_rig(folder / later_pass.options.rig)[0]
            except AnimtoolError:
                continue


def _with_move_hint(fault: Fault, entry: ScenePass, rigs: Sequence[Rig]) -> Fault:
    """Return a fault with a hint at the first rig that has the unknown name."""
    name = _FIRST_NAME.search(fault.message)
    for rig in rigs:
        groups = (rig.chains, rig.shapes, rig.controls, rig.attach)
        names = {*rig.names, *(element.name for group in groups for element in group)}
        if name and name[1] in names:
            hint = f"{rig.name!r} has it: move {entry.pass_.name} below retarget"
            return replace(fault, hint=hint)
    return fault
