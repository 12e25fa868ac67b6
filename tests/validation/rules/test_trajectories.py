"""Rules of marker files: each finds its fault, and nothing else."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from support.planted_markers import MARKERS, NEAR, sound

from animtool.core.errors import Severity
from animtool.core.rules import Kind
from animtool.formats.marker_files import write_markers
from animtool.motion.markers import Markers
from animtool.validation.run import find_files, validate
from animtool.validation.subjects.open import open_file

SUFFIXES = [".c3d", ".trc", ".npz"]


def found(markers: Markers, path: Path) -> set[str]:
    """Return the codes of warnings and errors about markers in a file."""
    write_markers(markers, path, overwrite=True)
    return {f.code for f in validate(path) if f.severity is not Severity.NOTE}


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_a_sound_file(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"take{suffix}"
    assert found(sound(), path) == set()
    assert open_file(path).kind is Kind.TRAJECTORIES


@pytest.mark.parametrize("code", MARKERS)
def test_a_planted_fault_is_found(tmp_path: Path, code: str) -> None:
    path = tmp_path / "take.c3d"
    assert found(MARKERS[code](sound()), path) == {code}
    assert found(NEAR[code](sound()), path) == set()


@pytest.mark.parametrize(("factor", "unit"), [(1000.0, "mm"), (0.001, "m")])
def test_the_likely_unit_is_named(tmp_path: Path, factor: float, unit: str) -> None:
    path = tmp_path / "take.trc"
    markers = sound()
    scaled = replace(markers, positions=factor * markers.positions)
    write_markers(scaled, path, overwrite=True)
    [fault] = [fault for fault in validate(path) if fault.code == "MKR204"]
    assert f'unit="{unit}":' in str(fault)


def test_what_the_reader_refuses_is_a_finding(tmp_path: Path) -> None:
    cases = {
        "a.c3d": (b"\x02\x50" + b"\0" * 600, "C3D"),
        "a.trc": (b"nonsense", "TRC001"),
        "a.npz": (b"PK", ""),
        "a.mot": (b"nonsense", "MOF001"),
    }
    for name, (content, code) in cases.items():
        (tmp_path / name).write_bytes(content)
        (fault,) = validate(tmp_path / name)
        assert fault.code.startswith(code)
        assert fault.severity is Severity.ERROR


def test_an_npz_that_holds_something_else(tmp_path: Path) -> None:
    np.savez(tmp_path / "body.npz", points=np.zeros((4, 3)))
    (fault,) = validate(tmp_path / "body.npz")
    assert fault.severity is Severity.ERROR


def test_folders_are_searched_for_what_holds_markers_alone(tmp_path: Path) -> None:
    for name in ("a.c3d", "b.trc", "c.npz", "d.csv", "e.mot"):
        (tmp_path / name).touch()
    assert [path.name for path in find_files([tmp_path])] == ["a.c3d", "b.trc"]


def test_a_mot_file(tmp_path: Path) -> None:
    path = tmp_path / "ik.mot"
    path.write_text("nRows=9\nendheader\ntime\ta\n0\t1\n.1\tnan\n")
    codes = [fault.code for fault in validate(path)]
    assert sorted(codes) == ["MOF101", "MOF104", "MOF106", "MOF107"]
    assert open_file(path).kind is Kind.COORDINATES
