"""Files of many values or many faults: work grows with them, and no faster."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path

import pytest
from support.suite import some_quick

from animtool.core.errors import AnimtoolError
from animtool.core.names import most_similar, numbered_names
from animtool.core.source_lines import crop_line
from animtool.documents.document import read_document
from animtool.documents.yaml_values import MAX_SEPARATORS
from animtool.formats.bvh.read import read_bvh
from animtool.ik.file import load_targets
from animtool.rig.file import load_rig
from animtool.scene.file.read import load_scene

RIG = "rig: animtool/1\nname: a\njoints:\n"
PIN = RIG + "- {name: p, type: pin, axis: [1, 0, 0]}\ncontrols:\n"
# Of each, what quadratic work took minutes for; all take less than 0.3 s.
CASES: dict[str, tuple[str, str, str]] = {
    "unknown keys": (
        "a.rig.yaml",
        RIG + "- {name: a, " + ", ".join(f"key{i}: 1" for i in range(2000)) + "}\n",
        "DOC020",
    ),
    "faulty entries": ("a.rig.yaml", RIG + "- {nam: a, typ: pin}\n" * 2000, "DOC020"),
    "unknown parents": (
        "a.rig.yaml",
        RIG
        + "".join(
            f"- {{name: joint_{i}, type: fixed, parent: jnt_{i}}}\n"
            for i in range(2000)
        ),
        "RIG002",
    ),
    "parents in a ring": (
        "a.rig.yaml",
        RIG
        + "".join(
            f"- {{name: j{i}, type: fixed, parent: j{(i + 1) % 2000}}}\n"
            for i in range(2000)
        ),
        "RIG003",
    ),
    "controls in a ring": (
        "a.rig.yaml",
        PIN
        + "".join(
            f"- {{name: c{i}, drives: [{{control: c{(i + 1) % 1000}, expr: c{i}}}]}}\n"
            for i in range(1000)
        ),
        "RIG014",
    ),
    "unknown controls": (
        "a.rig.yaml",
        PIN
        + "".join(
            f"- {{name: c{i}, drives: [{{joint: p.angle, expr: d{i}}}]}}\n"
            for i in range(1000)
        ),
        "RIG012",
    ),
    "anchors": ("a.rig.yaml", "x: [" + "&a 1, " * 10000 + "1]\n", "DOC002"),
    "one line": (
        "a.rig.json",
        '{"rig": "animtool/1", "name": "a", "joints": ['
        + ", ".join(f'{{"name": "j{i}", "type": "pinn"}}' for i in range(2000))
        + "]}",
        "DOC022",
    ),
    "goals": (
        "a.targets.yaml",
        "targets: animtool/1\nfps: 24\ngoals:\n"
        + "- {effector: a, position: [0, 0, 0]}\n" * 2000,
        "DOC022",
    ),
    "doubling variables": (
        "a.scene.yaml",
        "scene: animtool/1\nvariables:\n  a0: x\n"
        + "".join(f"  a{i + 1}: ${{a{i}}}${{a{i}}}\n" for i in range(60))
        + "source: {file: '${a60}'}\n",
        "DOC025",
    ),
    "long key": ("a.rig.yaml", f"? {'k' * 100_000}\n: 1\n", "DOC025"),
    "long name": (
        "a.rig.yaml",
        RIG + f"- {{name: {'n' * 100_000}, type: fixed}}\n",
        "DOC022",
    ),
    "values": ("a.rig.yaml", "x: [" + "1," * (MAX_SEPARATORS + 1) + "]", "DOC024"),
    "lines": ("a.bvh", "\n" * 1_000_001, "BVH013"),
}
LOADERS: dict[str, Callable[[Path], object]] = {
    "rig": load_rig,
    "targets": load_targets,
    "scene": lambda path: load_scene(path, {}),
    "": read_bvh,
}


@pytest.mark.parametrize("name", some_quick(CASES, 3))
def test_faults_are_bounded_in_number_length_and_time(
    tmp_path: Path, name: str
) -> None:
    file, text, code = CASES[name]
    path = tmp_path / file
    path.write_text(text)
    began = time.process_time()
    with pytest.raises(AnimtoolError) as caught:
        LOADERS[file.split(".")[1] if file.count(".") == 2 else ""](path)
    # A hundredth of what they took: this is no measure, and holds on a busy machine.
    assert time.process_time() - began < 5
    assert code in {fault.code for fault in caught.value.faults}
    assert len(caught.value.faults) <= 101
    assert max(len(str(fault)) for fault in caught.value.faults) < 5000


@pytest.mark.slow
def test_real_sizes_are_read(tmp_path: Path) -> None:
    path = tmp_path / "a.clip.yaml"
    keys = "- {t: 1, v: 1, interp: bezier, in: [-1, 0], out: [1, 0]}\n" * 10_000
    path.write_text(f"clip: animtool/1\nkeys:\n{keys}")
    assert len(read_document(path).value["keys"]) == 10_000
    marks = sum(map(keys.count, ("\n", ",", ":", "[", "{", "- ", "? ")))
    assert 10 * marks < MAX_SEPARATORS


def test_the_nearest_of_many_names() -> None:
    names = [f"joint_{i:04}" for i in range(2000)]
    assert most_similar("jiont_1234", names) == "joint_1234"
    assert most_similar("x" * 1000, names) is None


def test_names_in_a_row_are_distinct() -> None:
    made = numbered_names(["a"] * 20_000)
    assert (made[0], made[-1], len(set(made))) == ("a", "a_20000", 20_000)


def test_the_line_of_a_finding_is_cut_before_it_is_looked_at() -> None:
    shown, caret = crop_line("x" * 10_000_000, 5_000_000)
    assert (len(shown), caret.index("^")) == (96, 32)
