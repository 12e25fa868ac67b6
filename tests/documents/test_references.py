from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from animtool.cli.main import run
from animtool.core.config import project_roots
from animtool.core.files.reading import recorded_inputs
from animtool.documents import references
from animtool.documents.document import parse_document
from animtool.documents.references import (
    resolve_input,
    resolve_path,
    resolve_reference,
    similar_file_hint,
)


def test_references_stay_in_the_roots(tmp_path: Path) -> None:
    folder, library = tmp_path / "a", tmp_path / "library"
    folder.mkdir()
    assert resolve_path(folder, [tmp_path], "../x.npz") == tmp_path / "x.npz"
    assert resolve_path(folder, [folder, library], "../library/x") == library / "x"
    (folder / "way").symlink_to(tmp_path)
    for name in ("../x.npz", "/etc/passwd", "b/../../x", "way/x.npz", "../ab/x"):
        with pytest.raises(ValueError, match="leads out"):
            resolve_path(folder, [folder], name)


def refused(path: Path, name: str) -> str:
    """Return the hint about a reference that leads out of the project."""
    path.parent.mkdir(parents=True, exist_ok=True)
    document = parse_document(f"clip: animtool/1\nrig: {name}\n", path)
    roots = project_roots(path)
    assert resolve_reference(document, ("rig",), name, roots) is None
    (fault,) = document.faults
    assert (fault.code, fault.lines) == ("DOC014", (2,))
    return str(fault.hint)


def test_the_line_that_allows_a_folder_is_given(tmp_path: Path) -> None:
    clip = tmp_path / "show/clips/walk.clip.yaml"
    rig = tmp_path / "show/rigs/hero.rig.yaml"
    rig.parent.mkdir(parents=True)
    rig.touch()
    hint = refused(clip, "../rigs/hero.rig.yaml")
    settings = tmp_path / "show/animtool.toml"
    assert str(settings.parent) in hint
    assert settings.name in hint
    document = parse_document("clip: animtool/1\n", clip)
    name = "../rigs/hero.rig.yaml"
    # It does what the hint says, and so does the line for settings that exist.
    settings.touch()
    assert resolve_reference(document, (), name, project_roots(clip)) == rig
    settings.unlink()
    own = clip.with_name("pyproject.toml")
    own.write_text("[tool.animtool]\n")
    line = 'roots = ["../rigs"]'
    hint = refused(clip, name)
    assert hint.endswith(f"add {line} to {own} under [tool.animtool]")
    own.write_text(f"[tool.animtool]\n{line}\n")
    assert resolve_reference(document, (), name, project_roots(clip)) == rig
    own.unlink()
    (tmp_path / "show/.git").mkdir()
    assert resolve_reference(document, (), name, project_roots(clip)) == rig
    assert "copy x.rig.yaml," in refused(clip, "../../x.rig.yaml")


def test_a_file_of_a_nearly_right_name_is_named(tmp_path: Path) -> None:
    (tmp_path / "rigs").mkdir()
    (tmp_path / "rigs/hero.rig.yaml").touch()
    document = parse_document("clip: animtool/1\nrig: x\n", tmp_path / "a.clip.yaml")
    for name in ("rigs/heros.rig.yaml", "rig/hero.rig.yaml", "other.yaml"):
        assert resolve_input(document, ("rig",), name, [tmp_path]) is None
    hints = [fault.hint for fault in document.faults]
    assert hints == [*["did you mean 'rigs/hero.rig.yaml'?"] * 2, None]


def test_backslashes_are_wrong_only_where_they_separate_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    document = parse_document("clip: animtool/1\nrig: x\n", tmp_path / "a.clip.yaml")
    name = "rigs\\hero.rig.yaml"
    assert similar_file_hint(document, name) == "write / in paths: rigs/hero.rig.yaml"
    monkeypatch.setattr(references, "os", SimpleNamespace(sep="\\"))
    assert similar_file_hint(document, name) is None


