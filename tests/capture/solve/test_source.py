"""Markers as the motion of a rig: whose, what went wrong in which file, how well."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import pytest
from support.marked import FIGURE, TEMPLATE, captured, moving

from animtool.capture.options import SolveOptions
from animtool.capture.solve import solve_markers
from animtool.capture.solve.source import rig_of_template, solve_scores, solve_stream
from animtool.core.errors import Fault, OptionError

PATH = Path("take.c3d")


def test_a_rig_that_is_given_goes_before_that_of_the_template() -> None:
    own, other = Path("own.rig.yaml"), Path("other.rig.yaml")
    template = replace(TEMPLATE, rig=own)
    assert rig_of_template(template, other, PATH) == other
    assert rig_of_template(template, None, PATH) == own
    with pytest.raises(OptionError) as caught:
        rig_of_template(replace(TEMPLATE, rig=None), None, PATH)
    (fault,) = caught.value.faults
    assert (fault.code, fault.path) == ("SOL008", str(PATH))


def test_a_solve_is_scored_by_what_markers_miss_and_the_mean_of_outliers() -> None:
    markers = [SimpleNamespace(outliers=share) for share in (0.0, 0.1, 0.5)]
    score = SimpleNamespace(total=0.004, markers=markers)
    found = solve_scores(SimpleNamespace(score=score))  # type: ignore[arg-type]
    values = {one.name: one.value for one in found.scores}
    assert values == {"marker": 0.004, "outliers": pytest.approx(0.2)}
    assert found.pass_name == "solve"


def test_what_is_found_while_it_is_read_is_told_behind_what_was_known() -> None:
    take = captured(moving(30, 100.0, 2, 0.5), 100.0)
    known = Fault("MKR101", "known")
    markers = replace(take.markers, notices=(known,))
    solve = solve_markers(markers, FIGURE, TEMPLATE, SolveOptions())
    stream = solve_stream(solve, PATH, None)
    assert (stream.fps, stream.start, stream.step) == (100, 1, 1)
    assert stream.notices[0] == replace(known, path=str(PATH))
    count = len(stream.notices)
    solve.notices.append(Fault("SOL107", "later", "own.c3d"))
    assert sum(block.frames for block in stream.blocks) == 30
    later = [fault for fault in stream.notices[count:] if fault.code == "SOL107"]
    assert [fault.path for fault in later] == ["own.c3d"] * len(later)
    assert len(stream.scores) == 1
    assert stream.details["format"] == "markers"
    assert stream.details["markers"] == f"{len(TEMPLATE.markers)} markers"
