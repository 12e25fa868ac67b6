"""Our checks inside of `pxr.UsdValidation`: by a plug-in's file, and in Python."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

import animtool.usd.checks as package

BAD = """\
#usda 1.0
(
    defaultPrim = "A"
    metersPerUnit = 1
    upAxis = "Y"
)
def SkelAnimation "A" {
    uniform token[] joints = ["a"]
    quatf[] rotations = [(2, 0, 0, 0)]
    half3[] scales = [(1, 1, 1)]
    float3[] translations = [(0, 0, 0)]
}
"""
ASK = """\
import json, sys
from pxr import Usd, UsdValidation
{before}
registry = UsdValidation.ValidationRegistry()
context = UsdValidation.ValidationContext(registry.GetOrLoadAllValidators())
stage = Usd.Stage.Open(sys.argv[1])
found = context.Validate(stage)
print(json.dumps([
    [error.GetIdentifier(), str(error.GetSites()[0].GetProperty().GetPath())]
    for error in found
]))
from animtool.usd.checks import check_layer
print(json.dumps([fault.code for fault in check_layer(sys.argv[1])]))
"""


def asked(folder: Path, before: str = "", plugins: str = "") -> list[list[object]]:
    """Return what UsdValidation, and then ours, find in a process of their own."""
    path = folder / "bad.usda"
    path.write_text(BAD, "utf-8")
    done = subprocess.run(
        [sys.executable, "-P", "-c", ASK.format(before=before), str(path)],
        env={**os.environ, "PXR_PLUGINPATH_NAME": plugins},
        capture_output=True,
        text=True,
        check=True,
    )
    return [json.loads(line) for line in done.stdout.splitlines()]


@pytest.mark.slow
def test_usd_loads_our_validator_by_its_plug_in_file(tmp_path: Path) -> None:
    theirs, ours = asked(tmp_path, plugins=package.__path__[0])
    name = "animtool.usd.checks.plugin:Checks.USD203"
    assert theirs == [[name, "/A.rotations"]]
    assert ours == ["USD203"]


@pytest.mark.slow
def test_our_validator_registers_in_python(tmp_path: Path) -> None:
    before = "from animtool.usd.checks.plugin import register\nregister(); register()"
    theirs, ours = asked(tmp_path, before)
    assert theirs == [["animtool:Checks.USD203", "/A.rotations"]]
    assert ours == ["USD203"]


@pytest.mark.slow
def test_without_either_usd_finds_nothing(tmp_path: Path) -> None:
    assert asked(tmp_path) == [[], ["USD203"]]