RIG = "rig: animtool/1\nname: r\njoints: [{name: a}]\n"
TARGETS = "targets: animtool/1\nfps: 24\nrange: [1, 4]\n"
SCENE = "scene: animtool/1\nsource: {file: i.bvh}\noutput: {file: q.usdc}\n"
SYSTEMS = (
    "scene: animtool/1\nfps: 24\nrange: [1, 4]\noutput: {file: q.usdc}\nsystems:\n- "
)


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("a.rig.yaml", RIG + "meshes: [{name: m, points: OUT.npz, faces: OUT.npz}]\n"),
        ("a.rig.yaml", "rig: animtool/1\nname: r\nfrom: OUT.rig.yaml\n"),
        ("a.rig.yaml", "rig: animtool/1\nname: r\nfrom: OUT.usda\n"),
        ("a.clip.yaml", "clip: animtool/1\nrig: OUT.rig.yaml\nfps: 24\nchannels: []\n"),
        ("a.targets.yaml", TARGETS + "goals: [{effector: a, position: OUT.npz}]\n"),
        (
            "a.targets.yaml",
            TARGETS + "goals: [{effector: a, position: {file: OUT.usda, prim: /A}}]\n",
        ),
        ("a.scene.yaml", SCENE.replace("i.bvh", "OUT.bvh")),
        ("a.scene.yaml", SCENE + "rig: OUT.rig.yaml\n"),
        ("a.scene.yaml", SCENE + "passes: [{layer: {take: OUT.bvh}}]\n"),
        ("a.scene.yaml", SCENE + "passes: [{ik: {targets: OUT.targets.yaml}}]\n"),
        (
            "a.scene.yaml",
            SYSTEMS + "cloth: {name: c, points: OUT.npz, faces: OUT.npz, mass: 1}\n",
        ),
        (
            "a.scene.yaml",
            SYSTEMS + "cloth: {name: c, mass: 1, meshes: [{file: OUT.usda, prim: /A}]}",
        ),
        (
            "a.batch.yaml",
            "batch: animtool/1\ninputs: [i.bvh]\nvariants: OUT.csv\noutput: x\n",
        ),
        (
            "a.batch.yaml",
            "batch: animtool/1\ninputs: [i.bvh]\nscene: OUT.scene.yaml\noutput: x\n",
        ),
    ],
)
def test_what_is_refused_is_not_opened(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str, text: str
) -> None:
    inside, outside = tmp_path / "in", tmp_path / "out"
    inside.mkdir()
    outside.mkdir()
    np.savez(outside / "o.npz", points=np.eye(3), faces=np.array([[0, 1, 2]]))
    for kind in ("rig.yaml", "targets.yaml", "scene.yaml", "bvh", "usda", "csv"):
        (outside / f"o.{kind}").write_text("k\n1\n")
    (inside / "i.bvh").write_text("HIERARCHY")
    (inside / name).write_text(text.replace("OUT", "../out/o"))
    # A name that is not followed must not be taken from where the user is, either.
    monkeypatch.chdir(inside)
    with recorded_inputs() as inputs:
        assert run(["validate", name]) == 1
    assert not [path for path in inputs.states if path.match("o.*")]


@pytest.mark.parametrize(
    ("name", "hint"),
    [
        ("file:///takes/walk.bvh", ": /takes/walk.bvh"),
        ("file:///C:/walk.bvh", ": C:/walk.bvh"),
        ("https://example.org/walk.bvh", "download"),
        ("*.bvh", "2 files: name one file, or write ${input}"),
        ("nowhere/*.bvh", "0 files: name one file"),
    ],
)
def test_urls_and_patterns_are_no_files(tmp_path: Path, name: str, hint: str) -> None:
    for take in ("a.bvh", "b.bvh"):
        (tmp_path / take).touch()
    path = tmp_path / "a.scene.yaml"
    document = parse_document(f"scene: animtool/1\nsource: '{name}'\n", path)
    assert resolve_input(document, ("source",), name, [tmp_path]) is None
    (fault,) = document.faults
    assert fault.code == "DOC015"
    assert hint in (fault.hint or "")
