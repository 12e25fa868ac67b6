"""Files of versions that there never were, rewritten."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest

from animtool.core.errors import AnimtoolError, FormatError, OptionError, StrictError
from animtool.documents.check import check_version
from animtool.documents.document import read_document
from animtool.documents.edit import EditError
from animtool.documents.migrate import migrate, plan_migration
from animtool.documents.versions import MIGRATION_STEPS as TABLES
from animtool.documents.versions import (
    MigrationSteps,
    kind_and_version,
    newest_version_of,
)
from animtool.scene.file.read import load_scene


def with_joints(value: dict[str, Any]) -> dict[str, Any]:
    """Version 2 calls bones joints."""
    return {
        ("joints" if key == "bones" else key): entry for key, entry in value.items()
    }


def in_metres(value: dict[str, Any]) -> dict[str, Any]:
    """Version 3 states its unit."""
    return {**value, "units": {"length": "m"}}


TABLE: Mapping[str, MigrationSteps] = {
    "rig": {1: with_joints, 2: in_metres},
    "clip": {1: lambda value: value},
    "scene": {},
}
OLD = """\
# A rig of long ago.
rig: animtool/1
name: "1e3"
bones:  # as they were called
- {name: no, translate: [0, 1.5, -2.0e-05]}
"""


def written(folder: Path, text: str, name: str = "a.rig.yaml") -> Path:
    path = folder / name
    path.write_text(text, newline="")
    return path


def test_a_chain_of_steps(tmp_path: Path) -> None:
    path = written(tmp_path, OLD)
    plan = plan_migration(path, TABLE)
    assert (plan.kind, plan.version, plan.newest, plan.needed) == ("rig", 1, 3, True)
    assert path.read_text() == OLD
    migrate([path], overwrite=True, table=TABLE)
    assert path.read_text() == plan.new_text
    assert read_document(path).value == {
        "rig": "animtool/3",
        "name": "1e3",
        "joints": [{"name": "no", "translate": [0, 1.5, -2e-5]}],
        "units": {"length": "m"},
    }
    assert plan.new_text.startswith("rig: animtool/3\n")


def test_a_chain_that_begins_later(tmp_path: Path) -> None:
    path = written(tmp_path, "rig: animtool/2\nbones: []\n")
    migrate([path], overwrite=True, table=TABLE)
    assert set(read_document(path).value) == {"rig", "bones", "units"}


def test_comments_that_are_lost_are_said(tmp_path: Path) -> None:
    path = written(tmp_path, OLD)
    (note,) = plan_migration(path, TABLE).notices
    assert (note.code, note.lines) == ("DOC101", (1, 4))
    with pytest.raises(StrictError):
        migrate([path], overwrite=True, strict=True, table=TABLE)
    assert path.read_text() == OLD


@pytest.mark.parametrize("end", ["\n", "\r\n"])
@pytest.mark.parametrize("quote", ["", "'", '"'])
def test_where_only_the_version_changes_so_does_a_word(
    tmp_path: Path, end: str, quote: str
) -> None:
    head, tail = f"# Mine.{end}clip:  {quote}animtool/", f"{quote}  # old{end}fps: 24"
    path = written(tmp_path, f"{head}1{tail}", "a.clip.yaml")
    (plan,) = migrate([path], overwrite=True, table=TABLE)
    assert path.read_bytes().decode() == f"{head}2{tail}"
    assert not plan.notices
    assert [line[0] for line in plan.difference[2:]] == ["@", " ", "-", "+", " "]


def test_json_stays_json(tmp_path: Path) -> None:
    text = '{"rig": "animtool/1", "bones": [{"name": "é"}]}'
    path = written(tmp_path, text, "a.rig.json")
    migrate([path], overwrite=True, table=TABLE)
    assert path.read_text().startswith('{\n  "rig": "animtool/3",\n')
    assert read_document(path).value["joints"] == [{"name": "é"}]


def test_the_newest_is_left_alone(tmp_path: Path) -> None:
    path = written(tmp_path, "scene: animtool/1  # kept\nrig: a.rig.yaml\n")
    before = path.stat()
    (plan,) = migrate([path], table=TABLE)
    assert (plan.kind, plan.needed, plan.difference) == ("scene", False, [])
    after = path.stat()
    assert (before.st_mtime_ns, before.st_ino) == (after.st_mtime_ns, after.st_ino)


def test_migrating_twice_changes_nothing_more(tmp_path: Path) -> None:
    path = written(tmp_path, OLD)
    migrate([path], overwrite=True, table=TABLE)
    once = path.read_text()
    (plan,) = migrate([path], overwrite=True, table=TABLE)
    assert not plan.needed
    assert path.read_text() == once


def test_replacing_needs_saying(tmp_path: Path) -> None:
    path = written(tmp_path, OLD)
    with pytest.raises(OptionError) as caught:
        migrate([path], table=TABLE)
    assert caught.value.code == "OUT001"
    (plan,) = migrate([path], check=True, table=TABLE)
    assert plan.needed
    assert path.read_text() == OLD


def test_a_file_that_cannot_be_read_keeps_all_as_they_are(tmp_path: Path) -> None:
    good = written(tmp_path, OLD)
    future = written(tmp_path, "rig: animtool/4\n", "b.rig.yaml")
    other = written(tmp_path, "name: x\n", "c.rig.yaml")
    with pytest.raises(FormatError) as caught:
        migrate([good, future, other, tmp_path / "d"], overwrite=True, table=TABLE)
    codes = [fault.code for fault in caught.value.faults]
    assert codes == ["DOC012", "DOC009", "IO001"]
    assert good.read_text() == OLD


@pytest.mark.parametrize(
    ("text", "code"),
    [
        ("rig: animtool/0", "DOC012"),
        ("rig: animtool/9", "DOC012"),
        ("rig: animtool/x", "DOC012"),
        ("rig: animtool/-1", "DOC012"),
        ("rig: 1", "DOC009"),
        ("rig: [animtool/1]", "DOC009"),
        ("targets: animtool/1", "DOC009"),
        ("name: x", "DOC009"),
    ],
)
def test_versions_that_are_not_known(tmp_path: Path, text: str, code: str) -> None:
    with pytest.raises(AnimtoolError) as caught:
        kind_and_version(read_document(written(tmp_path, text)), TABLE)
    assert caught.value.code == code


def test_a_kind_is_told_from_the_rig_that_it_names(tmp_path: Path) -> None:
    path = written(tmp_path, "rig: a.rig.yaml\nclip: animtool/2\n")
    assert kind_and_version(read_document(path), TABLE) == ("clip", 2)


def test_reading_an_older_version_names_the_command(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(TABLES["clip"], 0, lambda value: value)
    document = read_document(written(tmp_path, "clip: animtool/0\nfps: 24\n"))
    with pytest.raises(FormatError) as caught:
        check_version(document, "clip")
    assert caught.value.code == "DOC013"
    assert "animtool migrate" in str(caught.value)


def test_the_newest_follows_the_last_step() -> None:
    assert {kind: newest_version_of(steps) for kind, steps in TABLE.items()} == {
        "rig": 3,
        "clip": 2,
        "scene": 1,
    }


RENAMED = """\
# A shot of before.
scene: animtool/1
source: {file: walk.bvh}   # walks
beside:  # the ball
- {from: props.usda, prim: /Set/most, path: most}
systems:
- particles: {emitters: [{rate: 5, most: 3}], "most": 7}
output: {file: out.usda}
"""


def test_keys_of_new_names_are_renamed_and_nothing_else(tmp_path: Path) -> None:
    path = written(tmp_path, RENAMED, "a.scene.yaml")
    plan = plan_migration(path)
    assert plan.needed
    assert [line for line in plan.difference if line[0] in "+-"][2:] == [
        "-beside:  # the ball",
        "+props:  # the ball",
        '-- particles: {emitters: [{rate: 5, most: 3}], "most": 7}',
        '+- particles: {emitters: [{rate: 5, most: 3}], "max_particles": 7}',
    ]
    migrate([path], overwrite=True)
    assert path.read_text() == plan.new_text
    assert not plan_migration(path).needed


def test_keys_that_cannot_be_renamed_are_listed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """No layout is known of which this is true."""

    def refuse(*_: object) -> str:
        raise EditError("the layout cannot be kept")

    monkeypatch.setattr("animtool.documents.migrate.apply_edits", refuse)
    with pytest.raises(FormatError) as caught:
        plan_migration(written(tmp_path, RENAMED, "a.scene.yaml"))
    assert caught.value.code == "DOC026"
    assert "rename beside, systems[0].particles" in str(caught.value)


def test_keys_of_old_names_are_read_with_a_warning(tmp_path: Path) -> None:
    path = written(tmp_path, RENAMED.replace(", most: 3", ""), "a.scene.yaml")
    for name in ("walk.bvh", "props.usda"):
        written(tmp_path, "", name)
    scene = load_scene(path)
    assert [prop.path for prop in scene.props] == ["most"]
    (system,) = scene.systems
    assert system.setup.spec.max_particles == 7
    assert [(n.code, n.lines, n.where) for n in scene.notices] == [
        ("DOC102", (5,), "beside"),
        ("DOC102", (7,), "systems[0].particles.most"),
    ]


def test_both_names_of_a_key_are_an_error(tmp_path: Path) -> None:
    path = written(tmp_path, f"{RENAMED}props: []\n", "a.scene.yaml")
    with pytest.raises(FormatError) as caught:
        load_scene(path)
    unknown = [f.where for f in caught.value.faults if f.code == "DOC020"]
    assert unknown == ["beside", "systems[0].particles.emitters[0].most"]
    assert "beside:" in plan_migration(path).new_text


def test_options_of_passes_have_new_names_too(tmp_path: Path) -> None:
    """`colliders` is a list of shapes now; where it is true or false it is renamed."""
    text = """scene: animtool/1
