"""Pictures of work against precision."""

from __future__ import annotations

import math
import sys
from pathlib import Path

import pytest

from animtool.errors import OptionError, OutputError
from animtool.preview.work_precision import (
    SUFFIXES,
    Curve,
    Panel,
    Point,
    check_drawable,
    draw_panels,
)

PANEL = Panel(
    "comets, particles",
    "error [m]",
    (
        Curve("euler", (Point(0.1, 0.1), Point(0.2, 0.05, chosen=True))),
        Curve("rk4", (Point(0.3, 1e-6, best=True), Point(0.4, 0.0))),
        Curve("lost", (Point(0.1, math.nan),)),
    ),
    floor=1e-7,
    remark="all is well",
)


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_a_picture_is_drawn_and_the_same_each_time(tmp_path: Path, suffix: str) -> None:
    pytest.importorskip("matplotlib", reason="no matplotlib (extra: preview)")
    made = []
    for name in ("a", "b"):
        path = tmp_path / f"{name}{suffix}"
        draw_panels([PANEL, PANEL], path)
        made.append(path.read_bytes())
    assert len(made[0]) > 4000
    assert made[0] == made[1]
    assert sorted(path.stem for path in tmp_path.iterdir()) == ["a", "b"]


def test_a_vector_picture_has_its_words(tmp_path: Path) -> None:
    mpl = pytest.importorskip("matplotlib", reason="no matplotlib (extra: preview)")
    with mpl.rc_context({"svg.fonttype": "none"}):
        draw_panels([PANEL], tmp_path / "a.svg")
    text = (tmp_path / "a.svg").read_text("utf-8")
    for word in ("comets, particles", "euler", "rk4", "the file's own", "all is well"):
        assert word in text.replace("&#x27;", "'")
    assert "lost" not in text


def test_nothing_that_works_makes_an_empty_frame(tmp_path: Path) -> None:
    pytest.importorskip("matplotlib", reason="no matplotlib (extra: preview)")
    draw_panels([Panel("none", "error [m]", ())], tmp_path / "a.png")
    assert (tmp_path / "a.png").stat().st_size > 1000


@pytest.mark.parametrize("name", ["a.txt", "picture", "a.jpeg"])
def test_other_files_are_refused(name: str) -> None:
    with pytest.raises(OptionError) as error:
        check_drawable(Path(name))
    assert error.value.code == "SCN072"


def test_without_matplotlib_it_says_what_to_install(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    with pytest.raises(OptionError) as error:
        check_drawable(Path("a.png"))
    assert error.value.code == "SCN070"
    assert error.value.faults[0].hint == "pip install 'animtool[preview]'"


def test_a_folder_that_is_not_there_is_an_output_error(tmp_path: Path) -> None:
    pytest.importorskip("matplotlib", reason="no matplotlib (extra: preview)")
    with pytest.raises(OutputError):
        draw_panels([PANEL], tmp_path / "none" / "a.png")
