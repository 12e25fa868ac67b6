"""Live Link Face recordings: columns, time codes, what is odd, and back again."""

from __future__ import annotations

from collections.abc import Callable
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose
from support.faults import raises

from animtool.core.errors import FormatError, OptionError
from animtool.formats.livelink.columns import ANGLE_COLUMNS, APP_SHAPES
from animtool.formats.livelink.read import read_livelink
from animtool.formats.livelink.timecodes import find_row_frames
from animtool.formats.livelink.write import build_livelink_text, format_timecode
from animtool.formats.take_text import write_text
from animtool.formats.trajectories import CaptureFile
from animtool.motion.take import Take
from animtool.rig.parts import Shape
from animtool.rig.skeleton import Joint, JointType, Rig
from animtool.rig.write import rig_text

HEADER = "Timecode,BlendShapeCount,EyeBlinkLeft,JawOpen,HeadYaw,HeadPitch,HeadRoll"
ROW = "12:00:00:{:02d}.000,5,{:g},0.5,0.1,0,0"
Write = Callable[[str | bytes], Path]


@pytest.fixture
def write(tmp_path: Path) -> Write:
    def written(content: str | bytes) -> Path:
        path = tmp_path / "take.csv"
        path.write_bytes(content.encode() if isinstance(content, str) else content)
        return path

    return written


def rows(*frames: int) -> str:
    return "\n".join([HEADER, *(ROW.format(f, f / 100) for f in frames)]) + "\n"


def take_of(path: Path, **options: object) -> tuple[Take, list[str]]:
    stream = read_livelink(path, **options)  # type: ignore[arg-type]
    return stream.collect(), [notice.code for notice in stream.notices]


def blinks(take: Take) -> list[float]:
    assert take.motion.weights is not None
    return take.motion.weights.dense()[:, 0, 0].round(6).tolist()


def test_the_app_has_all_shapes() -> None:
    assert len(set(APP_SHAPES)) == 52


def test_dropped_frames(write: Write) -> None:
    path = write(rows(1, 2, 5, 6))
    take, codes = take_of(path)
    assert take.fps == 60
    assert blinks(take) == [0.01, 0.02, 0.03, 0.04, 0.05, 0.06]
    # The second never ends, so the rate is that of the app.
    assert codes == ["LLF107", "LLF101"]
    assert blinks(take_of(path, dropped="hold")[0]) == [0.01, *[0.02] * 3, 0.05, 0.06]
    assert blinks(take_of(path, dropped="close")[0]) == [0.01, 0.02, 0.05, 0.06]
    with raises(OptionError, "SCN022"):
        read_livelink(path, dropped="guess")  # type: ignore[arg-type]


@pytest.mark.parametrize(
    "spoil",
    [
        lambda text: "\ufeff" + text,
        lambda text: text.replace("\n", "\r\n"),
        lambda text: text.replace(",", ";"),
        lambda text: text.replace(",", "\t"),
        lambda text: text.replace(HEADER, HEADER.lower()),
        lambda text: text.replace("EyeBlinkLeft", "eyeBlink_L"),
        lambda text: text.replace("EyeBlinkLeft", ' "EyeBlinkLeft" '),
        lambda text: text.replace("\n", ",\n"),
        lambda text: text + "\n\n",
    ],
)
def test_variants_of_one_recording(write: Write, spoil: Callable[[str], str]) -> None:
    take, codes = take_of(write(spoil(rows(1, 2, 3))))
    assert blinks(take) == [0.01, 0.02, 0.03]
    assert take.rig.shapes[0].name == "eyeBlinkLeft"
    assert codes == ["LLF107"]


def second_recording(count: int) -> str:
    """Return two seconds of rows, and as many of the first ones as a second take."""
    lines = [f"12:00:0{k // 30}:{k % 30:02}.000,5,0.1,0.5,0.1,0,0" for k in range(60)]
    return "\n".join([HEADER, *lines, *lines[:count]]) + "\n"


