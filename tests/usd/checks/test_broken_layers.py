"""Layers broken on purpose: what our checks find, beside `pxr.UsdValidation` alone."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

import pytest
from pxr import Sdf
from support.broken_usd import BROKEN, NEAR, Case, write_good
from support.suite import is_full, some_quick
from support.usd import open_stage, validation_errors

from animtool.core.errors import FormatError, Severity
from animtool.core.rules import builtin_rules
from animtool.usd.checks import check_layer
from animtool.usd.layers.sdf import open_layer
from animtool.usd.layers.stderr import without_usd_warnings

# Those of checks alone say what to do whatever the file is.
CODES = {code: rule for code, rule in builtin_rules().items() if rule.hint}

# What needs another file than the good one: see test_usd_validators.
ELSEWHERE = {"USD280", "USD283", "USD284", "USD285", "USD286"}


@pytest.fixture(scope="session")
def good(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("good")
    empty = Sdf.Layer.CreateAnonymous(".usda")
    empty.Export(str(folder / "empty.usda"))
    return write_good(folder)


def changed(case: Case, good: Path, folder: Path) -> Path:
    """Write the good layer with one change."""
    shutil.copytree(good.parent, folder, dirs_exist_ok=True)
    path = folder / "changed.usda"
    (folder / good.name).rename(path)
    with without_usd_warnings():
        layer = Sdf.Layer.FindOrOpen(str(path))
        case.change(layer)
        layer.Save()
    return path


def alone(path: Path) -> list[str]:
    """Return what USD's own validators find without ours."""
    with without_usd_warnings():
        try:
            return validation_errors(open_stage(path))
        except Exception as error:
            return [type(error).__name__]


def test_the_good_layer_has_no_finding(good: Path) -> None:
    assert check_layer(good) == []


@pytest.mark.parametrize("case", some_quick(BROKEN, 4), ids=lambda case: case.id)
def test_a_broken_layer_is_found(
    case: Case, good: Path, tmp_path: Path, record_property: Any
) -> None:
    path = changed(case, good, tmp_path)
    found = check_layer(path)
    mine = [fault for fault in found if fault.code == case.code]
    assert mine, [str(fault) for fault in found]
    if case.where:
        assert case.where in {fault.where for fault in mine}
    for fault in found:
        assert fault.path == str(path)
        assert fault.message
        assert fault.hint == CODES[fault.code].hint
        assert (fault.where or "").startswith("/")
    # It asserts nothing. Without a rate USD may never return.
    if not is_full() or case.code == "USD253":
        return
    theirs = alone(path)
    said = "; ".join(
        sorted({text.partition(":")[2].partition(":")[0] for text in theirs})
    )
    record_property(
        "broken USD layers: ours | pxr.UsdValidation alone",
        f"  {case.id:<46} {case.where or mine[0].where} | {said or '-'}",
    )


@pytest.mark.parametrize("case", some_quick(NEAR, 4, 1), ids=lambda case: case.id)
def test_a_near_miss_has_no_finding(case: Case, good: Path, tmp_path: Path) -> None:
    found = check_layer(changed(case, good, tmp_path))
    assert [str(fault) for fault in found if fault.code == case.code] == []


def test_every_code_has_a_broken_layer_and_a_near_miss() -> None:
    assert {case.code for case in BROKEN} == set(CODES) - ELSEWHERE
    assert {case.code for case in NEAR} == set(CODES) - ELSEWHERE
    assert len(BROKEN) >= 40


def test_a_layer_that_cannot_be_read_is_one_finding(tmp_path: Path) -> None:
    path = tmp_path / "nan.usda"
    text = '#usda 1.0\ndef "A" { double s.spline = { bezier, 1: nan, 5: 2 } }\n'
    path.write_text(text, "utf-8")
    found = check_layer(path)
    assert [fault.code for fault in found] == ["USD001"]
    assert found[0].severity is Severity.ERROR
    assert [fault.code for fault in check_layer(tmp_path / "no.usda")] == ["IO001"]


def test_all_layers_and_variants_are_searched_for_numbers(tmp_path: Path) -> None:
    (tmp_path / "below.usda").write_text(
        """#usda 1.0
        def "A" (
            prepend variantSets = "v"
            customData = {
                double[] a = [0, nan]
            }
        )
        {
            double x = 1
            variantSet "v" = {
                "one" {
                    def "B"
                    {
                        float y.timeSamples = {
                            1: 0,
                            2: inf,
                            3: nan,
                        }
                    }
                }
            }
        }
        """
    )
    values = "\n".join(f"float a{i} = nan" for i in range(9))
    (tmp_path / "top.usda").write_text(
        "#usda 1.0\n(subLayers = [@./below.usda@ (offset = nan)])\n"
        f'over "A" {{\n double x = 2\n}}\ndef "Many" {{\n{values}\n}}'
    )
    found = [f for f in check_layer(tmp_path / "top.usda") if f.code == "USD171"]
    said = {fault.where: fault.message for fault in found}
    assert said["/A{v=one}B.y"] == (
        "it is inf at time code 2, and in 1 more sample (in below.usda)"
    )
    assert said["/A"] == "its metadata customData:a is nan (in below.usda)"
    assert said["/"] == "its metadata subLayerOffsets[0] is nan"
    many = [where for where in said if str(where).startswith("/Many")]
    assert len(many) == 5
    assert said[many[-1]].endswith("so are 4 more values of this prim")


def test_a_text_file_of_ours_is_named(tmp_path: Path) -> None:
    """Its first key says what it is, whatever the suffix."""
    for name, hint in (
        ("a.usda", "rename it to a.yaml"),
        ("a.rig.yaml", "name a USD file; animtool convert writes one of a rig"),
    ):
        path = tmp_path / name
        path.write_text("rig: animtool/1\nname: a\n", "utf-8")
        with pytest.raises(FormatError) as caught:
            open_layer(path)
        (fault,) = caught.value.faults
        assert fault.code == "USD001"
        assert fault.message == "is an animtool file (YAML or JSON), not a USD file"
        assert str(fault.hint).startswith(hint)


@pytest.mark.parametrize(
    ("attribute", "value", "is_allowed"),
    [
        ("float3 physics:lowerLimit", "(-inf, -inf, -inf)", True),
        ("float physxCollision:contactOffset", "-inf", True),
        ("float newton:limitStiffness", "inf", True),
        ("float newton:limitStiffness", "nan", False),
        ("float primvars:physxMass", "inf", False),
    ],
)
def test_infinite_limits_of_physics_are_allowed(
    tmp_path: Path, attribute: str, value: str, is_allowed: bool
) -> None:
    """Schemas and engines use them for no limit, also where none is applied."""
    path = tmp_path / "joint.usda"
    joint = f'def PhysicsSphericalJoint "Ball"\n{{\n    {attribute} = {value}\n}}\n'
    path.write_text(f"#usda 1.0\n{joint}", "utf-8")
    found = {fault.code for fault in check_layer(path)}
    assert ("USD171" not in found) is is_allowed
