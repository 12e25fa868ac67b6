"""OpenSim motion files: read onto a rig, and onto one of their own."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

from animtool.core.clock import Clock
from animtool.core.errors import AnimtoolError
from animtool.formats.mot.read import read_mot
from animtool.formats.mot.write import build_mot_text
from animtool.formats.take_text import write_text
from animtool.motion.motion import Channel, Motion
from animtool.motion.take import Take
from animtool.rig.skeleton import Joint, JointType, Rig
from animtool.rig.write import rig_text
from fuzz.mutations import pick, spoil

ABOUT = "OpenSim motion files (MOT), read with and without a rig"

RIG = Rig(
    "leg",
    (
        Joint("hips", -1, JointType.FREE, (0, 1, 0)),
        Joint("hip", 0, JointType.BALL, (0.1, 0, 0)),
        Joint("knee", 1, JointType.PIN, (0, -0.4, 0), axis=(1.0, 0.0, 0.0)),
        Joint("lift", 2, JointType.PRISMATIC, axis=(0.0, 1.0, 0.0)),
    ),
)
# Uneven times, a gap, and columns that no rig has.
UNEVEN = (
    "Coordinates\nversion=1\nnRows=4\nnColumns=4\ninDegrees=yes\nendheader\n"
    "time\tknee\tlift\tother\n0\t10\t.1\t1\n0.01\tNaN\t.2\t1\n0.035\t30\t.3\t1\n"
    "0.04\t40\t.4\t1\n"
)
# Cells of several numbers, which no take is made of.
VECTORS = (
    "DataRate=100\nDataType=Vec3\nversion=3\nendheader\ntime\ta\tb\n"
    "0\t0,0,3\t1,2,3\n0.01\t1,2,3\t1,2,3\n0.02\t2,4,3\tnan,nan,nan\n"
)


def make(folder: Path) -> Callable[[np.random.Generator], str]:
    """Return what runs a case in a folder."""
    path, rig = folder / "take.mot", folder / "leg.rig.yaml"
    rig.write_text(rig_text(RIG), "utf-8")
    still = Motion(
        Channel.static(RIG.rest_translations, 4), Channel.static(RIG.rest_rotations, 4)
    )
    take = Take(RIG, Clock(100, 1, 1, 4), still)
    write_text(take, path, build_mot_text, overwrite=False)
    semicolons = UNEVEN.replace("\t", ";")
    texts = [UNEVEN, semicolons, semicolons.replace(".", ","), VECTORS]
    seeds = [path.read_bytes(), *[text.encode() for text in texts]]

    def run(rng: np.random.Generator) -> str:
        path.write_bytes(spoil(rng, pick(rng, seeds)))
        try:
            stream = read_mot(path, rig=rig if rng.integers(2) else None)
            for block in stream.blocks:
                assert np.isfinite(block.translations.values).all()
                assert np.isfinite(block.rotations.values).all()
        except AnimtoolError as error:
            return error.code
        return "read"

    return run
