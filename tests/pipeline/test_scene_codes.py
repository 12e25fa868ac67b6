"""Every fault of scenes and passes, raised once by name."""

from __future__ import annotations

import re
import shutil
from collections.abc import Callable
from dataclasses import dataclass, replace
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support.faults import raises

import animtool
from animtool.core.clock import Clock
from animtool.core.errors import AnimtoolError, OptionError
from animtool.edit.root_motion import RootMode
from animtool.maths import so3
from animtool.motion.motion import Channel, Motion
from animtool.motion.passes import PassContext, apply_pass, find_pass
from animtool.motion.take import Take, TakeStream
from animtool.rig.parts import Shape
from animtool.rig.skeleton import Joint, Rig
from animtool.scene.file.read import load_scene

PACKAGE = Path(animtool.__file__).parent
NAN = float("nan")
OTHER = Path("other")
JOINTS = (Joint("hips", -1), Joint("arm_l", 0), Joint("arm_r", 0), Joint("tail", 0))


def swaying(count: int = 12, shapes: int = 1, names: str = "") -> Take:
    """Return four joints that move, with shape weights."""
    rng = np.random.default_rng(3)
    turns = so3.exp(np.cumsum(rng.normal(0, 0.1, (count, 4, 3)), axis=0))
    joints = tuple(replace(joint, name=names + joint.name) for joint in JOINTS)
    motion = Motion(
        Channel.from_dense(np.cumsum(rng.normal(0, 0.1, (count, 4, 3)), axis=0)),
        Channel.from_dense(so3.align_signs(turns)),
        weights=Channel.from_dense(np.zeros((count, shapes, 1))),
    )
    clock = Clock(Fraction(30), Fraction(1), Fraction(1), count)
    parts = tuple(Shape(f"shape{i}") for i in range(shapes))
    return Take(Rig("swaying", joints, shapes=parts), clock, motion)


def crouched(scale: tuple[float, float, float]) -> Take:
    """Return the take with a scale on its hips."""
    take = swaying()
    scales = np.ones((12, 4, 3))
    scales[:, 0] = scale
    scaled = replace(take.motion, scales=Channel.from_dense(scales))
    return replace(take, motion=scaled)


@dataclass(frozen=True)
class Case:
    """A pass and options that it refuses, or has something to say of."""

    code: str
    name: str
    options: dict[str, Any]
    take: Callable[[], Take] = swaying
    other: Callable[[], Take] = swaying


