"""Live Link Face recordings: read onto a rig of their own."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

from animtool.core.errors import AnimtoolError
from animtool.formats.livelink.read import read_livelink
from fuzz.mutations import pick, spoil

ABOUT = "Live Link Face recordings (CSV), read with each way of dropped frames"
HEADER = "Timecode,BlendShapeCount,JawOpen,EyeBlinkLeft,HeadYaw,HeadPitch,HeadRoll"
LABELS = ("00:00:00:01.10", "00:00:00:02.10", "00:00:00:05.10", "00:00:01:00.10")


def make(folder: Path) -> Callable[[np.random.Generator], str]:
    """Return what runs a case in a folder."""
    path = folder / "take.csv"
    rows = [f"{label},61,.{i},.5,.1,-.2,.0{i}" for i, label in enumerate(LABELS)]
    text = "\n".join([HEADER, *rows, ""])
    seeds = [text.encode(), text.replace(",", "\t").encode(), text.encode("utf-16")]

    def run(rng: np.random.Generator) -> str:
        path.write_bytes(spoil(rng, pick(rng, seeds)))
        dropped = pick(rng, ["interpolate", "hold", "close"])
        try:
            stream = read_livelink(path, dropped=dropped)
            for block in stream.blocks:
                assert np.isfinite(block.rotations.values).all()
                assert np.isfinite(block.weights.values).all()
        except AnimtoolError as error:
            return error.code
        return "read"

    return run