source: {file: a.bvh}
passes:
- simulate: {what: [a], damping: 2, shear: 3, colliders: false}  # of old
- simulate: {what: [b], colliders: [{shape: {plane: {}}}]}
- ragdoll: {damping: 1}
output: {file: o.usdc}
"""
    plan = plan_migration(written(tmp_path, text, "a.scene.yaml"))
    new = text.replace("damping: 2, shear: 3", "ratio: 2, diagonals: 3")
    assert plan.new_text == new.replace("colliders: false", "capsules: false")


def test_faults_that_stay_are_warned_of(tmp_path: Path) -> None:
    scene = written(
        tmp_path,
        "scene: animtool/1\nsource: {file: walk.bvh, up: +Y}\npasses:\n"
        "- simulate: {what: [cape], damping: 2}\noutput: a.usdc\n",
        "a.scene.yaml",
    )
    rig = written(tmp_path, "rig: animtool/1\nname: a\njoint: []\nup: Q\n")
    plans = migrate([scene, rig], check=True)
    assert [plan.needed for plan in plans] == [True, False]
    found = [[(n.code, n.lines, str(n.severity)) for n in p.notices] for p in plans]
    assert found == [
        [("DOC022", (2,), "warning")],
        [("DOC020", (3,), "warning"), ("DOC022", (4,), "warning")],
    ]
    with pytest.raises(StrictError):
        migrate([scene], overwrite=True, strict=True)
    assert "damping" in scene.read_text()


def test_variables_without_values_are_no_fault(tmp_path: Path) -> None:
    scene = written(
        tmp_path,
        'scene: animtool/1\nsource: {file: "${f}", up: "${u}", fps: "${r}"}\n'
        "range: 1-24\noutput: a.usdc\n",
        "a.scene.yaml",
    )
    (plan,) = migrate([scene], check=True)
    assert not plan.notices
