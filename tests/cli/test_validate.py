"""``validate`` and ``explain``: what they say and how they end."""

from __future__ import annotations

import io
import json
import os
from pathlib import Path

import numpy as np
import pytest
from support.bvh import small_bvh
from support.cli import animtool, animtool_process

from animtool.core.errors import Severity
from animtool.core.rules import Kind, Rule, builtin_rules
from animtool.validation.formats import FORMATS as WRITERS
from animtool.validation.options import FORMATS

RIG = "rig: animtool/1\nname: leg\njoints:\n- {name: knee, type: pin, axis: [1, 0, 0]"
WARNED, RIGHT, WRONG = f"{RIG}, limits: [1, 9]}}\n", f"{RIG}}}\n", f"{RIG}, a: 1}}\n"


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "right.rig.yaml").write_text(RIGHT, "utf-8")
    (tmp_path / "warned.rig.yaml").write_text(WARNED, "utf-8")
    (tmp_path / "wrong.rig.yaml").write_text(WRONG, "utf-8")
    return tmp_path


def test_the_forms_are_those_that_there_are() -> None:
    assert list(FORMATS) == list(WRITERS)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["-o", "a.usda"], "-o needs --fix, which writes."),
        (["--overwrite", "--fix", "--diff"], "--overwrite needs --fix, which writes."),
        (["--diff", "--format", "json"], "--diff writes a diff, not a report"),
        (["--diff", "--output-file", "a"], "--diff writes a diff, not a report"),
    ],
)
def test_options_of_reports_that_exclude_each_other(
    arguments: list[str], message: str
) -> None:
    done = animtool("validate", "none.rig.yaml", *arguments)
    assert done.code == 2
    assert message in done.stderr


@pytest.mark.parametrize("form", FORMATS)
@pytest.mark.parametrize(
    ("arguments", "code"),
    [
        (["right.rig.yaml"], 0),
        (["warned.rig.yaml"], 0),
        (["warned.rig.yaml", "--strict"], 1),
        (["warned.rig.yaml", "--severity", "rig201=error"], 1),
        (["wrong.rig.yaml"], 1),
        (["wrong.rig.yaml", "--exit-zero"], 0),
        (["."], 1),
        (["none.rig.yaml", "wrong.rig.yaml"], 3),
        (["none.rig.yaml", "--exit-zero"], 3),
        (["*.bvh"], 5),
        (["right.rig.yaml", "--select", "RIGG"], 2),
        (["right.rig.yaml", "--severity", "RIG=bad"], 2),
        (["right.rig.yaml", "-j", "0"], 2),
    ],
)
def test_how_it_ends(folder: Path, form: str, arguments: list[str], code: int) -> None:
    done = animtool("validate", *arguments, "--format", form, cwd=folder)
    assert done.code == code, done.stderr
    if code in {0, 1, 3}:
        assert done.stdout or form == "github"


def test_what_it_says(folder: Path) -> None:
    done = animtool("validate", ".", cwd=folder)
    assert done.stdout.splitlines()[-1] == "3 files: 1 error, 1 warning"
    assert "warned.rig.yaml:4:52: warning: RIG201" in done.stdout
    assert done.stderr == ""
    quiet = animtool("validate", ".", "--ignore", "RIG,DOC020", "-q", cwd=folder)
    assert (quiet.code, quiet.stdout) == (0, "3 files: nothing found\n")


