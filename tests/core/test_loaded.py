"""Public functions that are given a path or a stream instead of an object."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from animtool import (
    Clip,
    PictureOptions,
    Rig,
    Take,
    bake,
    edit,
    ik,
    open_source,
    read_bvh,
    run_batch,
    usd,
    validate,
    write_bvh,
    write_pictures,
)
from animtool.core.errors import FormatError
from animtool.core.loaded import path_list

ROOT = Path(__file__).parents[2]
WALK = ROOT / "samples/walk/walk.bvh"
CLIP = ROOT / "samples/stride/stride.clip.yaml"
RIG = ROOT / "rigs/biped/biped.rig.yaml"

TAKE_FUNCTIONS: list[Callable[[Any], object]] = [
    edit.difference,
    edit.find_cycle,
    edit.loop,
    edit.mirror,
    edit.trim,
    edit.extract_root,
    edit.recompose_root,
    lambda take: edit.blend(take, take, weight=0.5),
    lambda take: edit.layer(take, take),
    lambda take: edit.resampled(take, 24),
    lambda take: edit.time_scale(take, 2.0),
    lambda take: edit.time_warp(take, [(1, 1), (2, 2)]),
    lambda take: edit.hang(take, "hips", []),  # type: ignore[arg-type]
    lambda take: ik.solve_take(take, None),  # type: ignore[arg-type]
    lambda take: usd.write(take, "unwritten.usda"),
    lambda take: write_bvh(take, "unwritten.bvh"),
]


@pytest.mark.parametrize("function", TAKE_FUNCTIONS)
def test_paths_and_streams_are_no_takes(function: Callable[[Any], object]) -> None:
    for path in (WALK, str(WALK)):
        with pytest.raises(TypeError, match=r"take is a path.*open_source\('.*'\)"):
            function(path)
    with pytest.raises(TypeError, match=r"is a TakeStream.* take\.collect\(\)"):
        function(read_bvh(WALK))


@pytest.mark.parametrize(
    "function",
    [
        Clip.load(CLIP).sample,
        lambda rig: ik.build(rig, []),
        lambda rig: ik.match(rig, [], None),  # type: ignore[arg-type]
        lambda rig: Take(rig, None, None),  # type: ignore[arg-type]
    ],
)
def test_paths_and_takes_are_no_rigs(function: Callable[[Any], object]) -> None:
    with pytest.raises(TypeError, match=r"rig is a path.*Rig\.load\('.*'\)"):
        function(str(RIG))
    take = open_source(WALK).collect()
    with pytest.raises(TypeError, match=r"rig is a Take.* rig\.rig"):
        function(take)
    with pytest.raises(TypeError, match=r"rig is None, not a Rig$"):
        function(None)


def test_clips_are_sampled_first() -> None:
    with pytest.raises(TypeError, match=r"take is a Clip.* take\.sample\(rig\)"):
        usd.write(Clip.load(CLIP), "unwritten.usda")  # type: ignore[arg-type]


def test_mappings_are_no_options() -> None:
    options: Any = {"fps": 24}
    with pytest.raises(TypeError, match=r"BakeOptions\(\*\*options\)"):
        bake(WALK, "unwritten.usda", options)
    with pytest.raises(TypeError, match=r"SourceOptions\(\*\*options\)"):
        open_source(WALK, options)


def test_clips_are_no_rigs() -> None:
    with pytest.raises(FormatError) as caught:
        Rig.load(CLIP)
    (fault,) = caught.value.faults
    assert (fault.code, fault.path) == ("DOC009", str(CLIP))
    assert "Clip.load" in (fault.hint or "")


def test_arguments_of_ik_in_the_place_of_others_say_what_to_write() -> None:
    rig = Rig.load(RIG)
    take = Clip.load(CLIP).sample(rig, fps=24)
    any_ik: Any = ik  # a type checker knows these mistakes too
    arm: Any = ik.build(rig, [ik.Goal("wrist_l")], joints=["shoulder_l", "elbow_l"])
    targets: Any = ik.Targets(positions=[[[0.3, 1.2, 0.4]]])
    calls: list[tuple[Callable[[], object], str]] = [
        (lambda: any_ik.solve(arm, targets), r"write solve\(problem, None, targets\)"),
        (lambda: any_ik.solve(arm, targets, None), r"solve\(problem, None, targets"),
        (
            lambda: any_ik.solve(arm, targets=targets),
            r"solve\(problem, None, targets",
        ),
        (
            lambda: any_ik.follow(arm, targets),
            r"write follow\(problem, None, targets\)",
        ),
        (
            lambda: any_ik.solve(arm, None, [[[0, 1, 0]]]),
            r"Targets\(positions=targets\)",
        ),
        (lambda: any_ik.solve(rig, None, targets), r"build\(problem, goals\)"),
        (
            lambda: any_ik.solve(arm, None, targets, ik.TakeOptions()),
            "not an IkOptions",
        ),
        (
            lambda: any_ik.smooth(arm, targets, 0.1, fps=24),
            r"solve\(result, None, targets",
        ),
        (lambda: any_ik.build(rig, ik.Goal("wrist_l")), r"write \[goals\]"),
        (lambda: any_ik.build(rig, ["wrist_l"]), r"write Goal\('wrist_l'\)"),
        (lambda: any_ik.build(rig, "wrist_l"), r"write \[Goal\('wrist_l'\)\]"),
        (lambda: any_ik.solve_take(take, targets), r"solve\(problem, None, tracks\)"),
        (
            lambda: any_ik.solve_take(take, "a.targets.yaml"),
            r"load_targets\('a.targets",
        ),
    ]
    for call, message in calls:
        with pytest.raises(TypeError, match=message):
            call()


@pytest.mark.parametrize("paths", ["a.bvh", Path("a.bvh"), ["a.bvh"], (Path("a.bvh"),)])
def test_one_path_or_several(paths: Any) -> None:
    assert path_list(paths, "paths") == [Path("a.bvh")]


def test_other_arguments_are_named(tmp_path: Path) -> None:
    rig = Rig.load(ROOT / "rigs/arm/arm.rig.yaml")
    wrong: Any = PictureOptions()
    calls: dict[str, Any] = {
        "paths is a Rig": lambda: validate(rig),  # type: ignore[arg-type]
        "paths contains a Rig": lambda: validate([rig]),  # type: ignore[list-item]
        "spec is a path, not a BatchSpec": lambda: run_batch("a.batch.yaml"),  # type: ignore[arg-type]
        "options is a PictureOptions": lambda: write_pictures(
            "a.bvh", tmp_path / "a.png", wrong
        ),
        "name is 3": lambda: rig.index(3),  # type: ignore[arg-type]
        "targets is a list": lambda: rig.ik(rig.names[-1]).solve([0, 0, 0]),  # type: ignore[arg-type]
    }
    for message, call in calls.items():
        with pytest.raises(TypeError, match=message):
            call()
