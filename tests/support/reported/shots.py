"""Checks of the shots of a batch."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import PurePath
from typing import Any

import numpy as np

from support.reported.outcome import Outcome, close, require
from support.reported.stages import skeleton_with

# Takes move 1 m a second along X: half of a frame is ten times as much [m].
TOLERANCE = 0.001
HIPS = "Hips"


def shot_list(outcome: Outcome, *, shots: Sequence[Mapping[str, Any]]) -> None:
    """Require these shots and no others, and which seconds of their takes they show."""
    require(shots, "no shot is given")
    paths = [PurePath(name) for name in outcome.files]
    stages = {
        path.stem: path
        for path in paths
        if path.suffix in {".usd", ".usda", ".usdc"}
        and not path.parts[0].startswith(".")
    }
    names = sorted(shot["shot"] for shot in shots)
    require(sorted(stages) == names, f"shots {sorted(stages)}, not {names}")
    for shot in shots:
        unknown = shot.keys() - {"shot", "frames", "fps", "first_s", "last_s"}
        require(not unknown, f"unknown keys {sorted(unknown)} of a shot")
        skeleton = skeleton_with(outcome.out / stages[shot["shot"]], HIPS)
        codes, fps = skeleton.clocked.codes, skeleton.clocked.fps
        label = shot["shot"]
        text = f"{label}: {len(codes)} frames at {fps:g} fps"
        whole = len(codes) == shot["frames"] and close(fps, shot["fps"], 1e-4)
        require(whole, f"{text}, not {shot['frames']} at {shot['fps']:g}")
        places = skeleton.world(codes[[0, -1]])[:, skeleton.index(HIPS), 0]
        wanted = np.array([shot["first_s"], shot["last_s"]], float)
        off = np.abs(places - wanted).max()
        text = f"{label}: seconds {np.round(places, 4).tolist()} of the take"
        require(off <= TOLERANCE, f"{text}, not {wanted.tolist()}")


CHECKS = {"shot_list": shot_list}
