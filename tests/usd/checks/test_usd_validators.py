"""What USD's own validators find gets a code of ours, with the prim."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest
from pxr import Sdf, UsdValidation

from animtool.core.errors import Fault
from animtool.usd.checks import check_layer

HEAD = """\
#usda 1.0
(
    defaultPrim = "A"
    metersPerUnit = 1
    upAxis = "Y"
    kilogramsPerUnit = 1
)
"""
BROKEN = {
    "USD280": (
        'def Mesh "A"\n{{\n{} points\n}}\n',
        "float[]",
        "point3f[]",
        "/A.points",
    ),
    "USD283": (
        'def {} "A"\n{{\ndef SphereLight "B"\n{{\n}}\n}}\n',
        "Shader",
        "Scope",
        "/A/B",
    ),
    "USD284": (
        'def Xform "A" (\nprepend apiSchemas = ["PhysicsRigidBodyAPI", '
        '"PhysicsMassAPI"]\n)\n{{\nfloat3 physics:{} = (1, 1, 1)\n}}\n',
        "diagonalInertia",
        "velocity",
        "/A",
    ),
}


def found(folder: Path, text: str) -> list[Fault]:
    path = folder / "a.usda"
    path.write_text(HEAD + text, "utf-8")
    return check_layer(path)


@pytest.mark.parametrize("code", BROKEN)
def test_a_finding_of_usd_names_its_validator_and_the_prim(
    code: str, tmp_path: Path
) -> None:
    template, bad, good, where = BROKEN[code]
    faults = found(tmp_path, template.format(bad))
    names = {
        m.name for m in UsdValidation.ValidationRegistry().GetAllValidatorMetadata()
    }
    mine = [fault for fault in faults if fault.code == code]
    assert {fault.where for fault in mine} == {where}
    assert ":".join(mine[0].message.split(":")[:2]) in names
    (tmp_path / "good").mkdir()
    assert code not in {f.code for f in found(tmp_path / "good", template.format(good))}


def test_a_package_with_a_foreign_file_is_found(tmp_path: Path) -> None:
    inner = tmp_path / "a.usda"
    inner.write_text(HEAD + 'def Scope "A" {}', "utf-8")
    (tmp_path / "notes.txt").write_text("notes", "utf-8")
    for names, wanted in ((["a.usda"], False), (["a.usda", "notes.txt"], True)):
        path = tmp_path / f"{len(names)}.usdz"
        with Sdf.ZipFileWriter.CreateNew(str(path)) as writer:
            for name in names:
                writer.AddFile(str(tmp_path / name), name)
        assert ("USD285" in {fault.code for fault in check_layer(path)}) is wanted


@pytest.mark.slow
def test_a_validator_of_another_plug_in_has_a_code(tmp_path: Path) -> None:
    """In a process of its own: a validator stays registered."""
    path = tmp_path / "a.usda"
    path.write_text(HEAD + 'def Scope "A" {}', "utf-8")
    script = """
import sys
from pxr import Sdf, UsdValidation as V
from animtool.usd.checks import check_layer
metadata = V.ValidatorMetadata(name="studio:Names", doc="names")
def check(stage, times):
    site = V.ValidationErrorSite(stage, Sdf.Path("/A"))
    kind = V.ValidationErrorType.Info
    return [V.ValidationError("Short", kind, [site], "A is short.")]
print(*check_layer(sys.argv[1]))
V.ValidationRegistry().RegisterStageValidator(metadata, check)
print(*check_layer(sys.argv[1]))
"""
    done = subprocess.run(
        [sys.executable, "-P", "-c", script, str(path)],
        capture_output=True,
        text=True,
        check=True,
    )
    before, after = done.stdout.splitlines()
    assert before == ""
    assert after.startswith(f"{path}: note: USD286 /A: studio:Names: A is short")
