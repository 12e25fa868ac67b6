"""Validation: what counts, in which order, whatever the number of processes."""

from __future__ import annotations

from pathlib import Path

import pytest

import animtool
from animtool.core.errors import (
    ExitCode,
    FormatError,
    NoMatchError,
    OptionError,
    Severity,
)
from animtool.core.rules import Rule, builtin_rules
from animtool.validation.options import ValidateOptions
from animtool.validation.run import find_files, validate, validate_files
from animtool.validation.testing import check_rule

KNEE = """\
rig: animtool/1
name: leg
joints:
- {name: knee, type: pin, axis: [1, 0, 0], limits: [10, 150]}
- {name: ankle, parent: knee, type: pin, axis: [1, 0, 0], limits: [0, 0]}
"""
FOUND = ["RIG201", "RIG202"]


@pytest.fixture
def leg(tmp_path: Path) -> Path:
    path = tmp_path / "leg.rig.yaml"
    path.write_text(KNEE, "utf-8")
    return path


def codes(path: Path, **options: object) -> list[str]:
    found = validate(path, ValidateOptions(**options))  # type: ignore[arg-type]
    return [fault.code for fault in found]


def test_findings_have_places(leg: Path) -> None:
    first, second = animtool.validate(leg)
    assert (first.path, first.lines, first.column) == (str(leg), (4,), 52)
    assert (first.where, first.severity) == ("joints[0].limits", Severity.WARNING)
    assert second.lines == (5,)
    assert animtool.Finding is animtool.Fault


@pytest.mark.parametrize(
    ("options", "left"),
    [
        ({"select": ("RIG202",)}, ["RIG202"]),
        ({"select": ("CLIP",)}, []),
        ({"ignore": ("RIG2",)}, []),
        ({"ignore": ("RIG2",), "select": ("RIG202",)}, ["RIG202"]),
        ({"ignore": ("RIG202",), "select": ("RIG2",)}, ["RIG201"]),
        ({"ignore": ("RIG",), "select": ("RIG",)}, []),
    ],
)
def test_select_and_ignore(
    leg: Path, options: dict[str, object], left: list[str]
) -> None:
    assert codes(leg, **options) == left


def test_severities(leg: Path) -> None:
    given = {"RIG": Severity.ERROR, "RIG202": Severity.NOTE}
    found = validate(leg, ValidateOptions(severity=given))
    assert [fault.severity for fault in found] == [Severity.ERROR, Severity.NOTE]


@pytest.mark.parametrize("key", ["select", "ignore"])
def test_codes_that_there_are_none_of(leg: Path, key: str) -> None:
    with pytest.raises(OptionError) as error:
        codes(leg, **{key: ("RIGG",)})
    assert [(f.code, f.where) for f in error.value.faults] == [("VAL005", key)]


def test_codes_in_any_case(leg: Path) -> None:
    assert codes(leg, ignore=("rig201",)) == codes(leg, ignore=("RIG201",))
    levels = {"rig": Severity.ERROR, "Rig202": Severity.NOTE}
    found = validate(leg, ValidateOptions(severity=levels))
    assert [fault.severity for fault in found] == [Severity.ERROR, Severity.NOTE]


def test_exit_codes(leg: Path, tmp_path: Path) -> None:
    report = validate_files([leg])
    assert report.exit_code() is ExitCode.OK
    assert report.exit_code(strict=True) is ExitCode.FINDINGS
    assert report.exit_code(strict=True, exit_zero=True) is ExitCode.OK
    wrong = validate_files([leg], ValidateOptions(severity={"RIG": Severity.ERROR}))
    assert wrong.exit_code() is ExitCode.FINDINGS
    away = validate_files([leg, tmp_path / "none.rig.yaml"])
    assert away.exit_code(exit_zero=True) is ExitCode.MALFORMED


def test_what_cannot_be_read_always_counts(tmp_path: Path) -> None:
    files = [tmp_path / "none.rig.yaml"]
    report = validate_files(files, ValidateOptions(select=("RIG2",)))
    assert report.exit_code(exit_zero=True) is ExitCode.MALFORMED


@pytest.mark.slow
def test_errors_of_other_processes_come_back(leg: Path) -> None:
    text = leg.with_name("a.txt")
    text.touch()
    with pytest.raises(OptionError) as error:
        validate([leg, text], ValidateOptions(jobs=2))
    assert [fault.code for fault in error.value.faults] == ["IO002"]


def test_what_is_odd_about_a_rig_is_not_said_of_its_clip(leg: Path) -> None:
    parent = "- {name: knee, type: free, translate: [0.1, 0, 0]}\n"
    arms = "- {name: a_l, parent: knee, type: ball, mirror: a_r}\n"
    leg.write_text("rig: animtool/1\nname: leg\njoints:\n" + parent + arms, "utf-8")
    clip = leg.with_name("walk.clip.yaml")
    clip.write_text("clip: animtool/1\nrig: leg.rig.yaml\nfps: 24\nrange: [1, 2]\n")
    assert codes(clip) == []
    assert codes(leg) == ["RIG101"]


