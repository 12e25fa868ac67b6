"""Hints for passes that precede the retarget whose rig they are for."""

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
    """Point out names of a pass that exist only after a later ``retarget``.

    Args:
        passes: All passes of the scene.
        entry: The pass that the block applies.
        folder: Folder of relative paths.
    """
    try:
        yield
    except (FormatError, OptionError) as error:
        rigs = list(_later_rigs(passes, entry, folder))
        faults = [_hinted(fault, entry, rigs) for fault in error.faults]
        raise type(error)(faults) from error


def _later_rigs(
    passes: Sequence[ScenePass], entry: ScenePass, folder: Path
) -> Iterator[Rig]:
    """Yield the rigs of later retargets; one that cannot be read reports itself."""
    for later in passes[passes.index(entry) + 1 :]:
        if later.pass_.name == "retarget" and later.options.rig is not None:
            try:
                yield open_rig(folder / later.options.rig)[0]
            except AnimtoolError:
                continue


def _hinted(fault: Fault, entry: ScenePass, rigs: Sequence[Rig]) -> Fault:
    """Return a fault about an unknown name, with the rig that has the name."""
    name = _FIRST_NAME.search(fault.message)
    for rig in rigs if name else ():
        parts = (rig.chains, rig.shapes, rig.controls, rig.attach)
        names = {*rig.names, *(part.name for group in parts for part in group)}
        if name and name[1] in names:
            hint = f"{rig.name!r} has it: move {entry.pass_.name} below retarget"
            return replace(fault, hint=hint)
    return fault
