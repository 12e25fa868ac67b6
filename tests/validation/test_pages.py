"""The pages of codes: each is there, and its examples are what it says."""

from __future__ import annotations

import re
import shlex
from collections.abc import Set
from pathlib import Path

import numpy as np
import pytest
import yaml
from support.cli import animtool
from support.page_stage import CAPTURE, HOPS, make_stage
from support.suite import some_quick

import animtool as animtool_package
from animtool.core.errors import AnimtoolError
from animtool.core.rules import builtin_rules, page_text
from animtool.validation.run import validate

HEADINGS = ["What", "Why", "How to fix"]
PAGES = {code: page_text(code) or "" for code in builtin_rules()}
# What the wrong example of a page has beside its own code: what is no longer hidden,
# what comes of it, and what says the same before there is a rig.
FOUND_TOO = {
    "CLIP205": {"CLIP101"},
    "IK101": {"TGT205"},
    "RIG219": {"RIG221"},
    "SIM168": {"SIM200"},
    "TGT104": {"TGT201", "TGT207"},
    "TGT205": {"IK101"},
    "TGT206": {"IK101", "TGT205"},
    "VAL002": {"RIG201"},
}


def examples(code: str, language: str) -> list[str]:
    return re.findall(rf"^```{language}\n(.*?)^```", PAGES[code], re.M | re.S)


def test_the_front_of_every_page_is_yaml_and_the_rule(root: Path) -> None:
    for path in (root / "animtool/docs/rules").iterdir():
        front = yaml.safe_load(path.read_text("utf-8").split("---\n")[1])
        rule = builtin_rules()[path.stem]
        kinds = front.pop("kind", [])
        assert rule.kinds == ({kinds} if isinstance(kinds, str) else set(kinds))
        front["replaces"] = tuple(front.get("replaces", ()))
        for name, value in front.items():
            assert getattr(rule, name) == value, path


def test_the_form_of_pages() -> None:
    for code, page in PAGES.items():
        lines = page.splitlines()
        assert lines[0] == f"# {code}: {builtin_rules()[code].title}"
        headings = [line[3:] for line in lines if line.startswith("## ")]
        assert headings in (HEADINGS, [*HEADINGS, "Example"]), code
        outside = re.sub(r"^```.*?^```", "", page, flags=re.M | re.S)
        assert max(map(len, outside.splitlines()[1:])) <= 88, code


KINDS = "batch|cameras|rig|clip|map|markers|scene|targets"


@pytest.fixture
def stage(tmp_path: Path) -> Path:
    """Return a folder with what the examples refer to."""
    make_stage(tmp_path)
    return tmp_path


@pytest.mark.parametrize(
    "code", some_quick((c for c in PAGES if examples(c, "yaml")), 4)
)
def test_the_examples_are_true(code: str, stage: Path) -> None:
    wrong, right = examples(code, "yaml")
    assert codes(wrong, stage, FOUND_TOO.get(code, set())) == {code}
    assert codes(right, stage) == set()


def codes(text: str, stage: Path, props: Set[str] = frozenset()) -> set[str]:
    """Return what is found in an example, put into a file where it is a part.

    Targets are then asked of a rig, and of a clip, until something is found.
    """
    kind = re.match(f"({KINDS}): animtool", text)
    path = stage / f"page.{kind[1] if kind else 'rig'}.yaml"
    head = "" if kind else "rig: animtool/1\n"
    if not kind and not re.search("^name:", text, re.M):
        head += "name: page\n"
    path.write_text(head + text, "utf-8")
    found = {fault.code for fault in validate(path)} - props
    if path.name != "page.targets.yaml" or found:
        return found
    found = {fault.code for fault in validate(stage / "solved.scene.yaml")} - props
    solve = "animtool ik hero.rig.yaml --targets page.targets.yaml"
    # Without a clip, holds alone keep the rest pose.
    found = found or set(said(solve, stage)) - props - {"TGT109"}
    return found or set(said(f"{solve} --clip wave.clip.yaml", stage)) - props


def said(commands: str, folder: Path) -> list[str]:
    """Return the codes in what commands say, each of which but the last succeeds."""
    lines = [shlex.split(line) for line in commands.replace("\\\n", " ").splitlines()]
    done = [animtool(*line[1:], cwd=folder) for line in lines if line]
    assert all(one.code == 0 for one in done[:-1])
    return [
        c
        for c in re.findall(r"\b[A-Z]+\d{3}\b", done[-1].stderr)
        if c in builtin_rules()
    ]


@pytest.mark.slow
@pytest.mark.parametrize("code", some_quick((c for c in PAGES if examples(c, "sh")), 3))
def test_commands_are_true(code: str, tmp_path: Path) -> None:
    found = []
    for i, commands in enumerate(examples(code, "sh")):
        folder = tmp_path / str(i)
        folder.mkdir()
        make_stage(folder)
        found.append(said(commands, folder))
    wrong, right = found
    assert set(wrong) == {code}
    assert right == []


@pytest.mark.parametrize("code", [c for c in PAGES if examples(c, "python")])
def test_python_is_true(
    code: str, stage: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(stage)
    wrong, right = examples(code, "python")
    with pytest.raises(AnimtoolError) as caught:
        exec(wrong, {"animtool": animtool_package, "np": np})
    assert {fault.code for fault in caught.value.faults} == {code}
    exec(right, {"animtool": animtool_package, "np": np})


@pytest.mark.parametrize("code", [c for c in PAGES if examples(c, "bvh")])
def test_lines_of_captures_are_true(code: str, tmp_path: Path) -> None:
    wrong, right = examples(code, "bvh")
    capture = next(text for text in (CAPTURE, HOPS) if text.count(right) == 1)
    path = tmp_path / "take.bvh"
    path.write_text(capture, "utf-8")
    assert validate(path) == []
    path.write_text(capture.replace(right, wrong), "utf-8")
    assert code in [fault.code for fault in validate(path)]