@pytest.mark.parametrize(
    ("content", "code", "line"),
    [
        ("", "LLF001", None),
        ("\n\n", "LLF001", None),
        ("a,b\n1,2\n", "LLF001", 1),
        (HEADER + "\n", "LLF001", 1),
        ("Timecode,HeadYaw\n12:00:00:00,1\n", "LLF001", 1),
        (b"Timecode,JawOpen\n\xff\n", "LLF001", 2),
        (HEADER + ",eyeblink_l\n", "LLF002", 1),
        (rows(1) + "12:00:00:02.000,5,1\n" + ROW.format(3, 0) + "\n", "LLF003", 3),
        (rows(1) + ROW.format(2, 0).replace("0.5", "wide"), "LLF004", 3),
        (rows(1) + ROW.format(2, 0).replace(":02.", ":xx."), "LLF005", 3),
        (rows(1) + ROW.format(2, 0).replace("12:00:00", "25:00:00"), "LLF005", 3),
        (rows(1) + ROW.format(2, 0).replace("12:00:00", "13:00:00"), "LLF006", 3),
        (second_recording(30), "LLF006", 62),
    ],
)
def test_malformed(
    write: Write, content: str | bytes, code: str, line: int | None
) -> None:
    with pytest.raises(FormatError) as caught:
        read_livelink(write(content))
    (fault,) = caught.value.faults
    assert fault.code == code
    assert fault.lines == (() if line is None else (line,))


@pytest.mark.parametrize(
    ("content", "code"),
    [
        (rows(1, 2, 3).replace("0.02", "nan"), "LLF102"),
        (rows(1, 2, 3).replace("0.02", ""), "LLF102"),
        (rows(1, 2, 3).replace("0.02", "inf"), "LLF102"),
        (rows(1, 2, 3) + "12:00:00:04.000,5,1", "LLF103"),
        (rows(2, 1, 3), "LLF104"),
        (rows(1, 2, 2, 3), "LLF105"),
        (rows(1, 2, 3).replace(",5,", ",61,"), "LLF106"),
        (rows(1, 2, 3).replace("0.5", "50"), "LLF109"),
        (rows(1, 2, 3).replace(",HeadRoll", ",LeftEyeYaw"), "LLF110"),
    ],
)
def test_what_is_odd(write: Write, content: str, code: str) -> None:
    take, codes = take_of(write(content))
    assert blinks(take) == [0.01, 0.02, 0.03]
    assert code in codes


def test_percentages_are_told_from_a_few_high_weights(write: Write) -> None:
    few = rows(1, 2, 3).replace("0.5", "50", 1)
    percentages = rows(10, 20, 30).replace(",0.", ",30.")
    for content, is_percentage in ((few, False), (percentages, True)):
        file = write(content)
        stream = read_livelink(file)
        [notice] = [notice for notice in stream.notices if notice.code == "LLF109"]
        assert ("gain: 0.01" in (notice.hint or "")) is is_percentage


def test_percentages_are_not_reported_of_remapped_shapes(
    write: Write, tmp_path: Path
) -> None:
    file = write(rows(10, 20, 30).replace(",0.", ",30."))
    pairs = [
        f"- {{source: {shape.name}, target: {shape.name}, gain: 0.01}}\n"
        for shape in read_livelink(file).rig.shapes
    ]
    remap = tmp_path / "percent.remap.yaml"
    for count, expected in ((len(pairs), False), (1, True)):
        text = "".join(pairs[:count])
        remap.write_text(f"remap: animtool/1\nshapes:\n{text}", "utf-8")
        notices = read_livelink(file, remap=remap).notices
        hints = [notice.hint or "" for notice in notices if notice.code == "LLF109"]
        assert ["gain: 0.01" in hint for hint in hints] == ([True] if expected else [])


def labels(count: int, fps: int, step: int = 1, first: int = 0) -> list[str]:
    made = []
    for i in range(first, first + count * step, step):
        seconds, frame = divmod(i, fps)
        hours, minutes = seconds // 3600 % 24, seconds // 60 % 60
        made.append(f"{hours:02d}:{minutes:02d}:{seconds % 60:02d}:{frame:02d}")
    return made


def frames_of(texts: list[str]) -> tuple[Fraction, list[int]]:
    found = find_row_frames(CaptureFile("x.csv"), texts, np.arange(len(texts)) + 2)
    return found.rate, found.frames.tolist()