def test_syntax_is_a_finding(leg: Path) -> None:
    leg.write_text("rig: [", "utf-8")
    report = validate_files([leg])
    assert [fault.code for fault in report.findings] == ["DOC001"]
    assert report.exit_code() is ExitCode.FINDINGS


@pytest.mark.parametrize(
    ("name", "text"),
    [
        (
            "animtool.toml",
            "[validate]\nignore = ['RIG202']\nseverity = {RIG = 'error'}",
        ),
        (
            "pyproject.toml",
            "[tool.animtool.validate]\nignore = ['RIG202']\nseverity.RIG = 'error'",
        ),
    ],
)
def test_settings_of_a_project(leg: Path, name: str, text: str) -> None:
    (leg.parent / name).write_text(text, "utf-8")
    (found,) = validate(leg)
    assert (found.code, found.severity) == ("RIG201", Severity.ERROR)
    for code in ("RIG201", "RIG"):
        note = ValidateOptions(severity={code: Severity.NOTE})
        assert validate(leg, note)[0].severity is Severity.NOTE
    assert codes(leg, ignore=("RIG201",)) == []
    assert codes(leg, select=("RIG201",)) == ["RIG201"]


@pytest.mark.parametrize(
    ("text", "code"),
    [
        ("validate = 1", "CFG003"),
        ("[validate]\nselct = []", "CFG002"),
        ("[validate]\nselect = 'RIG'", "CFG003"),
        ("[validate]\nseverity = ['RIG']", "CFG003"),
        ("[validate]\nseverity = {RIG = 'bad'}", "CFG003"),
        ("[validate]\nignore = ['RIGG']", "VAL005"),
    ],
)
def test_settings_that_are_malformed(leg: Path, text: str, code: str) -> None:
    (leg.parent / "animtool.toml").write_text(text, "utf-8")
    with pytest.raises(OptionError) as error:
        validate(leg)
    assert error.value.code == code


@pytest.mark.parametrize(
    ("entries", "left"),
    [
        (["{code: RIG201, why: crouched}"], ["RIG202"]),
        (['{code: RIG201, where: "joints[0].limits", why: crouched}'], ["RIG202"]),
        (['{code: RIG201, where: "joints[knee]", why: crouched}'], ["RIG202"]),
        (['{code: RIG201, where: "joints[k*]", why: crouched}'], ["RIG202"]),
        (
            ['{code: RIG201, where: "joints[1]", why: no}'],
            ["RIG201", "RIG202", "VAL001"],
        ),
        (["{code: RIG201, why: a}", "{code: RIG202, why: b}"], []),
        (["{code: CLIP201, why: no}"], ["RIG201", "RIG202", "VAL001"]),
        (["{code: RIG2, why: no}"], ["RIG201", "RIG202", "VAL002"]),
        (["{code: RIG201}"], ["DOC021"]),
        (["{code: RIG201, why: ''}"], ["DOC022"]),
    ],
)
def test_ignores_in_a_file(leg: Path, entries: list[str], left: list[str]) -> None:
    lines = "".join(f"- {entry}\n" for entry in entries)
    leg.write_text(f"{KNEE}ignore:\n{lines}", "utf-8")
    assert sorted(codes(leg)) == left


def test_an_entry_that_hides_nothing_is_a_warning(leg: Path) -> None:
    leg.write_text(f"{KNEE}ignore:\n- {{code: CLIP201, why: no}}\n", "utf-8")
    (unused,) = validate(leg, ValidateOptions(select=("VAL001",)))
    assert unused.severity is Severity.WARNING
    leg.write_text(f"{KNEE}ignore:\n- {{code: RIG2, why: no}}\n", "utf-8")
    (unknown,) = validate(leg, ValidateOptions(select=("VAL002",)))
    assert unknown.severity is Severity.ERROR


def test_strict_takes_no_notes_for_errors(leg: Path) -> None:
    report = validate_files([leg], ValidateOptions(severity={"RIG": Severity.NOTE}))
    assert report.count(Severity.NOTE) == len(report.findings) > 0
    assert report.exit_code(strict=True) is ExitCode.OK


