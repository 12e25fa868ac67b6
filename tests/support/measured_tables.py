"""The table of measured ratios in ``docs/explanation/accuracy-and-speed.md``.

``PYTHONPATH=tests python tests/support/measured_tables.py`` writes it anew from the
results of the benchmarks.
"""

from __future__ import annotations

import csv
import re
from pathlib import Path

from animtool.core.record import dataclass

ROOT = Path(__file__).parents[2]
PAGE = ROOT / "animtool/docs/explanation/accuracy-and-speed.md"
REPORT_MODELS = ROOT / "tests/bench/results"
_MARK = re.compile(r"(<!-- measured -->\n)(?:\n(?:\|.*\n)+)?")


@dataclass(frozen=True, slots=True)
class Ratio:
    """A row: what is done, beside what, and where its ratio was measured."""

    what: str
    other: str
    file: str
    section: str
    tool: str
    measure: str


_WALL, _CPU = "wall / animtool [x]", "CPU / animtool [x]"
_CALL = "all channels and frames, one call"
_KINEMATICS = "60 joints, 10000 frames, one call"
_WALK = "cloud_walk, 960 frames, as observed"
_SHEET = "sheet of 20 x 20, one second"
RATIOS = (
    Ratio("BVH of 144 MB to USD", "Blender", "bvh_to_usd", "long", "Blender", _WALL),
    Ratio("the same, joints alone", "pybvh", "bvh_to_usd", "long", "pybvh", _WALL),
    Ratio("curves, all in one call", "USD's Ts", "curves", _CALL, "Ts, Spline.Eval",
          _WALL),
    Ratio("one value a call", "USD's Ts", "curves", "a call a value", "Ts, Spline.Eval",
          _WALL),
    Ratio("joints in the world", "UsdSkel", "kinematics", _KINEMATICS,
          "UsdSkel, ComputeJointSkelTransforms", _WALL),
    Ratio("skin and shapes", "UsdSkel", "deform", "broad shapes, one call",
          "UsdSkel, ComputeDeformedPoints", _WALL),
    Ratio("IK of an arm, many at once", "TRAC-IK", "ik", "iiwa14, far start", "TRAC-IK",
          _WALL),
    Ratio("IK of an arm, a call each", "roboticstoolbox", "ik", "iiwa14, far start",
          "roboticstoolbox", "wall / animtool, a call each [x]"),
    Ratio("retargeting with feet held", "mink", "retarget",
          "ret_a.source onto biped, 360 frames", "mink", _WALL),
    Ratio("markers to joints", "OpenSim", "mocap_solve", _WALK, "OpenSim IK tool",
          _CPU),
    Ratio("a sheet of springs", "a plain C++ loop", "sim_springs", _SHEET,
          "plain C++ loop, 3408/s", _WALL),
    Ratio("a sheet of springs", "Taichi", "sim_springs", _SHEET,
          "taichi, fused, serial, 3408/s", _WALL),
    Ratio("1000 boxes that fall", "MuJoCo", "rigid", "1000 boxes, 3 s", "MuJoCo", _CPU),
    Ratio("1000 agents in a crowd", "JuPedSim", "crowds", "1000 agents, 20 s",
          "jupedsim", _WALL),
    Ratio("gravity of 100,000 bodies", "pytreegrav", "particles_nbody", "100000 bodies",
          "the fastest peer at 0.0002 (pytreegrav, quadrupoles)", _WALL),
)  # fmt: skip


def results_of(file: str) -> list[dict[str, str]]:
    """Return the rows of a benchmark's results."""
    text = (REPORT_MODELS / f"{file}.csv").read_text("utf-8")
    return list(csv.DictReader(x for x in text.splitlines() if x[:1] != "#"))


def is_older_form(file: str) -> bool:
    """Return whether results were written by an earlier form of their benchmark."""
    lines = (REPORT_MODELS / f"{file}.csv").read_text("utf-8").splitlines()
    return any("older form" in line for line in lines if line[:1] == "#")


def measured(ratio: Ratio) -> str:
    """Return how many times as long the other takes, with two digits."""
    key = {"section": ratio.section, "tool": ratio.tool, "measure": ratio.measure}
    (row,) = [each for each in results_of(ratio.file) if key.items() <= each.items()]
    loaded = ", under load" if row.get("load") == "under load" else ""
    older = ", older form" if is_older_form(ratio.file) else ""
    return f"{float(row['median']):.2g}{loaded}{older}"


def table() -> str:
    """Return the table, as Markdown."""
    lines = [
        "| task | compared with | times as long | measured |",
        "|---|---|---|---|",
    ]
    for ratio in RATIOS:
        link = f"[{ratio.file}](../../../tests/bench/results/{ratio.file}.csv)"
        lines.append(f"| {ratio.what} | {ratio.other} | {measured(ratio)} | {link} |")
    return "\n".join(lines) + "\n"


def renewed(text: str) -> str:
    """Return the page with the table as it is measured."""
    return _MARK.sub(lambda found: f"{found[1]}\n{table()}", text)


if __name__ == "__main__":
    PAGE.write_text(renewed(PAGE.read_text("utf-8")), "utf-8")
