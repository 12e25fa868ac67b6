"""Severity profiles: by name, from a file, from settings, and by a file's content."""

from __future__ import annotations

from pathlib import Path

import pytest
from support.cli import animtool

from animtool.core.errors import OptionError, Severity
from animtool.core.rules import builtin_rules
from animtool.validation.fixes.run import fix_copy
from animtool.validation.options import ValidateOptions
from animtool.validation.profiles import PROFILES, load_profile
from animtool.validation.run import validate

# A foreign stage: no metadata, no extent, weights that do not sum to one.
STAGE = """\
#usda 1.0
(
    startTimeCode = 1
    endTimeCode = 2
)
{} "hero"
{{
    def SkelRoot "Rig"
    {{
        def SkelAnimation "Anim"
        {{
            uniform token[] joints = ["a"]
            float3[] translations = [(0, 0, 0)]
            quatf[] rotations.timeSamples = {{
                1: [(1, 0, 0, 0)],
                2: [(0.8, 0.6, 0, 0)],
            }}
            half3[] scales = [(1, 1, 1), (1, 1, 1)]
        }}
        def Mesh "one"
        {{
            int[] faceVertexCounts = [3]
            int[] faceVertexIndices = [0, 1, 2]
            point3f[] points = [(0, 0, 0), (1, 0, 0), (0, 1, 0)]
        }}
        def Mesh "two"
        {{
            int[] faceVertexCounts = [3]
            int[] faceVertexIndices = [0, 1, 2]
            point3f[] points = [(0, 0, 0), (1, 0, 0), (0, 1, 0)]
        }}
    }}
}}
"""


@pytest.fixture
def stage(tmp_path: Path) -> Path:
    path = tmp_path / "hero.usda"
    path.write_text(STAGE.format("def Xform"), "utf-8")
    return path


@pytest.fixture
def layer(tmp_path: Path) -> Path:
    path = tmp_path / "anim.usda"
    text = STAGE.replace('    def SkelRoot "Rig"', '    over "Rig"')
    path.write_text(text.format("over"), "utf-8")
    return path


def severities(path: Path, profile: str = "") -> dict[str, Severity]:
    options = ValidateOptions(profile=profile)
    return {fault.code: fault.severity for fault in validate(path, options)}


def test_a_profile_has_codes_that_there_are() -> None:
    for profile in PROFILES.values():
        assert profile.about
        for code in profile.levels:
            assert any(known.startswith(code) for known in builtin_rules()), code


def test_by_default_each_rule_has_its_own_severity(stage: Path) -> None:
    found = severities(stage)
    assert found["USD200"] is Severity.ERROR
    assert found["USD250"] is Severity.WARNING
    assert {"USD258", "USD259"} <= set(found)
    assert severities(stage, "default") == found


def test_an_asset_must_state_its_metadata(stage: Path) -> None:
    assert severities(stage, "asset")["USD259"] is Severity.ERROR


def test_errors_in_a_file_of_a_vendor_are_no_errors(stage: Path) -> None:
    found = severities(stage, "vendor")
    assert set(found) == set(severities(stage))
    assert Severity.ERROR not in found.values()
    assert found["USD200"] is Severity.WARNING
    assert found["USD258"] is Severity.NOTE


def test_a_layer_is_recognised(layer: Path) -> None:
    found = severities(layer)
    assert not {"USD258", "USD259"} & set(found)
    assert "USD200" in found
    assert {"USD258", "USD259"} <= set(severities(layer, "default"))


def test_fixes_leave_what_the_profile_of_a_layer_leaves_out(layer: Path) -> None:
    copy = layer.with_name("copy.usda")
    fixes = fix_copy(layer, copy)
    assert "USD259" not in {fault.code for fault, _ in fixes.report.mended}
    assert "defaultPrim" not in copy.read_text("utf-8")
    fixes = fix_copy(layer, copy, ValidateOptions(profile="default"), overwrite=True)
    assert "USD259" in {fault.code for fault, _ in fixes.report.mended}


def test_fixes_leave_what_a_profile_of_a_file_leaves_out(
    layer: Path, tmp_path: Path
) -> None:
    profile = tmp_path / "own.yaml"
    profile.write_text("severity: {USD259: off}\n", "utf-8")
    options = ValidateOptions(profile=str(profile))
    fixes = fix_copy(layer, tmp_path / "copy.usda", options)
    assert "USD259" not in {fault.code for fault, _ in fixes.report.mended}


def test_a_shot_must_state_its_time(stage: Path) -> None:
    found = severities(stage, "shot")
    assert found["USD252"] is Severity.ERROR
    assert found["USD250"] is Severity.NOTE
    levels = PROFILES["shot"].levels
    left_out = {code for code, level in levels.items() if level is None}
    assert left_out == {"MOT221", "RIG209"}


