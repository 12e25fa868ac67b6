"""Make ``clips/``: someone who stands, and someone who is pushed.

Walk, run and turn are those of ``../retarget/takes``, and so is the skeleton.

Usage: ``python make_clips.py [FOLDER]``; FOLDER is ``clips`` beside this file unless
given.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

sys.path.append(str(Path(__file__).parents[1] / "retarget"))

from make_takes import SIDES, Tracks, bvh, keyed, standing

HERE = Path(__file__).parent


def stand() -> Tracks:
    """Return someone who shifts the weight, looks around and breathes."""
    times, tracks = standing(5.0)
    tracks["hips_x"] = 2.2 * np.sin(2 * np.pi * times / 5)
    tracks["hips_y"] -= 0.8 + 0.4 * np.cos(4 * np.pi * times / 5)
    tracks["lean"] = -1.5 * np.sin(2 * np.pi * times / 5)
    tracks["bend"] = 1.2 * np.sin(2 * np.pi * times / 2.5)
    tracks["look"] = 14 * np.sin(2 * np.pi * times / 5 + 0.6)
    for side in SIDES:
        tracks[f"elbow_{side}"] += 2 * np.sin(2 * np.pi * times / 2.5)
    return tracks


def stumble() -> Tracks:
    """Return someone who is pushed from behind, and keeps the balance."""
    times, tracks = standing(1.2)
    push = keyed(times, [(0.0, 0), (0.25, 1), (0.5, 0.7), (1.1, 0)])
    tracks["hips_z"] = 26 * push
    tracks["hips_y"] -= 7 * push
    tracks["hips_pitch"] = 14 * push
    tracks["bend"] = 22 * push
    tracks["nod"] = -16 * push
    tracks["twist"] = 12 * push
    for side in SIDES:
        tracks[f"lower_{side}"] -= 42 * push
        tracks[f"swing_{side}"] += 26 * push
        tracks[f"elbow_{side}"] += 34 * push
    return tracks


def main() -> None:
    """Write the clips."""
    folder = Path(sys.argv[1]) if len(sys.argv) > 1 else HERE / "clips"
    folder.mkdir(parents=True, exist_ok=True)
    for make in (stand, stumble):
        path = folder / f"{make.__name__}.bvh"
        path.write_text(bvh(make()), "utf-8", newline="\n")


if __name__ == "__main__":
    main()
