"""Lines of records by templates."""

from __future__ import annotations

import ast
import re
from dataclasses import dataclass, field
from pathlib import Path

import pytest

import animtool.cli
from animtool.report.text import DEFAULT_PRINTERS, Each, Table, render


@dataclass(frozen=True)
class Joint:
    name: str
    size: float | None = None
    lost: str = ""


@dataclass(frozen=True)
class Rig:
    joints: list[Joint] = field(default_factory=list)
    counts: dict[str, int] = field(default_factory=dict)
    named: str = ""

    @property
    def first(self) -> Joint | None:
        return self.joints[0] if self.joints else None


@pytest.mark.parametrize(
    ("template", "line"),
    [
        ("{joints:n joint}", "2 joints"),
        ("a[, {named}] b", "a b"),
        ("[{named}|none]", "none"),
        ("[{?counts}some|{!named}no name]", "no name"),
        ("{joints:last | n joint}", "1 joint"),
        ("{first.size:length 2} {first.size:mm >8}", "12 mm       12"),
        ("[{first.size:nothing}|{first.lost}|left]", "left"),
    ],
)
def test_a_line_is_a_template(template: str, line: str) -> None:
    joints = [Joint("hips", 0.012), Joint("knee")]
    printers = {"nothing": lambda _: "", "last": lambda joints: joints[-1:]}
    assert render(Rig(joints), [template], printers) == [line]


def test_a_line_without_its_field_is_none() -> None:
    assert render(Rig(), ["{named}", "{joints:n joint}", "[{named}]", ""]) == [""]


def test_entries_have_lines_and_the_others_a_number() -> None:
    rig = Rig([Joint(name) for name in "abc"], {"pin": 2}, "hero")
    joints = Each("joints", ("{named}/{name}",), 2, "and {left} more")
    lines = render(rig, [joints, Each("counts", ("{key}: {value}",))])
    assert lines == ["hero/a", "hero/b", "and 1 more", "pin: 2"]


def test_a_table_leaves_out_columns_that_are_empty() -> None:
    rig = Rig([Joint("a", 0.5), Joint("bcd")])
    columns = {"": "{name}", "mm": "{size:mm}", "lost": "{lost}"}
    table = Table("joints", columns, left=("",), optional=("lost",), indent="  ")
    assert render(rig, [table]) == ["        mm", "  a    500", "  bcd"]


FIELD = re.compile(r"\{[?!]?[\w.@]+:([^{}]*)\}")
# What `format` has itself: a width, digits and a letter.
OWN_FORMAT = re.compile(r"[<>^]?[-+]?0?\d*,?(\.\d+)?[defgsx%]?")
COMMANDS = sorted(Path(animtool.cli.__file__).parent.glob("*.py"))


@pytest.mark.parametrize(
    "path",
    [path for path in COMMANDS if "report.text" in path.read_text("utf-8")],
    ids=lambda path: path.stem,
)
def test_templates_name_printers_that_there_are(path: Path) -> None:
    nodes = [*ast.walk(ast.parse(path.read_text("utf-8")))]
    keys = [key for node in nodes if isinstance(node, ast.Dict) for key in node.keys]
    known = {key.value for key in keys if isinstance(key, ast.Constant)} | {
        *DEFAULT_PRINTERS,
        "names",
    }
    texts = [
        node.value
        for node in nodes
        if isinstance(node, ast.Constant) and isinstance(node.value, str)
    ]
    words = {spec.split(" ")[0] for text in texts for spec in FIELD.findall(text)}
    assert {w for w in words - known if not OWN_FORMAT.fullmatch(w)} == set()
