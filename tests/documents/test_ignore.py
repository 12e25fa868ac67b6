"""Findings that files accept."""

from __future__ import annotations

from pathlib import Path

from animtool.core.errors import Fault, Severity
from animtool.documents.document import read_document
from animtool.documents.ignore import IgnoreEntries, without_accepted


def test_an_entry_may_have_the_code_of_an_earlier_version(tmp_path: Path) -> None:
    path = tmp_path / "a.clip.yaml"
    path.write_text("clip: animtool/1\nignore: [{code: CLIP203, why: a cut}]\n")
    faults = [Fault(code, "odd", str(path)) for code in ("MOT202", "MOT203", "MOT208")]
    ignores = IgnoreEntries.from_document(read_document(path))
    assert ignores.hide(faults) == faults[2:]
    assert list(ignores.entry_faults()) == []


def test_accepted_warnings_are_left_out_and_all_else_stays(tmp_path: Path) -> None:
    path = tmp_path / "a.scene.yaml"
    path.write_text("scene: animtool/1\nignore: [{code: SIM181, why: the rim}]\n")
    warning = Severity.WARNING
    accepted = Fault("SIM181", "a", str(path), severity=warning)
    others = [
        Fault("SIM182", "b", str(path), severity=warning),
        Fault("SIM181", "c", str(tmp_path / "b.scene.yaml"), severity=warning),
        Fault("SIM181", "d", severity=warning),
        Fault("SIM181", "e", str(path), severity=Severity.NOTE),
        Fault("SIM181", "f", str(tmp_path / "walk.bvh"), severity=warning),
    ]
    assert without_accepted([accepted, *others]) == others
