"""Make ``takes/``, a dozen captures of people who wave, as they come from a studio.

Each begins and ends with the arm at rest, and between waves at a pace, a width and a
bend of its own: left-handed people in one folder, right-handed in another.

Lengths are centimetres, angles degrees, time is frames at 30 a second. The figure is a
trunk and one arm, Y up, towards +Z; the left is +X.

Usage: ``python make_takes.py [FOLDER]``; FOLDER is ``takes`` beside this file unless
given.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

FPS = 30
LEAD = 12  # [frame] to raise the arm, and to let it down
WAVING = 50  # [frame]
PACES = (17, 19, 20, 22, 23, 24)  # [frame] a wave there and back

RAISED = 65.0  # [deg] upper arm above level
HANGING = -78.0
BEND = 85.0  # [deg] elbow while waving
SIDES = {"left": 1.0, "right": -1.0}

HEADER = """HIERARCHY
ROOT hips
{{
  OFFSET 0 95 0
  CHANNELS 6 Xposition Yposition Zposition Zrotation Xrotation Yrotation
  JOINT chest
  {{
    OFFSET 0 30 0
    CHANNELS 3 Zrotation Xrotation Yrotation
    JOINT upper_arm
    {{
      OFFSET {shoulder:g} 18 0
      CHANNELS 3 Zrotation Xrotation Yrotation
      JOINT forearm
      {{
        OFFSET {arm:g} 0 0
        CHANNELS 3 Zrotation Xrotation Yrotation
        JOINT hand
        {{
          OFFSET {arm:g} 0 0
          CHANNELS 3 Zrotation Xrotation Yrotation
          End Site
          {{
            OFFSET {hand:g} 0 0
          }}
        }}
      }}
    }}
  }}
}}
"""


def raised(frames: Array) -> Array:
    """Return how far the arm is up, 0 to 1, over frames from 0."""
    last = 2 * LEAD + WAVING
    share = np.clip(np.minimum(frames, last - frames) / LEAD, 0, 1)
    return share * share * (3 - 2 * share)


def rows(side: float, pace: int, number: int) -> Array:
    """Return the channels of a take ``(F, 18)``.

    Args:
        side: 1 for the left hand, -1 for the right.
        pace: Frames of a wave there and back.
        number: Which of the takes of a side, from 0.
    """
    frames = np.arange(2 * LEAD + WAVING + 1.0)
    up = raised(frames)
    swing = np.sin(2 * np.pi * (frames - LEAD) / pace) * up
    late = np.sin(2 * np.pi * (frames - LEAD - 2) / pace) * up
    made = np.zeros((len(frames), 18))
    made[:, 0:3] = [0.0, 95.0, 0.0]
    made[:, 0] += side * swing * (0.4 + 0.1 * number)
    made[:, 3] = -side * swing * 1.5
    made[:, 6] = side * (up * -3.0 + swing * (1.0 + 0.2 * number))
    made[:, 9] = side * (HANGING + (RAISED - HANGING) * up * (1 - 0.04 * number))
    made[:, 12] = side * (8 + (BEND - 8 - 3 * number) * up + swing * (22 + 2 * number))
    made[:, 15] = side * late * (18 - number)
    return made


def text(side: float, made: Array) -> str:
    """Return a take as BVH."""
    header = HEADER.format(shoulder=18 * side, arm=27 * side, hand=17 * side)
    lines = [" ".join(f"{value + 0.0:.2f}" for value in row) for row in made]
    motion = [f"MOTION\nFrames: {len(lines)}\nFrame Time: {1 / FPS:.7f}", *lines, ""]
    return header + "\n".join(motion)


def main() -> None:
    """Write the takes."""
    parser = argparse.ArgumentParser(description="Make a dozen takes.")
    usual = Path(__file__).with_name("takes")
    parser.add_argument("folder", nargs="?", type=Path, default=usual)
    folder: Path = parser.parse_args().folder
    for name, side in SIDES.items():
        (folder / name).mkdir(parents=True, exist_ok=True)
        for number, pace in enumerate(PACES):
            path = folder / name / f"wave{number + 1}.bvh"
            made = text(side, rows(side, pace, number))
            path.write_text(made, "utf-8", newline="\n")


if __name__ == "__main__":
    main()
