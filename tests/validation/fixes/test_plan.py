"""Mends of a whole file: each keeps what it should, and twice is as once."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from support.suite import examples

from animtool.core.errors import Fault
from animtool.core.rules import builtin_rules
from animtool.documents.document import parse_document
from animtool.validation.fixes.draft import FIXES, load_fix
from animtool.validation.fixes.plan import mark_fixable, plan_fixes
from animtool.validation.fixes.run import fix_files
from animtool.validation.options import ValidateOptions
from animtool.validation.run import validate, validate_files

IGNORES = (
    "{code: RIG202, why: gone}",
    '{code: CLIP011, where: "joints[*]", why: "old: one"}',
    "code: RIG201\n  why: |\n    so\n    long",
)


@pytest.mark.parametrize("code", FIXES)
def test_a_fix_is_there_and_of_a_code(code: str) -> None:
    assert code in builtin_rules()
    assert callable(load_fix(code))


NAMES = st.sampled_from(["a", "a.l", "a-l", "a l", "a_l", "a_l_2", "1", "_1", "b", "é"])


@st.composite
def rigs(draw: st.DrawFn) -> str:
    """Return rigs with any of what is mended, in any layout."""
    names = draw(st.lists(NAMES, min_size=1, max_size=5, unique=True))
    quote = draw(st.sampled_from(['"', "'"]))
    lines = ["# head", "rig: animtool/1   # one", "name: page", "joints:"]
    bind = []
    for i, name in enumerate(names):
        above = draw(st.sampled_from([None, *names[:i]]))
        parent = f", parent: {quote}{above}{quote}" if above else ""
        lines += [f"- {{name: {quote}{name}{quote}{parent},", "   type: ball}  # why"]
        if draw(st.booleans()):
            bind.append(f"  {quote}{name}{quote}: {{translate: [0, 1.50, {i}]}}")
    lines += ["bind:", *bind] if bind else []
    ignored = draw(st.lists(st.sampled_from(IGNORES), max_size=4))
    lines += ["ignore:", *(f"- {entry}" for entry in ignored)] if ignored else []
    newline = draw(st.sampled_from(["\n", "\r\n"]))
    return newline.join(lines) + draw(st.sampled_from(["", newline]))


@pytest.mark.slow
@settings(
    max_examples=examples(25),
    suppress_health_check=[HealthCheck.function_scoped_fixture],
)
@given(text=rigs())
def test_twice_is_as_once(text: str, tmp_path: Path) -> None:
    path = tmp_path / "page.rig.yaml"
    path.write_text(text, "utf-8", newline="")
    before = [fault.code for fault in validate(path)]
    fixable = mark_fixable(validate_files([path])).fixable
    fixes = fix_files([path])
    once = path.read_bytes()
    left = [fault.code for fault in validate(path)]
    assert all(left.count(code) <= before.count(code) for code in left)
    assert not [code for code in left if code in FIXES]
    assert len(fixes.report.mended) <= len(fixable)
    assert once.count(b"# why") == text.encode().count(b"# why")
    assert once.startswith(text.splitlines()[0].encode())
    again = fix_files([path])
    assert not again.report.mended
    assert path.read_bytes() == once


def test_a_file_without_findings_is_not_touched(root: Path) -> None:
    for path in sorted((root / "rigs").glob("*/*.rig.yaml")):
        plan = plan_fixes(path, ValidateOptions())
        assert plan.draft.text == path.read_text("utf-8")
        assert not plan.fixed_findings


def test_a_mark_at_the_beginning_stays(tmp_path: Path) -> None:
    path = tmp_path / "page.rig.yaml"
    text = 'rig: animtool/1\nname: page\njoints: [{name: "a.l", type: free}]\n'
    path.write_text(text, "utf-8-sig")
    fix_files([path])
    assert path.read_bytes() == text.replace("a.l", "a_l").encode("utf-8-sig")


def test_a_json_file(tmp_path: Path) -> None:
    path = tmp_path / "page.rig.json"
    text = (
        '{"rig": "animtool/1", "name": "page", "joints": [\n\t{"name": "a.l", '
        '"type": "free"}],\n"ignore": [{"code": "RIG201", "why": "\\ud83d\\ude00"}]}'
    )
    path.write_text(text, "utf-8")
    assert {f.code for f, _ in fix_files([path]).report.mended} == {"RIG221", "VAL001"}
    assert validate(path) == []
    assert path.read_text("utf-8") == (
        '{"rig": "animtool/1", "name": "page", "joints": [\n\t{"name": "a_l", '
        '"type": "free"}]}'
    )


def test_only_what_counts_is_mended(tmp_path: Path) -> None:
    path = tmp_path / "page.rig.yaml"
    text = 'rig: animtool/1\nname: page\njoints: [{name: "a.l", type: free}]\n'
    path.write_text(text, "utf-8")
    assert not fix_files([path], ValidateOptions(ignore=("RIG221",))).report.mended
    (tmp_path / "animtool.toml").write_text("[validate]\nignore = ['RIG221']\n")
    assert not fix_files([path]).report.mended
    assert path.read_text("utf-8") == text


def test_a_mend_that_makes_it_worse_is_not_kept(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from animtool.documents.edit import Replace
    from animtool.validation.fixes.draft import FixEdits

    def wrong(_opened: object, _fault: Fault) -> FixEdits:
        return FixEdits("makes it no rig", (Replace(("joints", 0, "type"), "wheel"),))

    path = tmp_path / "page.rig.yaml"
    text = 'rig: animtool/1\nname: page\njoints: [{name: "a.l", type: free}]\n'
    path.write_text(text, "utf-8")
    monkeypatch.setattr("animtool.validation.fixes.texts.load_fix", lambda _: wrong)
    fixes = fix_files([path])
    assert not fixes.report.mended
    assert [why for _, why in fixes.unfixed_findings] == ["the fix would cause DOC022"]
    assert (
        parse_document(path.read_text("utf-8"), path).value["joints"][0]["type"]
        == "free"
    )


def test_what_is_fixable_is_marked(tmp_path: Path) -> None:
    path = tmp_path / "page.rig.yaml"
    path.write_text(
        'rig: animtool/1\nname: page\njoints: [{name: "a.l", type: pin, '
        "axis: [1, 0, 0], limits: [2, 3]}]\n"
    )
    report = mark_fixable(validate_files([path]))
    assert _codes(report.findings) == ["RIG201", "RIG221"]
    assert _codes(tuple(report.fixable)) == ["RIG221"]
    (tmp_path / "x.clip.yaml").write_text("a.l")
    assert not mark_fixable(validate_files([path])).fixable


def _codes(faults: Sequence[Fault]) -> list[str]:
    return sorted(fault.code for fault in faults)


def test_names_of_a_bvh_are_found_and_not_fixed(tmp_path: Path) -> None:
    path = tmp_path / "walk.bvh"
    channels = "CHANNELS 3 Xrotation Yrotation Zrotation"
    path.write_text(
        f"HIERARCHY\nROOT a:b\n{{\nOFFSET 0 0 0\n{channels}\n"
        f"JOINT a.b\n{{\nOFFSET 0 1 0\n{channels}\n"
        "End Site\n{\nOFFSET 0 1 0\n}\n}\n}\n"
        "MOTION\nFrames: 2\nFrame Time: 0.041666667\n0 0 0 0 0 0\n1 0 0 2 0 0\n"
    )
    report = mark_fixable(validate_files([path]))
    assert "RIG219" in [fault.code for fault in report.findings]
    assert not report.fixable
