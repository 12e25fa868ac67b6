"""Make ``rigs/``: the shipped biped as a child, as a giant, and with long arms.

Bones of the biped get other lengths; names, limits, axes and chains stay. Meshes,
controls and colliders, which have the biped's size, are left out.

Usage: ``python make_rigs.py [FOLDER]``; FOLDER is ``rigs`` beside this file unless
given.
"""

from __future__ import annotations

import argparse
import re
from pathlib import Path

BIPED = Path(__file__).parents[2] / "rigs/biped/biped.rig.yaml"

# Bones by the joint at their end: the first pattern that fits.
PARTS = {
    "leg": "knee|ankle",
    "foot": "toe",
    "breadth": "hip_|clavicle|shoulder",
    "arm": "elbow|forearm|wrist",
    "hand": "thumb|index|middle|ring|pinky",
    "head": "neck|head|jaw|eye",
    "trunk": "spine",
}
# Lengths over those of the biped.
RIGS = {
    "child": {
        **{"leg": 0.55, "foot": 0.62, "breadth": 0.66, "arm": 0.56, "hand": 0.6},
        **{"head": 0.84, "trunk": 0.66},
    },
    "giant": {
        **{"leg": 1.75, "foot": 1.7, "breadth": 2.0, "arm": 1.85, "hand": 1.9},
        **{"head": 1.35, "trunk": 1.8},
    },
    "long_armed": {
        **{"leg": 0.84, "foot": 1.0, "breadth": 1.1, "arm": 1.55, "hand": 1.25},
        **{"head": 1.0, "trunk": 1.05},
    },
}
LENGTHS = re.compile(r"(translate: |tips: \[)\[([^]]*)\]")


def scale_of(joint: str, scales: dict[str, float]) -> float:
    """Return what the bone to a joint is scaled by."""
    part = next(part for part, names in PARTS.items() if re.match(names, joint))
    return scales[part]


def scaled(line: str, scales: dict[str, float]) -> str:
    """Return the line of a joint with other lengths."""
    name = re.match(r"- \{name: (\w+)", line)
    if not name or name[1] == "hips":
        return line

    def other(match: re.Match[str]) -> str:
        scale = scale_of(name[1], scales)
        lengths = [float(value) * scale for value in match[2].split(",")]
        return f"{match[1]}[{', '.join(f'{v + 0.0:.6g}' for v in lengths)}]"

    return LENGTHS.sub(other, line)


def text(name: str, biped: str) -> str:
    """Return a rig file."""
    scales = RIGS[name]
    joints = biped[biped.index("joints:") : biped.index("meshes:")].rstrip()
    chains = biped[biped.index("ik:") : biped.index("attach:")].rstrip()
    lines = [scaled(line, scales) for line in joints.splitlines()]
    # Soles stay on the ground: what is below the hips, and the tip of the toe.
    below = "".join(
        line for line in lines if re.match(r"- \{name: (hip_|knee|ankle|toe)", line)
    )
    heights = [float(match[2].split(",")[1]) for match in LENGTHS.finditer(below)]
    placed = f"translate: [0, {-sum(heights):.6g}, 0]"
    lines = [
        re.sub(r"translate: \[[^]]*\]", placed, line)
        if "{name: hips," in line
        else line
        for line in lines
    ]
    return "\n".join(
        [
            "# rigs/biped with bones of other lengths. Made by make_rigs.py: change it",
            "# there.",
            "rig: animtool/1",
            f"name: {name}",
            "units: {length: m, angle: deg}",
            "up: Y",
            "",
            *lines,
            "",
            chains,
            "",
        ]
    )


def main() -> None:
    """Write the rigs."""
    parser = argparse.ArgumentParser(description="Make three rigs.")
    usual = Path(__file__).with_name("rigs")
    parser.add_argument("folder", nargs="?", type=Path, default=usual)
    folder: Path = parser.parse_args().folder
    folder.mkdir(parents=True, exist_ok=True)
    biped = BIPED.read_text("utf-8")
    for name in RIGS:
        path = folder / f"{name}.rig.yaml"
        path.write_text(text(name, biped), "utf-8", newline="\n")


if __name__ == "__main__":
    main()
