"""How long ``animtool validate`` takes: one rig, many rigs, a long clip.

Whole processes, started fresh. The rigs are made here: joints with limits, controls
that drive some of them, and chains.
"""

from __future__ import annotations

import json
import sys
import tempfile
from pathlib import Path

from figures import Bound, Row, time_rows
from measuring import ROOT, begin, parser, run

MANY, LIMBS, BONES = 500, 6, 10
FRAMES = 20_000


def rig_text(number: int) -> str:
    """Return a rig of 60 joints, 8 controls and 4 chains."""
    joints = ["- {name: hips, type: free, translate: [0, 1, 0]}"]
    for limb in range(LIMBS):
        for bone in range(BONES - (limb == LIMBS - 1)):
            parent = f"l{limb}_{bone - 1}" if bone else "hips"
            kind = "type: ball, limits: {swing: [30, 60], twist: [-20, 20]}"
            if bone % 3 == 2:
                limits = f"limits: [-10, {90 + number % 7}]"
                kind = f"type: pin, axis: [1, 0, 0], {limits}"
            place = f"translate: [0.0{limb}, 0.1, 0.01]"
            name = f"l{limb}_{bone}"
            joints.append(f"- {{name: {name}, parent: {parent}, {place}, {kind}}}")
    controls = [
        f"- {{name: k{i}, range: [0, 1], drives: "
        f"[{{joint: l{i % LIMBS}_2.angle, expr: k{i} * 40}}]}}"
        for i in range(8)
    ]
    chains = [f"- {{name: ik{i}, root: l{i}_0, tip: l{i}_5}}" for i in range(4)]
    parts = ["rig: animtool/1", f"name: rig{number}", "joints:", *joints]
    return "\n".join([*parts, "controls:", *controls, "ik:", *chains, ""])


def clip_text() -> str:
    """Return a clip of many frames on the first rig."""
    keys = ", ".join(f"{{t: {t}, v: {t % 300 / 10:g}}}" for t in range(1, FRAMES, 150))
    head = f"clip: animtool/1\nrig: rig0.rig.yaml\nfps: 60\nrange: [1, {FRAMES}]\n"
    return f"{head}channels:\n- {{target: joint/l0_2.angle, keys: [{keys}]}}\n"


def timed(
    runs: int, section: str, tool: str, wanted: Bound | None, *arguments: object
) -> list[Row]:
    """Return how long the command takes on files without a finding."""
    command = [sys.executable, "-m", "animtool", "validate", *map(str, arguments)]
    taken = []
    for _ in range(runs):
        done = run([*command, "--format", "json"])
        if any(done.report["summary"].values()):
            raise SystemExit(json.dumps(done.report["findings"][:3], indent=1))
        taken.append(done.taken)
    return time_rows(section, tool, taken, wanted=wanted)


def main() -> None:
    """Measure, print and store."""
    options = parser(__doc__, "validate.csv", runs=7).parse_args()
    versions = sys.executable, ["animtool", "numpy", "pydantic", "PyYAML"]
    session = begin(options, versions)
    with tempfile.TemporaryDirectory() as folder:
        for i in range(MANY):
            (Path(folder) / f"rig{i}.rig.yaml").write_text(rig_text(i), "utf-8")
        clip = Path(folder) / "long.clip.yaml"
        clip.write_text(clip_text(), "utf-8")
        one, many = Path(folder) / "rig0.rig.yaml", f"{folder}/*.rig.yaml"
        biped = ROOT / "rigs/biped/biped.rig.yaml"
        some, few = max(1, options.runs // 3), "a process a rig"
        rows = [
            *timed(options.runs, few, "60 joints", Bound(False, 0.3), one),
            *timed(options.runs, few, "the biped", Bound(False, 0.3), biped),
            *timed(some, "500 rigs", "-j 1", None, many, "-j", 1),
            *timed(some, "500 rigs", "-j 2", Bound(False, 6.0), many, "-j", 2),
            *timed(some, "clip", f"{FRAMES} frames", None, clip),
        ]
    session.finish(options.csv, rows)


if __name__ == "__main__":
    main()
