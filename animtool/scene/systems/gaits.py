"""Clips as gaits of a rig, retargeted where the skeleton differs."""

from __future__ import annotations

from dataclasses import replace
from functools import cached_property
from pathlib import Path

import numpy as np

from animtool.core.errors import faults_in
from animtool.core.record import dataclass
from animtool.core.units import UpAxis, up_from_up
from animtool.motion.reorient import reorient, rotate_rig
from animtool.motion.take import Take
from animtool.retarget.motion import retarget_take
from animtool.retarget.pairing import map_joints
from animtool.rig.placed import at_origin
from animtool.rig.skeleton import Rig
from animtool.scene.sources.onto_rig import NameMap, map_names, open_rig
from animtool.scene.systems.character_motion import open_take
from animtool.systems.crowds.cycles import build_gaits
from animtool.systems.crowds.gaits import Gaits


@dataclass(frozen=True)
class GaitsSource:
    """Files of a rig and its gait clips."""

    rig: Path
    clips: tuple[Path, ...]

    def __call__(self) -> Gaits:
        """Return the clips as Y-up gaits; each file is read once."""
        return self._gaits

    @cached_property
    def _gaits(self) -> Gaits:
        """Read the clips and return them as Y-up gaits."""
        rig = at_origin(open_rig(self.rig)[0])
        rotation = up_from_up(UpAxis.Y, rig.up)
        if rotation is not None:
            rig = rotate_rig(rig, np.array(rotation), UpAxis.Y)
        return build_gaits(
            rig, [(clip_path.stem, _on_rig(clip_path, rig)) for clip_path in self.clips]
        )


def _on_rig(path: Path, rig: Rig) -> Take:
    """Return the take of a file on a rig, retargeted if the joints differ."""
    take = reorient(open_take(path), UpAxis.Y).collect()
    name_map = map_names(rig, take.rig)
    if _has_same_joints(rig, take.rig, name_map):
        return replace(take, rig=rig, motion=name_map.apply(take.motion), tracks=())
    with faults_in(path):
        return retarget_take(take, rig, map_joints(take.rig, rig)).take


def _has_same_joints(rig: Rig, other_rig: Rig, names: NameMap) -> bool:
    """Return whether another rig has all joints of a rig at equal positions."""
    if (names.joints < 0).any():
        return False
    differences = other_rig.rest_translations[names.joints] - rig.rest_translations
    return bool((abs(differences) < POSITION_TOLERANCE).all())


# Joint positions that differ by less are equal [m].
POSITION_TOLERANCE = 1e-4