CASES = {
    "a joint that is not": Case(
        "SCN012", "layer", {"take": OTHER, "joints": ("leg*",)}
    ),
    "pairs of no joint": Case("SCN012", "mirror", {"pairs": (("hips", "leg"),)}),
    "hips that are not": Case("SCN012", "root_motion", {"hips": "pelvis"}),
    "a root that is not": Case("SCN012", "root_motion", {"mode": RootMode.RECOMPOSE}),
    "trimmed to nothing": Case("SCN013", "trim", {"first": 50}),
    "a range reversed": Case("SCN013", "trim", {"first": 5, "last": 4}),
    "no frame": Case("SCN013", "trim", {"first": NAN}),
    "a base frame outside": Case("SCN013", "difference", {"frame": 99.0}),
    "a cycle outside": Case("SCN013", "loop", {"last": 99.0}),
    "a search outside": Case("SCN013", "loop", {"find": True, "first": 0.0}),
    "time beyond the take": Case("SCN013", "time_warp", {"curve": ((1, 1), (2, 99))}),
    "a curve between frames": Case(
        "SCN013", "time_warp", {"curve": ((1.2, 1), (1.4, 2))}
    ),
    "faster than the grid": Case("SCN013", "time_scale", {"speed": 1e9, "pivot": 1.5}),
    "a weight of none": Case("SCN014", "layer", {"take": OTHER, "weight": NAN}),
    "a weight too large": Case("SCN014", "layer", {"take": OTHER, "weight": 1.5}),
    "a blend too large": Case("SCN014", "blend", {"take": OTHER, "weight": -0.1}),
    "times that fall": Case("SCN015", "time_warp", {"curve": ((3, 1), (2, 1))}),
    "times that meet": Case(
        "SCN015", "blend", {"take": OTHER, "weight": ((1, 0), (1, 1))}
    ),
    "a key of none": Case("SCN015", "blend", {"take": OTHER, "weight": ((1, NAN),)}),
    "no pairs": Case("SCN015", "blend", {"take": OTHER, "weight": (1, 2)}),
    "pairs of texts": Case("SCN015", "blend", {"take": OTHER, "weight": (("a", "b"),)}),
    "no speed": Case("SCN016", "time_scale", {"speed": 0.0}),
    "a speed of none": Case("SCN016", "time_scale", {"speed": NAN}),
    "rigs of other names": Case(
        "SCN017", "blend", {"take": OTHER}, other=lambda: swaying(names="b_")
    ),
    "rigs of other shapes": Case(
        "SCN017", "layer", {"take": OTHER}, other=lambda: swaying(shapes=2)
    ),
    "a base of another rig": Case(
        "SCN017", "difference", {"base": OTHER}, other=lambda: swaying(names="b_")
    ),
    "no repeat": Case("SCN018", "loop", {"repeats": 0}),
    "no cycle": Case("SCN018", "loop", {"first": 5.0, "last": 5.0}),
    "no blend": Case("SCN018", "loop", {"blend": -1}),
    "a blend of none": Case("SCN018", "loop", {"blend": NAN}),
    "no cycle so long": Case("SCN018", "loop", {"find": True, "shortest": 9.0}),
    "no length": Case("SCN018", "loop", {"find": True, "longest": -1.0}),
    "no pair": Case("SCN019", "mirror", {"pairs": (("arm_l",),)}),
    "partners apart": Case("SCN019", "mirror", {"pairs": (("hips", "tail"),)}),
    "no axes": Case("SCN020", "root_motion", {"axes": "up"}),
    "a root beside the hips": Case(
        "SCN020", "root_motion", {"root": "arm_l", "hips": "arm_r"}
    ),
    "a root with nothing below": Case(
        "SCN020", "root_motion", {"mode": RootMode.RECOMPOSE, "root": "tail"}
    ),
    "a root that shears": Case(
        "SCN020",
        "root_motion",
        {"root": "hips", "mode": RootMode.RECOMPOSE},
        lambda: crouched((1, 2, 1)),
    ),
    "a root of no size": Case(
        "SCN020",
        "root_motion",
        {"root": "hips", "mode": RootMode.RECOMPOSE},
        lambda: crouched((0, 0, 0)),
    ),
    "too slow": Case("SCN021", "time_scale", {"speed": 1e-9}),
    "too long": Case("SCN021", "time_warp", {"curve": ((1, 1), (1e9, 2))}),
    "too often": Case("SCN021", "loop", {"repeats": 10**7}),
    "too late": Case("SCN021", "blend", {"take": OTHER, "delay": 1e9}),
    "too fine": Case("SCN021", "resample", {"fps": 1e5}, lambda: swaying(4000)),
    "no rate": Case("SCN022", "resample", {"fps": "fast"}),
    "a base of no size": Case(
        "SCN023", "difference", {"base": OTHER}, other=lambda: crouched((1, 1, 0))
    ),
    "no other take": Case("SCN024", "layer", {}),
    "no such mode": Case("SCN025", "layer", {"take": OTHER, "mode": "foo"}),
    "a poor seam": Case("SCN101", "loop", {}),
    "a cycle found": Case("SCN102", "loop", {"find": True}),
}


def said(case: Case) -> list[str]:
    """Return the codes of what a pass raises or says."""
    context = PassContext(lambda _: case.other(), Path())
    found = find_pass(case.name)
    try:
        options = found.options(**case.options)
        apply_pass(TakeStream.of(case.take()), found, options, context).collect()
    except AnimtoolError as error:
        return [fault.code for fault in error.faults]
    return [notice.code for notice in context.notices]


@pytest.mark.parametrize("name", CASES)
def test_a_pass_refuses(name: str) -> None:
    assert CASES[name].code in said(CASES[name])


def test_the_joint_whose_scale_is_0_is_named() -> None:
    case = CASES["a base of no size"]
    scales = np.ones((12, 4, 3))
    scales[5, 2, 1] = 0
    motion = replace(swaying().motion, scales=Channel.from_dense(scales))
    base = replace(swaying(), motion=motion)
    context = PassContext(lambda _: base, Path())
    found = find_pass(case.name)
    stream = TakeStream.of(swaying())
    with raises(OptionError, "SCN023", match="'arm_r'.*0"):
        apply_pass(stream, found, found.options(base=OTHER), context)