def test_a_list(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(
        "sys.stdin", io.StringIO("right.rig.yaml\n\nwrong.rig.yaml\r\n")
    )
    done = animtool("validate", "-", "--format", "json", cwd=folder)
    assert json.loads(done.stdout)["files"] == ["right.rig.yaml", "wrong.rig.yaml"]


def test_an_output_file(folder: Path) -> None:
    done = animtool(
        "validate", ".", "--format", "sarif", "--output-file", "out.sarif", cwd=folder
    )
    assert (done.code, done.stdout) == (1, "")
    assert "3 files: 1 error, 1 warning" in done.stderr
    assert json.loads((folder / "out.sarif").read_text("utf-8"))["version"] == "2.1.0"
    refused = animtool("validate", ".", "--output-file", "right.rig.yaml", cwd=folder)
    assert refused.code == 2
    assert (folder / "right.rig.yaml").read_text("utf-8") == RIGHT


def test_a_report_that_cannot_be_written_is_refused_before_the_work(
    folder: Path,
) -> None:
    text = f"{RIGHT}ignore: [{{code: RIG201, why: it is meant}}]\n"
    (folder / "right.rig.yaml").write_text(text, "utf-8")
    done = animtool(
        "validate", ".", "--fix", "--output-file", "none/out.txt", cwd=folder
    )
    assert (done.code, done.stdout) == (3, "")
    assert "OUT002" in done.stderr
    assert (folder / "right.rig.yaml").read_text("utf-8") == text


@pytest.mark.slow
def test_processes_of_a_real_command(folder: Path) -> None:
    one = animtool_process("validate", ".", "-j", "1", cwd=folder)
    two = animtool_process("validate", ".", "-j", "2", cwd=folder)
    assert one == two
    assert one.code == 1


def test_explain() -> None:
    done = animtool("explain", "rig201")
    assert done.code == 0
    assert done.stdout.startswith("# RIG201: limits that leave out the rest pose\n")
    listed = animtool("explain").stdout.splitlines()
    assert [line.split()[0] for line in listed] == sorted(builtin_rules())
    value = json.loads(animtool("explain", "RIG201", "--format", "json").stdout)
    assert value["rules"][0]["kind"] == "rig"


@pytest.mark.parametrize(
    ("rule", "said"),
    [
        (Rule("STU001", "a title"), "An error. Readers and commands report it."),
        (
            Rule("STU001", "a title", Severity.NOTE, Kind.USD),
            "A note. animtool validate looks for it in USD files.",
        ),
        (
            Rule("STU001", "a title", Severity.WARNING, Kind.CLIP),
            "A warning. animtool validate looks for it in clip files.",
        ),
    ],
)
def test_explain_a_code_without_a_page(
    rule: Rule, said: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("animtool.core.rules.find_rule", lambda _: rule)
    done = animtool("explain", "STU001")
    assert done.stdout == f"# STU001: a title\n\n## What\n\n{said}\n"


def test_a_code_that_is_none() -> None:
    done = animtool("explain", "RIF201")
    assert done.code == 2
    assert "did you mean 'RIG201'?" in done.stderr


MENDABLE = (
    "# one\nrig: animtool/1\nname: leg\njoints:\n"
    "- {name: 'k.l', type: pin, axis: [1, 0, 0], limits: [1, 9]}  # two\n"
)


@pytest.fixture
def mendable(tmp_path: Path) -> Path:
    path = tmp_path / "leg.rig.yaml"
    path.write_text(MENDABLE, "utf-8")
    return path


def test_what_can_be_mended_is_marked(mendable: Path) -> None:
    done = animtool("validate", mendable)
    assert done.stdout.endswith("1 file: 1 warning, 1 note, --fix repairs 1\n")
    value = json.loads(animtool("validate", mendable, "--format", "json").stdout)
    marks = {found["code"]: found["fixable"] for found in value["findings"]}
    assert marks == {"RIG201": False, "RIG221": True}


def test_a_difference_is_shown_and_nothing_written(mendable: Path) -> None:
    done = animtool("validate", mendable.name, "--diff", cwd=mendable.parent)
    assert done.code == 1
    assert done.stdout.splitlines()[:2] == ["--- a/leg.rig.yaml", "+++ b/leg.rig.yaml"]
    assert "-- {name: 'k.l', type" in done.stdout
    assert "+- {name: 'k_l', type" in done.stdout
    assert mendable.read_text("utf-8") == MENDABLE
    assert animtool("validate", mendable, "--diff", "--exit-zero").code == 0
    assert animtool("validate", mendable, "--diff", "--fix").code == 1
    assert animtool("validate", mendable, "--diff", "--format", "json").code == 2
    assert mendable.read_text("utf-8") == MENDABLE


def test_files_are_mended(mendable: Path) -> None:
    done = animtool("validate", mendable, "--fix")
    assert done.code == 0
    assert "RIG221 fixed: renames 1 name of joints: 'k.l' to 'k_l'" in done.stderr
    assert done.stdout.endswith("1 file: 1 warning\n")
    assert mendable.read_text("utf-8") == MENDABLE.replace("k.l", "k_l")
    again = animtool("validate", mendable, "--fix")
    report = json.loads(animtool("validate", mendable, "--format", "json").stdout)
    assert report["mended"] == []
    assert again.stdout == done.stdout
    assert again.stderr == ""
    shown = animtool("validate", mendable, "--diff")
    assert (shown.code, shown.stdout) == (0, "")


def test_what_was_mended_is_in_the_report(mendable: Path) -> None:
    done = animtool("validate", mendable, "--fix", "--format", "json")
    (entry,) = json.loads(done.stdout)["mended"]
    assert (entry["code"], entry["path"]) == ("RIG221", str(mendable))
    assert entry["done"] == "renames 1 name of joints: 'k.l' to 'k_l'"


def test_a_mended_file_may_still_have_faults(mendable: Path) -> None:
    done = animtool("validate", mendable, "--fix", "--strict")
    assert done.code == 1
    assert "k_l" in mendable.read_text("utf-8")


def test_why_a_finding_stays(mendable: Path) -> None:
    mendable.with_name("walk.clip.yaml").write_text("# k.l\n", "utf-8")
    done = animtool("validate", mendable, "--fix")
    assert "RIG221 not fixed: walk.clip.yaml also uses 'k.l'" in done.stderr
    assert mendable.read_text("utf-8") == MENDABLE


def test_a_file_that_must_not_be_written(mendable: Path) -> None:
    mendable.chmod(0o444)
    if os.access(mendable, os.W_OK):
        pytest.skip("this user may write to any file")
    done = animtool("validate", mendable, "--fix")
    assert done.code == 3
    assert "OUT002" in done.stderr


HERO = """\
rig: animtool/1
name: hero
joints:
- {name: hips, type: free}
- {name: knee, parent: hips, type: pin, axis: [1, 0, 0], limits: [10, 150]}
"""


def test_the_reference_shows_what_is_said(root: Path, tmp_path: Path) -> None:
    (tmp_path / "hero.rig.yaml").write_text(HERO, "utf-8")
    said = animtool("validate", "hero.rig.yaml", cwd=tmp_path).stdout
    page = root / "animtool/docs/reference/checking.md"
    assert f"\n```\n{said}```\n" in page.read_text("utf-8")


def test_a_report_of_a_name_that_is_no_text(tmp_path: Path) -> None:
    try:
        (tmp_path / os.fsdecode(b"a\xff.rig.yaml")).write_text(WRONG, "utf-8")
    except OSError:
        pytest.skip("this file system has no such names")
    for form in FORMATS:
        animtool(
            "validate", ".", "--format", form, "--output-file", "report", cwd=tmp_path
        )
        assert "DOC020" in (tmp_path / "report").read_text("utf-8")


def test_a_glob_that_matches_no_file_is_named(tmp_path: Path) -> None:
    (tmp_path / "rigs").mkdir()
    (tmp_path / "rigs/a.rig.yaml").write_text(
        "rig: animtool/1\nname: a\njoints: [{name: a, type: free}]\n", "utf-8"
    )
    done = animtool("validate", "rigz/*.rig.yaml", "rigs", cwd=tmp_path)
    assert done.code == 0, done.stderr
    assert "warning: VAL010 no file to check in 'rigz/*.rig.yaml'" in done.stderr
    assert "did you mean the folder 'rigs'?" in done.stderr
    assert "VAL010" not in animtool("validate", "rigs", cwd=tmp_path).stderr
    given = ("validate", "rigs", "rigz/*.rig.yaml")
    assert animtool(*given, cwd=tmp_path).code == 0
    assert animtool(*given, "--strict", cwd=tmp_path).code == 1
    assert animtool(*given, "--strict", "--ignore", "VAL010", cwd=tmp_path).code == 0


def test_a_difference_shows_the_findings_that_stay(mendable: Path) -> None:
    done = animtool("validate", mendable, "--diff")
    assert done.code == 1
    assert "RIG201" in done.stderr
    assert "RIG221" not in done.stderr
    assert "nothing to change" not in done.stderr
    text = MENDABLE.replace("limits: [1, 9]", "limits: [9, 1]")
    mendable.write_text(text, "utf-8")
    done = animtool("validate", mendable, "--diff")
    assert (done.code, done.stdout) == (1, "")
    assert "RIG007" in done.stderr
    assert "nothing to change" in done.stderr


def test_findings_of_motion_have_their_frame_and_joint(tmp_path: Path) -> None:
    rows = np.zeros((24, 9))
    rows[:, 6] = np.linspace(0, 4, 24)
    rows[12:, 6] += 120
    path = tmp_path / "pop.bvh"
    path.write_text(small_bvh(rows))
    done = animtool("validate", path, "--format", "json")
    found = [f for f in json.loads(done.stdout)["findings"] if f["joint"]]
    assert {(f["joint"], f["frame"]) for f in found} >= {("Spine", 12.0)}
