"""The scripts of the wheels workflow: bounds, floors, tags and the subset."""

from __future__ import annotations

import json
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest
from wheels import floors, lowest, subset, tag

FLOORS = tomllib.loads(floors.FLOORS.read_text("utf-8"))["floors"]


def test_lower_bounds_are_constraints() -> None:
    project = {
        "dependencies": ["numpy>=1.26", "usd-core >= 25.11"],
        "optional-dependencies": {
            "test": ["numpy>=1.26", "otio>=0.17; python_version < '3.14'", "types-a"],
            "other": ["scipy>=1.13"],
        },
    }
    assert list(lowest.constraints(project, ["test"])) == [
        "numpy==1.26",
        "usd-core==25.11",
        "otio==0.17; python_version < '3.14'",
    ]


@pytest.mark.parametrize("extra", ["numpy", "numpy<2", "numpy>=1.25"])
def test_a_missing_or_second_bound_is_refused(extra: str) -> None:
    project = {
        "dependencies": ["numpy>=1.26"],
        "optional-dependencies": {"test": [extra]},
    }
    with pytest.raises(ValueError, match="lower bound"):
        list(lowest.constraints(project, ["test"]))


def test_every_dependency_has_a_lower_bound() -> None:
    project = tomllib.loads(lowest.PYPROJECT.read_text("utf-8"))["project"]
    extras = list(project["optional-dependencies"])
    assert "usd-core==" in "\n".join(lowest.constraints(project, extras))


def file_report(covered: int, statements: int) -> dict[str, object]:
    return {"summary": {"covered_lines": covered, "num_statements": statements}}


def test_coverage_counts_by_package() -> None:
    report = {
        "files": {
            "animtool/core/files/reading.py": file_report(1, 2),
            "/env/lib/python3.11/site-packages/animtool/usd/a.py": file_report(9, 10),
            "D:\\animtool\\lib\\animtool\\usd\\checks\\b.py": file_report(0, 10),
            "animtool/edit/__init__.py": file_report(0, 0),
            "elsewhere/c.py": file_report(0, 1),
        }
    }
    assert floors.by_package(report) == {"core": 50.0, "usd": 45.0}


def test_what_is_below_its_floor_or_has_none_fails(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    files = {
        f"animtool/{package}/a.py" if package != "animtool" else "animtool/a.py": floor
        for package, floor in FLOORS.items()
    }
    report = tmp_path / "coverage.json"

    def code(shares: dict[str, float]) -> int:
        found = {name: file_report(int(share), 100) for name, share in shares.items()}
        report.write_text(json.dumps({"files": found}), "utf-8")
        return floors.main([str(report)])

    assert code(files) == 0
    assert code({**files, "animtool/usd/a.py": FLOORS["usd"] - 1}) == 1
    assert "usd: " in capsys.readouterr().err
    assert code({**files, "animtool/new/a.py": 100}) == 1
    del files["animtool/ik/a.py"]
    assert code(files) == 1
    assert "ik: not measured" in capsys.readouterr().err


def test_every_package_has_a_floor(root: Path) -> None:
    packages = {
        path.parent.name
        for path in (root / "animtool").glob("*/__init__.py")
        if path.parent.name not in {"docs", "kernels"}
    }
    assert set(FLOORS) == packages | {"animtool"}


RELEASE = [
    "animtool-1.2.0.tar.gz",
    *(
        f"animtool-1.2.0-{python}-{platform}.whl"
        for python in tag.PYTHONS
        for platform in (
            "manylinux_2_28_x86_64",
            "manylinux_2_27_aarch64.manylinux_2_28_aarch64",
            "macosx_13_3_arm64",
            "win_amd64",
        )
    ),
]


def test_a_release_is_whole_and_of_one_version() -> None:
    assert tag.disagreements("v1.2.0", "1.2.0", RELEASE) == []
    assert len(tag.disagreements("v1.2.1", "1.2.0", RELEASE)) == 1
    assert len(tag.disagreements("v1.2.0", "1.2.0", RELEASE[1:])) == 1
    assert len(tag.disagreements("v1.2.0", "1.2.0", RELEASE[:-1])) == 1
    other = [*RELEASE, "animtool-1.1.0-cp312-abi3-win_amd64.whl"]
    assert tag.disagreements("v1.2.0", "1.2.0", other) == [
        "animtool-1.1.0-cp312-abi3-win_amd64.whl: not a file of version 1.2.0"
    ]


def test_the_wheels_built_are_those_published() -> None:
    settings = tomllib.loads(lowest.PYPROJECT.read_text("utf-8"))["tool"]
    assert settings["scikit-build"]["wheel"]["py-api"] == "cp312"
    tested = {name[:5] for name in settings["cibuildwheel"]["build"]}
    assert {python[:5] for python in tag.PYTHONS} <= tested
    assert "tests/wheels/subset.py" in settings["cibuildwheel"]["test-command"]


def test_the_subset_exists_and_is_not_run_on_the_sources(root: Path) -> None:
    for name in subset.SUBSET:
        assert list((root / "tests" / name).rglob("test_*.py")), name
    found = subprocess.run(
        [sys.executable, root / "tests/wheels/subset.py", "--collect-only"],
        capture_output=True,
        text=True,
        check=False,
        cwd=root,
        env={"PYTHONPATH": str(root)},
    )
    assert found.returncode == 1
    assert "is no installed wheel" in found.stderr