def test_what_is_asked_for_is_above_a_profile(layer: Path) -> None:
    given = ValidateOptions(severity={"USD258": Severity.ERROR})
    found = {f.code: f.severity for f in validate(layer, given)}
    assert found["USD258"] is Severity.ERROR
    chosen = validate(layer, ValidateOptions(select=("USD258",)))
    assert {fault.code for fault in chosen} == {"USD258"}


YAML = "profile: animtool/1\nextends: vendor\nseverity: {USD200: error, USD25: off}\n"
TOML = 'extends = "vendor"\n[severity]\nUSD200 = "error"\nUSD25 = "off"\n'
SETTINGS = '[validate.severity]\nUSD200 = "warning"\n'


@pytest.mark.parametrize(
    ("name", "text"), [("studio.yaml", YAML), ("studio.toml", TOML)]
)
def test_a_profile_of_a_file(stage: Path, name: str, text: str) -> None:
    path = stage.with_name(name)
    path.write_text(text, "utf-8")
    found = severities(stage, str(path))
    assert found["USD200"] is Severity.ERROR
    assert not any(code.startswith("USD25") for code in found)


def test_severities_of_a_project_are_a_profile(stage: Path, tmp_path: Path) -> None:
    path = tmp_path / "studio/animtool.toml"
    path.parent.mkdir()
    path.write_text(SETTINGS, "utf-8")
    assert severities(stage, str(path))["USD200"] is Severity.WARNING


@pytest.mark.parametrize("level", ["off", "false", "'off'"])
def test_codes_are_left_out_in_capitals_or_not(tmp_path: Path, level: str) -> None:
    path = tmp_path / "own.yaml"
    path.write_text(f"severity: {{usd25: {level}, Usd200: note}}\n", "utf-8")
    assert load_profile(str(path)) == {"USD25": None, "USD200": Severity.NOTE}


def test_a_project_names_its_profile(stage: Path) -> None:
    stage.with_name("studio.yaml").write_text(YAML, "utf-8")
    settings = stage.with_name("animtool.toml")
    settings.write_text('[validate]\nprofile = "studio.yaml"\n', "utf-8")
    assert severities(stage)["USD200"] is Severity.ERROR
    assert severities(stage, "vendor")["USD200"] is Severity.WARNING
    settings.write_text("[validate]\nprofile = 3\n", "utf-8")
    with pytest.raises(OptionError) as error:
        validate(stage)
    assert error.value.code == "CFG003"


@pytest.mark.parametrize(
    ("text", "code"),
    [
        ("profile: animtool/2\n", "VAL008"),
        ("profile: animtool/1\nextend: vendor\n", "VAL008"),
        ("profile: animtool/1\nextends: vendors\n", "VAL008"),
        ("profile: animtool/1\nseverity: [USD250]\n", "VAL008"),
        ("profile: animtool/1\nseverity: {USD250: bad}\n", "VAL008"),
        ("profile: animtool/1\nseverity: {USB250: note}\n", "VAL005"),
        ("severity: {'': off}\n", "VAL005"),
        ("profile: [", "DOC001"),
    ],
)
def test_a_file_that_is_malformed(tmp_path: Path, text: str, code: str) -> None:
    path = tmp_path / "studio.yaml"
    path.write_text(text, "utf-8")
    with pytest.raises(OptionError) as error:
        load_profile(str(path))
    assert error.value.code == code
    assert error.value.faults[0].path == str(path)


def test_a_profile_that_there_is_none_of(stage: Path) -> None:
    with pytest.raises(OptionError) as error:
        load_profile("vendr")
    assert error.value.code == "VAL009"
    assert "vendor" in str(error.value)
    toml = stage.with_name("studio.toml")
    for text in ("= 1", f"a = {'[' * 10_000}"):
        toml.write_text(text, "utf-8")
        with pytest.raises(OptionError) as broken:
            load_profile(str(toml))
        assert broken.value.code == "VAL008"


def test_the_command_takes_one_and_prints_repeats_once(stage: Path) -> None:
    done = animtool("validate", stage, "--profile", "vendor")
    assert done.code == 0
    assert done.stdout.count("USD250") == 1
    assert "more like it, see -v" in done.stdout
    whole = animtool("validate", stage, "--profile", "vendor", "-v")
    assert whole.stdout.count("USD250") == 2
    assert "more like it" not in whole.stdout
    asked = animtool("validate", stage, "--profile", "vendor", "--format", "json")
    assert asked.stdout.count("USD250") == 2
    assert animtool("validate", stage).code == 1
    refused = animtool("validate", stage, "--profile", "vendr")
    assert refused.code == 2
    assert "VAL009" in refused.stderr
