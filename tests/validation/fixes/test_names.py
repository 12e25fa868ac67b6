"""Names made legal: with all that refers to them, and nothing else."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from support.example_rig import EXAMPLE_RIG, write_example_rig

from animtool.documents.document import parse_document
from animtool.documents.edit import apply_edits
from animtool.rig.file import load_rig
from animtool.rig.schema import RigModel
from animtool.validation.fixes.names import NAME_PATHS, rename_edits
from animtool.validation.fixes.run import fix_files
from animtool.validation.run import validate

PATH = Path("hero.rig.yaml")
NAMES = {
    "joints": ["hips", "chest", "shoulder_l", "shoulder_r", "elbow_l", "elbow_r",
               "wrist_l", "wrist_r", "piston", "hair1"],
    "meshes": ["body"],
    "shapes": ["smile", "jaw", "smile_jaw"],
}  # fmt: skip
HEAD = "rig: animtool/1\nname: page\njoints:\n"


def odd(name: str) -> str:
    return f"{name}.x"


def renamed(text: str, key: str, new: dict[str, str]) -> str:
    value = parse_document(text, PATH).value
    return apply_edits(text, PATH, list(rename_edits(value, key, new)))


@pytest.mark.parametrize("key", NAMES)
def test_all_names_there_and_back(key: str) -> None:
    text = (
        EXAMPLE_RIG
        + "ignore:\n"
        + "".join(
            f"- {{code: RIG201, where: '{key}[{name}].name', why: so}}\n"
            for name in NAMES[key]
        )
    )
    there = renamed(text, key, {name: odd(name) for name in NAMES[key]})
    for name in NAMES[key]:
        assert there.count(name) == text.count(name)
    assert there.count(".x") >= 2 * len(NAMES[key])
    assert renamed(there, key, {odd(name): name for name in NAMES[key]}) == text


@pytest.mark.parametrize("key", NAMES)
def test_the_rig_is_the_same_but_for_its_names(key: str, tmp_path: Path) -> None:
    path = write_example_rig(tmp_path)
    before = load_rig(path)
    text = path.read_text("utf-8")
    odd_text = renamed(text, key, {name: odd(name) for name in NAMES[key]})
    path.write_text(odd_text, "utf-8")
    assert "RIG221" in [fault.code for fault in validate(path)]
    fixes = fix_files([path])
    assert [fault.code for fault, _ in fixes.report.mended] == ["RIG221"]
    assert not fixes.unfixed_findings
    after = load_rig(path)
    assert path.read_text("utf-8") == renamed(
        text, key, {name: f"{name}_x" for name in NAMES[key]}
    )
    assert len(after.joints) == len(before.joints)
    assert [joint.parent for joint in after.joints] == [j.parent for j in before.joints]


def test_every_name_of_the_format_is_known() -> None:
    """A key of names that is new in the schema wants a line in the table."""
    known = {use.replace("{}", "*") for uses in NAME_PATHS.values() for use in uses}
    others = {"name", "ik/*/name", "attach/*/name", "attach/*/kind", "controls/*/name",
              "controls/*/drives/*/control"}  # fmt: skip
    assert set(_names(RigModel.model_json_schema(by_alias=True))) == known | others


def _names(schema: dict[str, Any]) -> set[str]:
    """Return where the schema has names: texts that may not be empty."""
    found: set[str] = set()

    def walk(node: dict[str, Any], at: tuple[str, ...]) -> None:
        if "$ref" in node:
            name = node["$ref"].rpartition("/")[2]
            if name != "IgnoreModel":
                walk(schema["$defs"][name], at)
        if node.get("type") == "string" and node.get("minLength"):
            found.add("/".join(at))
        for kind in ("anyOf", "oneOf"):
            for one in node.get(kind, ()):
                walk(one, at)
        for key, one in node.get("properties", {}).items():
            walk(one, (*at, key))
        if isinstance(node.get("items"), dict):
            walk(node["items"], (*at, "*"))
        if isinstance(node.get("additionalProperties"), dict):
            # Keys of a mapping are names.
            found.add("/".join((*at, "*")))
            walk(node["additionalProperties"], (*at, "*"))

    walk(schema, ())
    return found


@pytest.mark.parametrize(
    ("names", "made"),
    [
        (["a.l", "a-l"], ["a_l", "a_l_2"]),
        (["a.l", "a_l"], ["a_l_2", "a_l"]),
        (["a_l", "a.l", "a_l_2"], ["a_l", "a_l_3", "a_l_2"]),
        (["1", "_1"], ["_1_2", "_1"]),
        (["a b", "c"], ["a_b", "c"]),
    ],
)
def test_names_become_distinct(
    names: list[str], made: list[str], tmp_path: Path
) -> None:
    path = tmp_path / "page.rig.yaml"
    entries = "".join(f'- {{name: "{name}", type: free}}\n' for name in names)
    path.write_text(HEAD + entries, "utf-8")
    fix_files([path])
    assert list(load_rig(path).names) == made
    assert validate(path) == []


@pytest.mark.parametrize("name", ["walk.clip.yaml", "deep/x.targets.json"])
def test_what_another_file_names_stays(name: str, tmp_path: Path) -> None:
    path = tmp_path / "page.rig.yaml"
    text = HEAD + '- {name: "a.l", type: free}\n'
    path.write_text(text, "utf-8")
    other = tmp_path / name
    other.parent.mkdir(exist_ok=True)
    other.write_text("joint/a.l.rotation", "utf-8")
    fixes = fix_files([path])
    assert not fixes.report.mended
    assert [(f.code, other.name in why) for f, why in fixes.unfixed_findings] == [
        ("RIG221", True)
    ]
    assert path.read_text("utf-8") == text


def test_a_sidecar_keeps_the_names_of_its_base(tmp_path: Path) -> None:
    base = tmp_path / "base.rig.yaml"
    base.write_text(HEAD + "- {name: a.l, type: free}\n- {name: a-l, type: free}\n")
    path = tmp_path / "page.rig.yaml"
    text = "rig: animtool/1\nname: page\nfrom: base.rig.yaml\n"
    path.write_text(text, "utf-8")
    fixes = fix_files([path])
    assert not fixes.report.mended
    assert path.read_text("utf-8") == text


def test_drivers_read_joints_by_their_new_names(tmp_path: Path) -> None:
    path = tmp_path / "arm.rig.yaml"
    path.write_text(
        "rig: animtool/1\nname: arm\njoints:\n"
        "- {name: 'el bow', type: pin, axis: [0, 0, 1]}\n"
        "- {name: roll, type: pin, axis: [1, 0, 0],\n"
        "   driven: {expr: \"'el bow.angle' / 2\"}}\n"
        "shapes: [{name: s, driven: {by: el bow.angle, curve: [[0, 0], [9, 1]]}}]\n",
        "utf-8",
    )
    assert not fix_files([path]).unfixed_findings
    rig = load_rig(path)
    assert rig.names == ["el_bow", "roll"]
    drivers = rig.joints[1].driven, rig.shapes[0].driven
    assert [driver and driver.names for driver in drivers] == [("el_bow.angle",)] * 2
