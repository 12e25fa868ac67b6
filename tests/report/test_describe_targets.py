"""What is said of targets files."""

from __future__ import annotations

from pathlib import Path

from animtool.core.values import plain_value
from animtool.report.describe_rig import describe_targets

TEXT = """\
targets: animtool/1
fps: 29.97
range: [1001, 1048]
goals:
- {effector: arm_l, position: [0.3, 1.1, 0.3], weight: 0.5}
- effector: leg_r
  orientation: [1, 0, 0, 0]
  hold: [[1003, 1010], [1020, 1020.5]]
- effector: head
  position: [0, 1, 0]
  aim: {axis: [0, 0, 1], at: [0, 1, 3]}
  weight: {position: 0, aim: 1}
"""


def test_parts_that_weigh_spans_and_frames_are_told(tmp_path: Path) -> None:
    path = tmp_path / "reach.targets.yaml"
    path.write_text(TEXT, "utf-8")
    found = describe_targets(path)
    assert (found.first, found.last) == (1001, 1048)
    assert found.fps.startswith("30000/1001")
    goals = [(goal.effector, goal.asks, goal.held) for goal in found.goals]
    assert goals == [
        ("arm_l", ("position",), ()),
        ("leg_r", ("orientation",), ((1003, 1010), (1020, 1020.5))),
        ("head", ("position", "aim"), ()),
    ]
    assert plain_value(found)["path"] == str(path)