@pytest.mark.parametrize("fps", [24, 25, 30, 50, 60])
def test_the_clock_is_found(fps: int) -> None:
    assert frames_of(labels(3 * fps, fps)) == (fps, list(range(3 * fps)))


def test_rows_of_every_second_label() -> None:
    drifting = [
        f"{label}.{(1000 - 7 * i) % 1000:03d}"
        for i, label in enumerate(labels(90, 60, 2, 1))
    ]
    assert frames_of(labels(90, 60, 2, 1)) == (30, list(range(90)))
    assert frames_of(drifting)[0] == 30
    dropped = labels(90, 60, 2)
    del dropped[40:42]
    assert frames_of(dropped) == (30, [*range(40), *range(42, 90)])


def test_parts_of_a_frame_do_not_shift_it() -> None:
    rng = np.random.default_rng(3)
    jitter = [f"{x}.{rng.integers(1000):03d}" for x in labels(200, 60)]
    assert frames_of(jitter) == (60, list(range(200)))


def test_rows_that_come_a_little_late_each_lose_none() -> None:
    """Each comes 1.02 frames after the one before; some labels are not there."""
    whole, part = np.divmod(np.arange(200) * 102, 100)
    made = labels(int(whole[-1]) + 1, 60)
    late = [f"{made[i]}.{10 * p:03d}" for i, p in zip(whole, part, strict=True)]
    assert frames_of(late) == (60, list(range(200)))


def test_over_midnight() -> None:
    over = labels(120, 60, first=24 * 3600 * 60 - 60)
    assert over[59:61] == ["23:59:59:59", "00:00:00:00"]
    assert frames_of(over) == (60, list(range(120)))


def test_drop_frame() -> None:
    rate = Fraction(60000, 1001)
    made = [format_timecode(f, rate) for f in range(3500, 3700)]
    assert "00:01:00;04.000" in made
    assert "00:01:00;03.000" not in made
    assert frames_of(made) == (rate, list(range(200)))


def test_it_comes_back_as_it_was_written(tmp_path: Path) -> None:
    rng = np.random.default_rng(1)
    cells = rng.random((150, 61)) * ([1.0] * 52 + [0.6] * 9)
    text = ",".join(("Timecode", "BlendShapeCount", *APP_SHAPES, *ANGLE_COLUMNS)) + "\n"
    for label, values in zip(labels(150, 60), cells, strict=True):
        text += f"{label}.000,61," + ",".join(f"{v:.10f}" for v in values) + "\n"
    path = tmp_path / "a.csv"
    path.write_text(text, "utf-8")
    take = read_livelink(path).collect()
    copy = tmp_path / "b.csv"
    assert not write_text(take, copy, build_livelink_text, overwrite=False)
    again = read_livelink(tmp_path / "b.csv").collect()
    assert take.motion.weights is not None
    assert again.motion.weights is not None
    ours, theirs = take.motion.weights.dense(), again.motion.weights.dense()
    assert_allclose(theirs, ours, atol=1e-9)
    turned = np.abs(
        (take.motion.rotations.dense() * again.motion.rotations.dense()).sum(-1)
    )
    assert_allclose(turned, 1, atol=1e-9)


def test_on_a_rig(write: Write, tmp_path: Path) -> None:
    joints = (
        Joint("spine", -1, rotation=(0.5, 0.5, 0.5, 0.5)),
        Joint("rig:Head", 0, JointType.BALL, rotation=(0.6, 0, 0, 0.8)),
    )
    rig = Rig("hero", joints, shapes=(Shape("blendShape1_jaw_open"), Shape("JAWOPEN")))
    path = tmp_path / "hero.rig.yaml"
    path.write_text(rig_text(rig), "utf-8")
    take, codes = take_of(write(rows(1, 2, 3)), rig=path)
    assert codes == ["LLF107", "LLF108"]
    assert take.motion.weights is not None
    assert take.motion.weights.dense()[0, :, 0].tolist() == [0, 0.5]
    # A yaw turns about up in the world, whatever the axes of joints.
    world = take.world().rotations[0, 1]
    still = Take(rig, take.clock, take.motion).world()
    assert_allclose(world, still.rotations[0, 1])
    half = 0.05
    rest = np.array([0.5, 0.5, 0.5, 0.5])
    from animtool.maths.so3 import multiply

    expected = multiply(
        np.array([0, np.sin(half), 0, np.cos(half)]),
        multiply(rest, np.array([0.6, 0, 0, 0.8])),
    )
    assert abs(abs(float(world @ expected)) - 1) < 1e-12
    bare = tmp_path / "bare.rig.yaml"
    bare.write_text(rig_text(Rig("bare", (Joint("a", -1),))), "utf-8")
    with raises(OptionError, "LLF007"):
        read_livelink(write(rows(1)), rig=bare)
    remap = tmp_path / "hero.remap.yaml"
    remap.write_text(
        "remap: animtool/1\nshapes:\n"
        "- {source: eyeBlinkLeft, target: JAWOPEN, gain: 10, clamp: [0, 0.15]}\n"
        "others: none\n",
        "utf-8",
    )
    take, _ = take_of(write(rows(1, 2)), rig=path, remap=remap)
    assert take.motion.weights is not None
    assert take.motion.weights.dense()[:, 1, 0].tolist() == pytest.approx([0.1, 0.15])


