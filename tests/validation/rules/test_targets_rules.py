"""Rules on targets by themselves, beyond the examples of their pages."""

from __future__ import annotations

from pathlib import Path

import pytest

from animtool.validation.run import validate

HEAD = "targets: animtool/1\nfps: 24\nrange: [1, 24]\ngoals:\n"
ARM = "- {effector: arm, position: [0, 0.5, 0.3]MORE}\n"
CASES: dict[str, tuple[str, list[str]]] = {
    "the same twice": (ARM + ARM, ["TGT202"]),
    "another priority": (ARM + ARM.replace("MORE", ", priority: 1"), []),
    "another offset": (ARM + ARM.replace("MORE", ", offset: [0, 0.1, 0]"), []),
    "another part": (
        ARM + "- {effector: arm, orientation: [1, 0, 0, 0]}\n",
        [],
    ),
    "two holds": (
        "- {effector: leg, hold: [[1, 8]]}\n- {effector: leg, hold: [[6, 12]]}\n",
        ["TGT202"],
    ),
    "frames that meet": (
        ARM.replace("MORE", ", during: [[1, 8]]")
        + ARM.replace("MORE", ", during: [[8, 12]]"),
        ["TGT202"],
    ),
    "a weight whose keys are all 0": (
        ARM.replace("MORE", ", weight: {position: {keys: [{t: 1, v: 0}]}}"),
        ["TGT203"],
    ),
    "a weight that fades": (
        ARM.replace(
            "MORE", ", weight: {position: {keys: [{t: 1, v: 0}, {t: 9, v: 1}]}}"
        ),
        [],
    ),
    "a hold behind the range": (
        "- {effector: leg, hold: [[1, 8], [30, 40]]}\n",
        ["TGT201"],
    ),
    "a hold that reaches beyond it": ("- {effector: leg, hold: [[20, 40]]}\n", []),
}


@pytest.mark.parametrize("name", CASES)
def test_targets(name: str, tmp_path: Path) -> None:
    text, wanted = CASES[name]
    path = tmp_path / "page.targets.yaml"
    path.write_text(HEAD + text.replace("MORE", ""), "utf-8")
    assert [fault.code for fault in validate(path)] == wanted


def test_what_is_outside_the_range_is_said_with_the_range(tmp_path: Path) -> None:
    path = tmp_path / "page.targets.yaml"
    text, _ = CASES["a hold behind the range"]
    path.write_text(HEAD + text, "utf-8")
    (fault,) = validate(path)
    assert "the range is 1 to 24" in fault.message
    assert "widen the range" in fault.hint
