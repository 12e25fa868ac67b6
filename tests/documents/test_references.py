from __future__ import annotations

from pathlib import Path

import pytest

from animtool.config import project_roots
from animtool.documents.document import document_of
from animtool.documents.references import reference, referred, referred_input


def test_references_stay_in_the_roots(tmp_path: Path) -> None:
    folder, library = tmp_path / "a", tmp_path / "library"
    folder.mkdir()
    assert reference(folder, [tmp_path], "../x.npz") == tmp_path / "x.npz"
    assert reference(folder, [folder, library], "../library/x") == library / "x"
    (folder / "way").symlink_to(tmp_path)
    for name in ("../x.npz", "/etc/passwd", "b/../../x", "way/x.npz", "../ab/x"):
        with pytest.raises(ValueError, match="leads out"):
            reference(folder, [folder], name)


def refused(path: Path, name: str) -> str:
    """Return the hint about a reference that leads out of the project."""
    path.parent.mkdir(parents=True, exist_ok=True)
    document = document_of(f"clip: animtool/1\nrig: {name}\n", path)
    roots = project_roots(path)
    assert referred(document, ("rig",), name, roots, "CLIP012") is None
    (fault,) = document.faults
    assert (fault.code, fault.lines) == ("CLIP012", (2,))
    return str(fault.hint)


def test_the_line_that_allows_a_folder_is_given(tmp_path: Path) -> None:
    clip = tmp_path / "show/clips/walk.clip.yaml"
    rig = tmp_path / "show/rigs/hero.rig.yaml"
    rig.parent.mkdir(parents=True)
    rig.touch()
    hint = refused(clip, "../rigs/hero.rig.yaml")
    settings = tmp_path / "show/animtool.toml"
    assert hint == f"an empty {settings} makes that folder the project"
    document = document_of("clip: animtool/1\n", clip)
    name = "../rigs/hero.rig.yaml"
    # It does what the hint says, and so does the line for settings that exist.
    settings.touch()
    assert referred(document, (), name, project_roots(clip), "CLIP012") == rig
    settings.unlink()
    own = clip.with_name("pyproject.toml")
    own.write_text("[tool.animtool]\n")
    line = 'roots = ["../rigs"]'
    hint = refused(clip, name)
    assert hint.endswith(f"write {line} into {own} under [tool.animtool]")
    own.write_text(f"[tool.animtool]\n{line}\n")
    assert referred(document, (), name, project_roots(clip), "CLIP012") == rig
    own.unlink()
    (tmp_path / "show/.git").mkdir()
    assert referred(document, (), name, project_roots(clip), "CLIP012") == rig
    assert "copy x.rig.yaml," in refused(clip, "../../x.rig.yaml")


def test_a_file_of_a_nearly_right_name_is_named(tmp_path: Path) -> None:
    (tmp_path / "rigs").mkdir()
    (tmp_path / "rigs/hero.rig.yaml").touch()
    document = document_of("clip: animtool/1\nrig: x\n", tmp_path / "a.clip.yaml")
    codes = ("CLIP012", "CLIP012")
    for name in ("rigs/heros.rig.yaml", "rig/hero.rig.yaml", "other.yaml"):
        assert referred_input(document, ("rig",), name, [tmp_path], codes) is None
    hints = [fault.hint for fault in document.faults]
    file, folder = "rigs/hero.rig.yaml", "rigs"
    assert hints == [
        f"did you mean {file!r}?",
        f"did you mean the folder {folder!r}?",
        None,
    ]