def test_what_a_recording_does_not_hold(write: Write) -> None:
    take = read_livelink(write(rows(1, 2))).collect()
    from dataclasses import replace

    shapes = (Shape("grin"), *take.rig.shapes[1:])
    odd = replace(take, rig=replace(take.rig, shapes=shapes))
    (notice,) = build_livelink_text(odd).notices
    assert notice.code == "LLF111"
    none = replace(take, rig=replace(take.rig, shapes=(Shape("a"), Shape("b"))))
    with raises(OptionError, "LLF008"):
        build_livelink_text(none)
    slow = replace(take, clock=replace(take.clock, fps=Fraction(47, 2)))
    with raises(OptionError, "LLF009"):
        build_livelink_text(slow)


@pytest.mark.parametrize("value", ["1e300", "-1e19", "1e38"])
def test_values_that_no_pose_has_are_missing(write: Write, value: str) -> None:
    """Of weights, and of angles."""
    text = rows(1, 2, 3).replace("0.02,0.5,0.1", f"{value},0.5,{value}")
    take, codes = take_of(write(text))
    assert codes.count("LLF102") == 2
    assert blinks(take) == [0.01, 0.02, 0.03]
    assert np.isfinite(take.motion.rotations.values).all()


@pytest.mark.parametrize("stated", [24, 30, 25])
def test_a_stated_rate_below_the_time_codes_is_one_fault(
    write: Write, stated: int
) -> None:
    path = write(rows(*range(0, 60, 2)))
    with pytest.raises(FormatError) as caught:
        read_livelink(path, fps=stated)
    (fault,) = caught.value.faults
    assert fault.code == "LLF005"
    assert "up to 58" in fault.message or "up to 59" in fault.message
    assert fault.hint is not None
    assert fault.hint.startswith("set fps=60, or leave it out")
    assert read_livelink(path, fps=60).collect().clock.count == 30


def test_one_damaged_time_code_is_its_own_fault(write: Write) -> None:
    text = rows(*range(2, 22)).replace("12:00:00:05", "12:00:00:75")
    with pytest.raises(FormatError, match="the largest is 59") as caught:
        read_livelink(write(text), fps=60)
    assert len(caught.value.faults) == 1


def test_decimal_commas_are_one_fault(write: Write) -> None:
    text = (HEADER + "\n" + ROW.format(1, 0) + "\n" + ROW.format(2, 0) + "\n").replace(
        ",", ";"
    )
    path = write(text.replace("0.5", "0,5"))
    with pytest.raises(FormatError) as caught:
        read_livelink(path)
    (fault,) = caught.value.faults
    assert (fault.code, fault.lines) == ("LLF004", (2,))
    assert fault.hint is not None


@pytest.mark.parametrize(
    ("yaw", "found"), [(3.1, False), (-3.14159, False), (13.98, True)]
)
def test_angles_in_degrees(write: Write, yaw: float, found: bool) -> None:
    content = rows(1, 2, 3).replace(",0.1,", f",{yaw},")
    notices = read_livelink(write(content)).notices
    degrees = [notice for notice in notices if notice.code == "LLF112"]
    assert [notice.lines for notice in degrees] == [(2,)] * found
