"""What a report says of frames is what the file holds, read back from it."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from pxr import Sdf, Usd
from support.cli import Done, animtool
from support.drifting import author_samples
from support.small_takes import small
from support.suite import examples

from animtool.cli.summary import BAKE_TEMPLATE
from animtool.core.clock import Clock
from animtool.core.errors import OptionError, Severity
from animtool.core.shot import FrameRange
from animtool.core.values import plain_value
from animtool.motion.take import Take, TakeStream
from animtool.scene.bake.bake import bake
from animtool.scene.bake.options import BakeOptions
from animtool.scene.bake.prims import BakeReport
from animtool.scene.sources.open import OpenTake
from animtool.usd.takes.read import read_usd

RATES = [Fraction(24), Fraction(30), Fraction(120), Fraction(24000, 1001)]
SHUTTER = (Fraction(-1, 4), Fraction(0), Fraction(1, 4))
KEPT = {"fps": Fraction(25), "keep_samples": True}
Baked = Callable[[Clock, BakeOptions], BakeReport]


@pytest.fixture(scope="module")
def baked(tmp_path_factory: pytest.TempPathFactory) -> Baked:
    """Return a function that bakes a small take on a clock, in a folder with rigs."""
    folder = tmp_path_factory.mktemp("frames")
    source = folder / "take.bvh"
    source.touch()

    def run(clock: Clock, options: BakeOptions) -> BakeReport:
        take = replace(small(clock.count), clock=clock)
        if options.rig_layer is not None:
            options = replace(options, rig_layer=folder / options.rig_layer)
        options = replace(options, overwrite=True)
        return bake(opened(source, take), folder / "out.usdc", options)

    for start, rate in ((0, Fraction(24)), (1001, Fraction(30))):
        clock = Clock(rate, Fraction(start), Fraction(1), 2)
        path = folder / f"rig_{start}.usda"
        options = BakeOptions(form="split", overwrite=True)
        take = replace(small(2), clock=clock)
        bake(opened(source, take), path, options)
    return run


def opened(source: Path, take: Take) -> OpenTake:
    """Return a take as a source."""
    return OpenTake(source, TakeStream.of(take))


clocks = st.builds(
    Clock,
    st.sampled_from(RATES),
    st.integers(-20, 1100).map(Fraction),
    st.sampled_from([Fraction(1), Fraction(5, 4), Fraction(1, 2)]),
    st.integers(3, 14),
)


@st.composite
def bakes(draw: st.DrawFn) -> tuple[Clock, BakeOptions]:
    """Return a clock and options: rate, start, range, samples, rig layer."""
    clock = draw(clocks)
    first = draw(st.integers(-5, 1005))
    span = draw(st.none() | st.tuples(st.integers(-2, 3), st.integers(3, 30)))
    each = draw(st.integers(1, 4))
    whole = None
    if span is not None:
        whole = FrameRange(first + span[0], first + span[1], each)
    keep = draw(st.booleans()) and each == 1
    rigs = [None, Path("rig_0.rig.usda"), Path("rig_1001.rig.usda")]
    options = BakeOptions(
        fps=draw(st.none() | st.sampled_from(RATES)),
        start=Fraction(first) if whole else draw(st.none() | st.just(Fraction(first))),
        frame_range=whole,
        samples=() if keep else draw(st.sampled_from([(), SHUTTER])),
        keep_samples=keep,
        rig_layer=draw(st.sampled_from(rigs)),
    )
    return clock, options


@given(bakes())
@settings(
    max_examples=examples(20),
    deadline=None,
    suppress_health_check=[HealthCheck.function_scoped_fixture],
)
def test_what_is_printed_is_what_is_written(
    baked: Baked, given: tuple[Clock, BakeOptions]
) -> None:
    clock, options = given
    try:
        report = baked(clock, options)
    except OptionError as error:
        # No frame of the take is in the range.
        errors = [f for f in error.faults if f.severity is Severity.ERROR]
        codes = {fault.code for fault in errors}
        if codes == {"CLI005"}:
            return
        raise
    (path,) = report.files
    layer = Sdf.Layer.FindOrOpen(str(path))
    layer.Reload(force=True)
    codes = layer.ListTimeSamplesForPath("/small/Rig/Anim.rotations")
    said = plain_value(report)
    assert (said["start"], said["end"]) == (layer.startTimeCode, layer.endTimeCode)
    assert said["fps"] == layer.timeCodesPerSecond == layer.framesPerSecond
    if "rotations" in said["animated"]:
        _check_samples(options, said, codes)
    else:
        # Of one frame there is a default alone.
        assert (codes, said["samples"]) == ([], 1)
    line = r"(\d+) samples?, frames? (\S+)(?: to (\S+))? at"
    printed = re.search(line, _text(report))
    assert printed is not None
    samples, first, last = printed.groups()
    assert int(samples) == said["samples"]
    assert float(first) == pytest.approx(layer.startTimeCode, abs=1e-4)
    assert float(last or first) == pytest.approx(layer.endTimeCode, abs=1e-4)


def _check_samples(
    options: BakeOptions, said: dict[str, object], codes: list[float]
) -> None:
    """Compare a report with the time codes of an attribute that changes."""
    assert said["samples"] == len(codes)
    assert codes[0] <= said["start"] <= said["end"] <= codes[-1]
    if options.samples:
        return
    assert (codes[0], codes[-1]) == (said["start"], said["end"])
    if options.fps is not None and not options.keep_samples:
        every = 1 if options.frame_range is None else options.frame_range.step
        assert set(np.diff(codes)) <= {float(every)}


def _text(report: BakeReport) -> str:
    return "\n".join(BAKE_TEMPLATE.text(report))


TARGETS = """targets: animtool/1
goals:
- {effector: arm_l, position: [0.3, 1.2, 0.3]}
"""


@pytest.mark.slow
def test_ik_says_the_frames_that_it_writes(workplace: Path) -> None:
    """It said those of the clip, and wrote those of the rig layer."""
    biped, stride = "rigs/biped/biped.rig.yaml", "samples/stride/stride.clip.yaml"
    (workplace / "reach.targets.yaml").write_text(TARGETS, "utf-8")

    def run(*arguments: object) -> Done:
        done = animtool(*arguments, cwd=workplace)
        assert done.code == 0, done.stderr
        return done

    shot = ("--start", "1001", "--range", "1001-1006")
    run("bake", stride, "-o", "shot.usda", "--overwrite", *shot)
    run("bake", stride, "-o", "rig.usda", "--split", "--start", "7", "--overwrite")
    solve = ["ik", biped, "-t", "reach.targets.yaml", "--clip", "shot.usda", "-o"]
    for outputs, first, last in (
        (("out.usda", "--rig-layer", "rig.rig.usda"), 7, 12),
        (("out.bvh",), 1, 6),
        (("out.clip.yaml",), 1001, 1006),
    ):
        arguments = [*solve, *outputs]
        said = run(*arguments).stderr
        found = json.loads(run(*arguments, "--overwrite", "--format", "json").stdout)
        assert f"frames {first} to {last} at 24 fps" in said
        assert (found["first"], found["last"], found["fps"]) == (first, last, "24")
        assert (found["solved"]["first"], found["solved"]["last"]) == (1001, 1006)
        shifted = f"frame 1001 is written as {first}" in said
        assert shifted is (first != 1001)
    stage = Usd.Stage.Open(str(workplace / "out.usda"))
    assert (stage.GetStartTimeCode(), stage.GetEndTimeCode()) == (7, 12)
    assert stage.GetTimeCodesPerSecond() == 24


def test_a_rate_that_is_asked_for_is_used(tmp_path: Path) -> None:
    """It was not where the stage had that rate, and samples between its frames."""
    source = author_samples(
        tmp_path / "in.usda", [1 + 1.25 * i for i in range(17)], rate=30
    )
    for rate, count in ((30, 21), (60, 41), (24, 17)):
        output = tmp_path / f"{rate}.usda"
        bake(source, output, BakeOptions(fps=Fraction(rate)))
        clock = read_usd(output).collect().clock
        assert (clock.fps, clock.step, clock.count) == (rate, 1, count)
    bake(source, tmp_path / "kept.usda", BakeOptions())
    assert read_usd(tmp_path / "kept.usda").collect().clock.step == Fraction(5, 4)


@pytest.mark.parametrize(
    ("count", "options", "code", "says"),
    [
        (31, {"fps": Fraction(24)}, "", ""),
        (30, {"fps": Fraction(24)}, "TAKE006", "0.2 frames (0.00833 s)"),
        (12, {"frame_range": FrameRange(1, 12, 5)}, "CLI105", "1 to 11"),
        (12, {"frame_range": FrameRange(1, 11, 5)}, "", ""),
        (40, {**KEPT, "frame_range": FrameRange(2, 6)}, "CLI105", "2.66667 to 6 "),
        (40, {**KEPT, "frame_range": FrameRange(6, 7)}, "CLI105", "6 to 6.83333"),
        (40, {**KEPT, "frame_range": FrameRange(6, 11)}, "", ""),
    ],
)
def test_what_is_dropped_at_an_end_is_noted(
    baked: Baked, count: int, options: dict[str, object], code: str, says: str
) -> None:
    clock = Clock(Fraction(30), Fraction(1), Fraction(1), count)
    report = baked(clock, BakeOptions(start=Fraction(1), **options))
    notices = [notice for notice in report.notices if notice.code != "TAKE007"]
    assert [notice.code for notice in notices] == ([code] if code else [])
    assert all(says in notice.message for notice in notices)


def test_samples_between_frames_are_counted(baked: Baked) -> None:
    clock = Clock(Fraction(120), Fraction(1), Fraction(1), 13)
    report = baked(clock, BakeOptions(fps=Fraction(24)))
    # Of 13 samples 0, 5 and 10 are on frames; 11 and 12 come after the last.
    assert report.takes[0].between_frames == 8
    assert "8 of which fall between frames" in _text(report)
    assert plain_value(report)["between_frames"] == 8