SCENE = "scene: animtool/1\nsource: {file: walk.bvh}\n"
SCENES = {
    "an option that is not": ("SCN001", "passes: [{trim: {frist: 5}}]"),
    "an option of another kind": ("SCN002", "passes: [{trim: {last: [x]}}]"),
    "a range that is reversed": ("SCN003", "range: [9, 1]"),
    "a rate that is none": ("SCN022", "fps: fast"),
    "a file outside the project": ("DOC014", "output: {file: ../../out.usda}"),
    "a take outside the project": ("DOC014", "passes: [{blend: {take: ../../a.bvh}}]"),
    "a file that is not there": ("DOC015", "passes: [{layer: {take: no.bvh}}]"),
    "no such pass": ("SCN010", "passes: [{trm: }]"),
    "a plug-in that breaks": ("IO003", "passes: [{broken: }]"),
    "a plug-in that is no pass": ("IO003", "passes: [{number: }]"),
    "a variable of no value": ("SCN030", "fps: ${rate}"),
    "a variable of no name": ("SCN032", "fps: ${}"),
    "a range beside a shot": ("SCN041", "range: [1, 9]\nshot: {cut: [1, 9]}"),
    "a setting of USD": ("SCN039", "output: {file: a.bvh, bones: true}"),
    "a system of an output": ("SCN063", "output: {file: a.usda, systems: [flag]}"),
    "a time code for one source": ("SCN038", "source: {file: walk.bvh, timecode: x}"),
}
# Of commands, and of scenes that several files make: their own tests raise these.
ELSEWHERE = {
    "SCN031",
    *(f"SCN{n:03d}" for n in range(33, 38)),
    *("OUT007", "SCN042", "SCN043", "SCN044", "SCN103", "SCN104", "SCN105", "SCN106"),
    # Those of tests/test_passthrough.py, test_beside.py, test_library_output.py,
    # cli/test_suspicious_input.py and edit/test_retiming.py.
    *(f"SCN{n:03d}" for n in (*range(45, 53), *range(107, 123))),
    # Those of tests/scene/test_systems.py.
    *(f"SCN{n:03d}" for n in (60, 61, 62, 65)),
    # Those of tests/scene/systems/test_with_take.py.
    *("SCN066", "SCN067", "SCN068"),
    # Those of tests/scene/systems/test_run.py and tests/scene/test_bounds.py.
    *("SCN090", "SCN091"),
    # Those of tests/cli/test_simulation_table.py.
    *("SCN071", "SCN072"),
    # Those of tests/pipeline/test_cut_list.py and tests/scene/test_shot.py.
    *("SCN073", "SCN074"),
    # That of tests/scene/systems/test_chosen.py.
    "SCN081",
    # Those of tests/edit/test_mirror.py.
    *("SCN082", "SCN083"),
}


class Plugin:
    """An entry point that breaks when it is loaded, or that is no pass."""

    def __init__(self, name: str) -> None:
        self.name, self.value = name, f"studio:{name}"

    def load(self) -> object:
        if self.name == "broken":
            raise ImportError("no module named studio")
        return 1


@pytest.mark.parametrize("name", SCENES)
def test_a_scene_is_refused(
    name: str, walk: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("animtool.core.plugins.may_have_plugins", lambda _: True)
    monkeypatch.setattr(
        "importlib.metadata.entry_points",
        lambda **_: [Plugin("broken"), Plugin("number")],
    )
    shutil.copy(walk, tmp_path / "walk.bvh")
    code, line = SCENES[name]
    path = tmp_path / "shot.scene.yaml"
    head = SCENE.splitlines()[0] + "\n" if line.startswith("source") else SCENE
    path.write_text(f"{head}{line}\n", "utf-8")
    with pytest.raises(AnimtoolError) as error:
        load_scene(path)
    assert code in [fault.code for fault in error.value.faults]


def test_no_code_is_left_out() -> None:
    text = "".join(path.read_text("utf-8") for path in PACKAGE.rglob("*.py"))
    # From 201 they are what validate looks for: tests/validation raises these.
    spoken = set(re.findall(r"SCN[01]\d{2}", text))
    raised = {case.code for case in CASES.values()} | {c for c, _ in SCENES.values()}
    assert {c for c in raised | ELSEWHERE if c.startswith("SCN")} == spoken