def test_a_rig_reached_twice_is_said_once(
    leg: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    leg.write_text(KNEE.replace("type: pin", "type: pni", 1), "utf-8")
    clip = leg.with_name("walk.clip.yaml")
    clip.write_text("clip: animtool/1\nrig: leg.rig.yaml\nfps: 24\nrange: [1, 2]\n")
    monkeypatch.chdir(leg.parent)
    found = validate(["walk.clip.yaml", "leg.rig.yaml"])
    assert [(fault.code, fault.path) for fault in found] == [("DOC022", "leg.rig.yaml")]
    assert validate("walk.clip.yaml") == found


def test_a_name_with_a_null_byte() -> None:
    with pytest.raises(FormatError) as caught:
        find_files(["a\0b.bvh"])
    assert caught.value.code == "IO001"


@pytest.mark.slow
def test_processes_do_not_matter(leg: Path) -> None:
    for i in range(5):
        leg.with_name(f"leg{i}.rig.yaml").write_text(KNEE, "utf-8")
    files = find_files([leg.parent])
    assert len(files) == 6
    one = validate_files(files)
    assert one == validate_files(files, ValidateOptions(jobs=2))
    assert len(one.findings) == 12


def test_which_files(leg: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(leg.parent)
    for name in ("a/b/walk.bvh", "a/.old/walk.bvh", "a/x.yaml", "a/run.clip.json"):
        Path(name).parent.mkdir(parents=True, exist_ok=True)
        Path(name).touch()
    named = [path.as_posix() for path in find_files(["."])]
    assert named == ["a/b/walk.bvh", "a/run.clip.json", "leg.rig.yaml"]
    globbed = find_files(["**/*.bvh", "a/*.json", "a/b/walk.bvh", "x.rig.yaml"])
    shown = [path.as_posix() for path in globbed]
    assert shown[-3:] == ["a/b/walk.bvh", "a/run.clip.json", "x.rig.yaml"]
    assert [path.as_posix() for path in find_files(["**/.old/*.bvh"])] == [
        "a/.old/walk.bvh"
    ]
    odd = Path("a[1].rig.yaml")
    odd.touch()
    assert find_files([odd]) == [odd]
    with pytest.raises(NoMatchError) as error:
        find_files(["a/b/*.usd"])
    assert error.value.exit_code is ExitCode.NOTHING_MATCHED


@pytest.mark.parametrize("name", ["rigs", "hero.txt", "hero.rig.yaml"])
def test_what_is_not_there_is_told_so_whatever_its_name(
    tmp_path: Path, name: str
) -> None:
    (fault,) = validate(tmp_path / name)
    assert fault.code == "IO001"


def test_an_empty_name_means_no_folder(
    leg: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(leg.parent)
    assert validate([leg.name, ""]) == validate([leg.name])
    with pytest.raises(NoMatchError):
        find_files([""])


def test_a_kind_that_is_not_checked(tmp_path: Path) -> None:
    (tmp_path / "a.txt").touch()
    with pytest.raises(OptionError) as error:
        validate(tmp_path / "a.txt")
    assert error.value.code == "IO002"


def _fails(_: object) -> list[object]:
    raise ZeroDivisionError("no joints")


def test_a_rule_that_fails(leg: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(
        "animtool.validation.rules.rig_joints.motionless_joints", _fails
    )
    found = validate(leg)
    assert [fault.code for fault in found] == ["VAL003", "RIG201"]
    assert "RIG202 failed: ZeroDivisionError" in found[0].message


def test_the_kit_for_rules(leg: Path) -> None:
    good = leg.with_name("good.rig.yaml")
    good.write_text(KNEE.replace("[10, 150]", "[0, 150]"), "utf-8")
    rule = builtin_rules()["RIG201"]
    assert len(check_rule(rule, leg, good)) == 1
    with pytest.raises(AssertionError, match="false alarm"):
        check_rule(rule, leg, leg)
    with pytest.raises(AssertionError, match="finds nothing"):
        check_rule(rule, good, good)
    other = Rule("STU001", "another", kind=rule.kind, check=rule.check)
    with pytest.raises(AssertionError, match="reports RIG201"):
        check_rule(other, leg, good)


def test_scenes_and_targets(root: Path, tmp_path: Path) -> None:
    walk = (root / "samples/walk/walk.bvh").read_bytes()
    (tmp_path / "walk.bvh").write_bytes(walk)
    scene = tmp_path / "shot.scene.yaml"
    scene.write_text("scene: animtool/1\nsource: {file: walk.bvh}\n", "utf-8")
    assert codes(scene) == []
    more = "passes: [{trim: {first: 900}}]\n"
    scene.write_text(scene.read_text("utf-8") + more, "utf-8")
    assert codes(scene) == ["SCN013"]
    targets = tmp_path / "feet.targets.yaml"
    targets.write_text("targets: animtool/1\ngoals: [{effector: foot_l}]\n", "utf-8")
    assert codes(targets) == ["TGT002"]


def test_usd_layers(tmp_path: Path) -> None:
    layer = tmp_path / "shot.usda"
    text = "#usda 1.0\n(\n    startTimeCode = 9\n    endTimeCode = 1\n)\n"
    layer.write_text(text, "utf-8")
    (found,) = validate(layer, ValidateOptions(select=("USD254",)))
    assert (found.path, found.severity) == (str(layer), Severity.ERROR)


def test_an_empty_path_and_folders_within_a_name() -> None:
    with pytest.raises(NoMatchError) as empty:
        find_files([""])
    assert [fault.code for fault in empty.value.faults] == ["VAL006"]
    with pytest.raises(FormatError) as caught:
        find_files(["shots/**.bvh"])
    (fault,) = caught.value.faults
    assert (fault.code, fault.hint) == ("IO001", "write 'shots/**/*.bvh'")
