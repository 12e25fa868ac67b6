"""STO files of vectors: markers of their columns."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from support.cli import animtool
from support.faults import raises

from animtool.core.errors import FormatError
from animtool.formats.marker_files import is_marker_file, open_markers
from animtool.motion.markers import Markers

HEAD = "DataRate=100\nDataType=Vec3\nUnits=mm\nendheader\ntime\ta\tb\n"


def rows(*times: float) -> str:
    return "".join(f"{t:g}\t{1000 * t:g},2,3\tnan,nan,nan\n" for t in times)


def read(folder: Path, content: str) -> Markers:
    path = folder / "a.sto"
    path.write_text(content)
    assert is_marker_file(path)
    return open_markers(path)


def codes(markers: Markers) -> list[str]:
    return [each.code for each in markers.notices if each.code != "MKR103"]


@pytest.mark.parametrize(
    ("head", "times", "said", "found"),
    [
        (HEAD, (0, 0.01, 0.02), ["MOF111"], (3, 100, 1)),
        (HEAD.replace("=mm", ""), (0, 0.01), ["MOF111", "MKR104"], (2, 100, 1)),
        (HEAD, (0.5, 0.51, 0.55), ["MOF111", "MOF105"], (6, 100, 51)),
        (HEAD, (0, 0.02, 0.04), ["MOF111", "MOF101"], (3, 50, 1)),
        (HEAD, (0, 0.011, 0.019, 0.031), ["MOF111", "MOF105"], (4, 100, 1)),
        (HEAD, (0.03,), ["MOF111"], (1, 100, 4)),
    ],
)
def test_vectors_are_markers(
    tmp_path: Path,
    head: str,
    times: tuple[float, ...],
    said: list[str],
    found: tuple[int, int, int],
) -> None:
    markers = read(tmp_path, head + rows(*times))
    assert codes(markers) == said
    clock = markers.clock
    assert (len(markers), clock.rate, clock.start) == found
    assert markers.names == ("a", "b")
    assert not markers.visible[:, 1].any()
    scale = 1.0 if "MKR104" in said else 1e-3
    first = [1000 * scale * times[0], 2 * scale, 3 * scale]
    assert markers.positions[0, 0] == pytest.approx(first)


@pytest.mark.parametrize(
    ("body", "code"),
    [
        (rows(0, 0.02, 0.01), "MOF005"),
        ("0\t1,2,3\t1,2\n1\t1,2,3\t1,2,3\n", "MOF003"),
        (rows(0, 1e-9), "MOF006"),
        (rows(0, 0.01, 0.02, 1e7), "MOF006"),
    ],
)
def test_what_cannot_be_read(tmp_path: Path, body: str, code: str) -> None:
    with pytest.raises(FormatError) as caught:
        read(tmp_path, HEAD + body)
    assert caught.value.code == code


def test_commands_take_it_as_markers(tmp_path: Path) -> None:
    (tmp_path / "a.sto").write_text(HEAD + rows(0, 0.01, 0.02))
    done = animtool("convert", "a.sto", "a.trc", cwd=tmp_path)
    assert done.code == 0, done.stderr
    again = open_markers(tmp_path / "a.trc")
    assert np.nanmax(np.abs(again.positions[:, 0, 0] - [0, 0.01, 0.02])) < 1e-9
    assert animtool("validate", "a.sto", cwd=tmp_path).code == 0
    done = animtool("bake", "a.sto", "-o", "a.usda", cwd=tmp_path)
    assert "MOF009" in done.stderr


def test_other_tables_are_no_markers(tmp_path: Path) -> None:
    path = tmp_path / "a.sto"
    assert not is_marker_file(path)
    path.write_text(HEAD.replace("Vec3", "Quaternion") + "0\t1,0,0,0\t1,0,0,0\n")
    assert not is_marker_file(path)
    with raises(FormatError, "MOF009"):
        open_markers(path)
