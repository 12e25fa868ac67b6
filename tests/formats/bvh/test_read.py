from __future__ import annotations

import contextlib
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal
from support.bvh import (
    COLUMNS,
    HEADER,
    SPINE,
    TIP,
    random_rows,
    read_reference,
    small_bvh,
)

from animtool.core.errors import FormatError, Severity
from animtool.core.units import LengthUnit
from animtool.formats.bvh import lines as lines_module
from animtool.formats.bvh.read import read_bvh
from animtool.formats.bvh.write import build_bvh_text
from animtool.motion.take import Take, TakeStream
from animtool.rig.kinematics import forward_kinematics
from animtool.rig.skeleton import JointType
from animtool.validation.run import validate


@pytest.fixture
def write(tmp_path: Path):  # type: ignore[no-untyped-def]
    def write(text: str | bytes) -> Path:
        path = tmp_path / "take.bvh"
        path.write_bytes(text if isinstance(text, bytes) else text.encode())
        return path

    return write


def read(path: Path) -> tuple[TakeStream, Take]:
    stream = read_bvh(path)
    return stream, stream.collect()


def codes(stream: TakeStream) -> list[str]:
    return [n.code for n in stream.notices if n.severity is Severity.WARNING]


def fault(path: Path) -> FormatError:
    with pytest.raises(FormatError) as caught:
        read_bvh(path).collect()
    return caught.value


def test_positions_against_the_reference(write) -> None:  # type: ignore[no-untyped-def]
    path = write(small_bvh(random_rows(50)))
    _, take = read(path)
    world = forward_kinematics(
        take.rig, take.motion.translations.dense(), take.motion.rotations.dense()
    )
    truth = read_reference(path).positions(np.arange(50))
    assert_allclose(world.positions / 0.01, truth, rtol=1e-13, atol=1e-12)


@pytest.mark.parametrize("per_block", [1, 2, 7, 1000])
def test_blocks_change_nothing(write, monkeypatch, per_block: int) -> None:  # type: ignore[no-untyped-def]
    path = write(small_bvh(random_rows(60)))
    whole = read(path)[1].motion
    monkeypatch.setattr(lines_module, "BLOCK_VALUES", COLUMNS * per_block)
    monkeypatch.setattr(lines_module, "CHUNK_BYTES", 64)
    blocks = list(read_bvh(path).blocks)
    assert max(block.frames for block in blocks) <= per_block
    split = read(path)[1].motion
    assert_array_equal(split.rotations.values, whole.rotations.values)
    assert_array_equal(split.translations.values, whole.translations.values)


def test_static_joints_are_stored_once(write) -> None:  # type: ignore[no-untyped-def]
    rows = random_rows(5)
    rows[:, 6:] = [10.0, 20.0, 30.0]
    _, take = read(write(small_bvh(rows)))
    assert take.motion.rotations.animated.tolist() == [0]
    assert take.motion.rotations.values.shape == (5, 1, 4)
    assert not np.allclose(take.motion.rotations.rest[1], [0, 0, 0, 1])


def test_units_and_stated_rate(write) -> None:  # type: ignore[no-untyped-def]
    path = write(small_bvh(random_rows(2), frame_time="1.0"))
    stream = read_bvh(path, unit=LengthUnit.IN, fps="60")
    assert stream.fps == 60
    take = stream.collect()
    assert codes(stream) == []
    assert_allclose(take.rig.joints[1].translation, np.array(SPINE) * 0.0254)


def test_rows_of_zeros_within_a_motion_are_reported(write) -> None:  # type: ignore[no-untyped-def]
    rows = np.tile(np.arange(1.0, COLUMNS + 1.0) * 10.0, (12, 1))
    rows += np.arange(12.0)[:, None]
    rows[5:8] = 0.0
    path = write(small_bvh(rows))
    stream = read_bvh(path)
    stream.collect()
    faults = [notice for notice in stream.notices if notice.code == "TAKE013"]
    line = len(path.read_text().splitlines()) - 12 + 5 + 1
    assert [fault.lines for fault in faults] == [(line,)]


@pytest.mark.parametrize("bad", ["nan", "inf", "-inf", "1.#QNAN"])
@pytest.mark.parametrize("frames", [[3], [0, 1], [18, 19], [4, 5, 6, 12]])
def test_gaps_are_interpolated(write, bad: str, frames: list[int]) -> None:  # type: ignore[no-untyped-def]
    rows = np.zeros((20, COLUMNS))
    rows[:, 0] = np.arange(20) * 100.0
    lines = small_bvh(rows).splitlines()
    first = len(lines) - 20
    for frame in frames:
        words = lines[first + frame].split()
        lines[first + frame] = " ".join([bad, *words[1:]])
    stream, take = read(write("\n".join(lines) + "\n"))
    truth = np.arange(20.0)
    truth[[f for f in frames if f < 2]] = 2.0 if 0 in frames else truth[0]
    truth[[f for f in frames if f > 17]] = 17.0
    assert_allclose(take.motion.translations.values[:, 0, 0], truth, atol=1e-12)
    assert codes(stream) == ["BVH102"]
    notice = stream.notices[0]
    assert notice.lines == tuple(first + f + 1 for f in frames)
    assert "Hips.Xposition" in notice.message


def test_a_gap_across_the_half_turn_is_small(write) -> None:  # type: ignore[no-untyped-def]
    text = small_bvh(np.zeros((3, COLUMNS))).splitlines()
    for i, angle in enumerate(("179", "nan", "-179")):
        text[i - 3] = f"0 0 0 {angle} 0 0 0 0 0"
    _, take = read(write("\n".join(text)))
    half_turn = take.motion.rotations.dense()[1, 0]
    assert_allclose(np.abs(half_turn), [0, 1, 0, 0], atol=1e-15)


@pytest.mark.parametrize("per_block", [1, 3, 8])
def test_gaps_across_blocks(write, monkeypatch, per_block: int) -> None:  # type: ignore[no-untyped-def]
    rows = random_rows(24)
    text = small_bvh(rows).splitlines()
    first = len(text) - 24
    for frame in range(5, 11):
        words = text[first + frame].split()
        words[4] = "nan"
        text[first + frame] = " ".join(words)
    path = write("\n".join(text))
    whole = read(path)[1].motion.rotations.values
    monkeypatch.setattr(lines_module, "BLOCK_VALUES", COLUMNS * per_block)
    assert_array_equal(read(path)[1].motion.rotations.values, whole)


@pytest.mark.parametrize(
    ("count", "lost", "refused"),
    [
        (200, 11, False),
        (100, 10, False),
        (100, 11, True),
        (50, 10, False),
        (3, 3, True),
    ],
)
def test_how_much_may_be_lost(write, count: int, lost: int, refused: bool) -> None:  # type: ignore[no-untyped-def]
    text = small_bvh(np.ones((count, COLUMNS))).splitlines()
    for frame in range(lost):
        text[-1 - frame] = "1 nan 1 1 1 1 1 1 1"
    path = write("\n".join(text))
    if refused:
        assert fault(path).code == "BVH012"
    else:
        assert codes(read(path)[0]) == ["BVH102"]


@pytest.mark.parametrize("value", ["1e39", "-1e39", "1e400", "1e308"])
def test_beyond_float32(write, value: str) -> None:  # type: ignore[no-untyped-def]
    text = small_bvh(np.ones((4, COLUMNS))).splitlines()
    text[-2] = f"1 {value} 1 1 1 1 1 1 1"
    stream, take = read(write("\n".join(text)))
    assert codes(stream) == ["BVH104"]
    largest = float(np.finfo(np.float32).max)
    expected = np.copysign(largest, float(value)) * 0.01
    assert_allclose(take.motion.translations.values[2, 0, 1], expected)


def with_channels(channels: str, offset: str = "1 2 3") -> str:
    count = len(channels.split())
    header = (
        f"HIERARCHY\nROOT r\n{{\nOFFSET {offset}\nCHANNELS {count} {channels}\n"
        "End Site\n{\nOFFSET 0 1 0\n}\n}\n"
    )
    return small_bvh(np.arange(1.0, count + 1)[None], header=header)


def test_positions_replace_the_offset_on_their_axes(write) -> None:  # type: ignore[no-untyped-def]
    _, take = read(write(with_channels("Yposition Zrotation")))
    assert_allclose(take.motion.translations.dense()[0, 0], [0.01, 0.01, 0.03])


def test_rotations_before_positions(write) -> None:  # type: ignore[no-untyped-def]
    channels = "Zrotation Xrotation Yrotation Xposition Yposition Zposition"
    _, take = read(write(with_channels(channels)))
    assert_allclose(take.motion.translations.dense()[0, 0], [0.04, 0.05, 0.06])
    assert take.rig.joints[0].channels == tuple(channels.split())


@pytest.mark.parametrize(
    ("channels", "kind"),
    [
        ("Yrotation", JointType.PIN),
        ("Yposition", JointType.PRISMATIC),
        ("Zrotation Xrotation", JointType.BALL),
        ("Zrotation Xrotation Yrotation", JointType.BALL),
        ("Xposition Zrotation Xrotation Yrotation", JointType.FREE),
    ],
)
def test_joint_types(write, channels: str, kind: JointType) -> None:  # type: ignore[no-untyped-def]
    joint = read(write(with_channels(channels)))[1].rig.joints[0]
    assert joint.type is kind
    if len(channels.split()) == 1:
        assert joint.axis == (0.0, 1.0, 0.0)


def test_names_with_spaces_dots_and_letters_beyond_ascii(write) -> None:  # type: ignore[no-untyped-def]
    for name in ("Left Arm", "arm.L", "ns:arm", "Bär", "手"):
        text = small_bvh(random_rows(2), header=HEADER.replace("Spine", name))
        assert read(write(text))[1].rig.names[1] == name
    latin = small_bvh(random_rows(2), header=HEADER.replace("Spine", "Bär"))
    assert read(write(latin.encode("latin-1")))[1].rig.names[1] == "Bär"
    windows = small_bvh(random_rows(2), header=HEADER.replace("Spine", "Žar"))
    assert read(write(windows.encode("cp1252")))[1].rig.names[1] == "Žar"


@pytest.mark.parametrize("name", ["hip\x1b]0;mine\x07", "a\x9bb", "a\x7f"])
def test_names_with_control_characters_are_refused(  # type: ignore[no-untyped-def]
    write, name: str
) -> None:
    found = fault(
        write(small_bvh(random_rows(2), header=HEADER.replace("Spine", name)))
    )
    assert (found.code, found.faults[0].lines) == ("BVH001", (6,))


def test_duplicates_are_kept_apart(write) -> None:  # type: ignore[no-untyped-def]
    stream, take = read(
        write(small_bvh(random_rows(2), header=HEADER.replace("Spine", "Hips")))
    )
    assert take.rig.names == ["Hips", "Hips_2"]
    assert take.rig.joints[1].source_name == "Hips"
    assert stream.notices[0].code == "BVH103"
    assert stream.notices[0].lines == (2, 6)


def test_several_end_sites(write) -> None:  # type: ignore[no-untyped-def]
    more = HEADER.replace(
        "\t\tEnd Site", "\t\tEnd Site\n\t\t{\n\t\t\tOFFSET 1 0 0\n\t\t}\n\t\tEnd Site"
    )
    tips = read(write(small_bvh(random_rows(2), header=more)))[1].rig.joints[1].tips
    assert_allclose(tips, 0.01 * np.array([(1, 0, 0), TIP]))


def test_a_leaf_without_an_end_site(write, tmp_path: Path) -> None:  # type: ignore[no-untyped-def]
    header = HEADER.replace("\t\tEnd Site\n\t\t{\n\t\t\tOFFSET -2 5 1\n\t\t}\n", "")
    assert "End Site" not in header
    path = write(small_bvh(random_rows(3), header=header))
    stream, take = read(path)
    assert stream.notices == []
    assert [(joint.name, joint.tips) for joint in take.rig.joints] == [
        ("Hips", ()),
        ("Spine", ()),
    ]
    assert validate(path) == []
    text = b"".join(build_bvh_text(take).parts).decode()
    assert text.startswith(header)
    other = tmp_path / "with.bvh"
    other.write_text(small_bvh(random_rows(3)))
    assert_array_equal(
        take.motion.rotations.values, read(other)[1].motion.rotations.values
    )


@pytest.mark.parametrize(
    ("text", "code", "said"),
    [
        ("0.033333", None, ""),
        ("0.017", "BVH107", "58, 59 fps would be printed the same; using 60 fps"),
        (
            "0.0035",
            "BVH107",
            "rounded: 282, 283, 284, 285, 287, 288 … fps would be",
        ),
        ("0.033343", "BVH106", "not a standard rate; using 29.9913 fps"),
        ("0.25", None, ""),
        ("0.2501", "BVH105", "implausible"),
        ("0.001", None, ""),
        ("0.0009", "BVH105", "implausible"),
        ("4", "BVH105", "is 1/4 (0.25) fps"),
    ],
)
def test_what_is_said_of_a_frame_time(  # type: ignore[no-untyped-def]
    write, text: str, code: str | None, said: str
) -> None:
    notices = read_bvh(write(small_bvh(random_rows(2), frame_time=text))).notices
    severity = Severity.NOTE if code == "BVH107" else Severity.WARNING
    assert [(n.code, n.severity) for n in notices] == (
        [(code, severity)] if code else []
    )
    assert all(said in notice.message for notice in notices)


@pytest.mark.parametrize("text", ["4", "30", "1000"])
def test_a_rate_in_place_of_a_frame_time_is_taken_for_one(write, text: str) -> None:  # type: ignore[no-untyped-def]
    (notice,) = read_bvh(write(small_bvh(random_rows(2), frame_time=text))).notices
    assert notice.hint == f"is it a rate instead of a time? then set fps={text}"


@pytest.mark.parametrize(
    ("text", "rate"),
    [("33.3333", "30"), ("8.333", "120"), ("41.7083", "24000/1001"), ("20", "50")],
)
def test_a_frame_time_in_milliseconds_is_named(  # type: ignore[no-untyped-def]
    write, text: str, rate: str
) -> None:
    (notice,) = read_bvh(write(small_bvh(random_rows(2), frame_time=text))).notices
    assert notice.code == "BVH105"
    assert notice.hint is not None
    assert notice.hint.endswith(f"set fps={rate}" if "/" not in rate else rate + '"')


def test_byte_order_mark_and_no_final_newline(write) -> None:  # type: ignore[no-untyped-def]
    rows = random_rows(3)
    text = small_bvh(rows).rstrip("\n")
    stream, take = read(write(b"\xef\xbb\xbf" + text.encode()))
    assert (take.clock.count, codes(stream)) == (3, [])


def test_a_whole_joint_on_one_line(write) -> None:  # type: ignore[no-untyped-def]
    header = "HIERARCHY ROOT r { CHANNELS 3 Xrotation Yrotation Zrotation OFFSET 1 2 3 "
    header += "End Site { OFFSET 0 1 0 } }\n"
    _, take = read(write(small_bvh([[1, 2, 3]], header=header)))
    assert take.rig.joints[0].translation == (0.01, 0.02, 0.03)
    assert take.rig.joints[0].tips == ((0.0, 0.01, 0.0),)


JOINT = "HIERARCHY\nROOT a\n{\n"
CHANNELS = JOINT + "OFFSET 0 0 0\nCHANNELS"
BAD_HEADERS = {
    "no hierarchy": ("BVH001", "MOTION\n", (1,)),
    "binary": ("BVH001", "HIERARCHY\0\0", ()),
    "empty": ("BVH002", "", ()),
    "only blanks": ("BVH001", " \n\n", (2,)),
    "unknown word": ("BVH003", "HIERARCHY\nROOT a\n{\nSCALE 1\n", (4,)),
    "joint outside": ("BVH003", "HIERARCHY\nJOINT a\n{\n", (2,)),
    "root inside": ("BVH003", "HIERARCHY\nROOT a\n{\nROOT b\n", (4,)),
    "no name": ("BVH003", "HIERARCHY\nROOT\n{\n", (2,)),
    "joint in end": ("BVH003", JOINT + "OFFSET 0 0 0\nEnd Site\n{\nJOINT b\n", (7,)),
    "end site outside": ("BVH003", "HIERARCHY\nEnd Site\n{\n", (2,)),
    "no root": ("BVH003", "HIERARCHY\nMOTION\n", (2,)),
    "no brace": ("BVH004", "HIERARCHY\nROOT a\nOFFSET 0 0 0\n", (3,)),
    "brace alone": ("BVH004", "HIERARCHY\n{\n", (2,)),
    "truncated": ("BVH005", JOINT + "OFFSET 0 0 0\n", (4,)),
    "no offset": ("BVH006", "HIERARCHY\nROOT a\n{\n}\n", (4,)),
    "offset words": ("BVH006", JOINT + "OFFSET 0 x 0\n", (4,)),
    "offset four": ("BVH006", JOINT + "OFFSET 0 0 0 0\n", (4,)),
    "offset nan": ("BVH006", JOINT + "OFFSET 0 nan 0\n", (4,)),
    "offset comma": ("BVH006", JOINT + "OFFSET 0 1,5 0\n", (4,)),
    "channel name": ("BVH007", CHANNELS + " 1 Xscale\n", (5,)),
    "channel count": ("BVH007", CHANNELS + " 2 Xrotation\n", (5,)),
    "a brace in place of a channel": (
        "BVH007", CHANNELS + " 2 Xrotation } Yrotation\n", (5,)
    ),
    "channel twice": ("BVH007", CHANNELS + " 2 Xrotation Xrotation\n", (5,)),
    "no count": ("BVH007", CHANNELS + " Xrotation\n", (5,)),
    "no channels": ("BVH007", JOINT + "OFFSET 0 0 0\n}\nMOTION\n", (6,)),
}  # fmt: skip


@pytest.mark.parametrize("case", BAD_HEADERS)
def test_malformed_headers(write, case: str) -> None:  # type: ignore[no-untyped-def]
    code, text, lines = BAD_HEADERS[case]
    error = fault(write(text))
    assert (error.code, error.faults[0].lines) == (code, lines)


@pytest.mark.parametrize(
    ("channels", "repeated", "missing"),
    [
        ("3 Xrotation Xrotation Zrotation", "'Xrotation' appears twice", "Yrotation"),
        ("3 Zposition yposition YPosition", "'Yposition' appears twice", "Xposition"),
        ("3 Zrotation Zrotation Zrotation", "3 times", "Xrotation and Yrotation"),
        ("2 Xrotation Xrotation", "'Xrotation' appears twice", "remove all but one"),
    ],
)
def test_a_repeated_channel_is_named(  # type: ignore[no-untyped-def]
    write, channels: str, repeated: str, missing: str
) -> None:
    [reported] = fault(write(f"{CHANNELS} {channels}\n")).faults
    assert reported.code == "BVH007"
    assert repeated in reported.message
    assert missing in (reported.hint or "")


MOTION_HEAD = HEADER + "MOTION\n"
FIRST = MOTION_HEAD.count("\n") + 1
ROW = " ".join(["1"] * COLUMNS)


@pytest.mark.parametrize(
    ("code", "text", "line"),
    [
        ("BVH008", "Frames: x\n", FIRST),
        ("BVH008", "Frames: 0\n", FIRST),
        ("BVH008", "Frames: 1.5\n", FIRST),
        ("BVH003", "Rate: 30\n", FIRST),
        ("BVH005", "Frames: 1\n", FIRST),
        ("BVH009", "Frames: 1\nFrame Time: 0\n", FIRST + 1),
        ("BVH009", "Frames: 1\nFrame Time: -1\n", FIRST + 1),
        ("BVH009", "Frames: 1\nFrame Time: inf\n", FIRST + 1),
        ("BVH009", "Frames: 1\nFrame Time:\n", FIRST + 1),
        ("BVH009", "Frames: 1\nFrame Time: 0._333333\n", FIRST + 1),
        ("BVH014", "Frames: 1\nFrame Time: .1\n", FIRST + 1),
        ("BVH010", f"Frames: 2\nFrame Time: .1\n{ROW}\n1 2\n", FIRST + 3),
        ("BVH010", f"Frames: 1\nFrame Time: .1\n{ROW} 1\n", FIRST + 2),
        ("BVH011", f"Frames: 1\nFrame Time: .1\n\n{ROW[:-1]}x\n", FIRST + 3),
        ("BVH011", f"Frames: 1\nFrame Time: .1\n{ROW}\nend\n", FIRST + 3),
    ],
)
def test_malformed_motion(write, code: str, text: str, line: int) -> None:  # type: ignore[no-untyped-def]
    error = fault(write(MOTION_HEAD + text))
    assert (error.code, error.faults[0].lines) == (code, (line,))


def test_a_truncated_last_row_says_so(write) -> None:  # type: ignore[no-untyped-def]
    text = small_bvh(random_rows(4)).rstrip("\n").rsplit(" ", 2)[0]
    assert "truncated" in str(fault(write(text)))


def test_a_line_of_ten_megabytes(write) -> None:  # type: ignore[no-untyped-def]
    head = MOTION_HEAD + "Frames: 1\nFrame Time: .1\n"
    assert fault(write(head + "1 " * 5_000_000)).code in {"BVH010", "BVH013"}
    assert fault(write(head + "1" * 10_000_000)).code == "BVH013"
    assert fault(write(head + " " * 10_000_000 + ROW)).code == "BVH013"
    assert fault(write("HIERARCHY\nROOT " + "a" * 10_000_000)).code == "BVH013"


@pytest.mark.parametrize("encoding", ["utf-16", "utf-16-le"])
def test_utf16_is_named_or_refused(write, encoding: str) -> None:  # type: ignore[no-untyped-def]
    assert fault(write(small_bvh(random_rows(2)).encode(encoding))).code == "BVH001"


def test_missing_and_folder(tmp_path: Path) -> None:
    assert fault(tmp_path / "none.bvh").code == "IO001"
    (tmp_path / "folder.bvh").mkdir()
    assert fault(tmp_path / "folder.bvh").code == "IO001"


def test_a_thousand_joints_deep(write) -> None:  # type: ignore[no-untyped-def]
    depth = 2000
    joint = "JOINT j{0}\n{{\nOFFSET 0 1 0\nCHANNELS 1 Xrotation\n"
    header = "HIERARCHY\nROOT j\n{\nOFFSET 0 0 0\n" + "".join(
        map(joint.format, range(depth))
    )
    header += "}\n" * (depth + 1)
    _, take = read(write(small_bvh(np.zeros((1, depth)), header=header)))
    assert len(take.rig.joints) == depth + 1


def test_memory_follows_the_data_not_the_promise(write) -> None:  # type: ignore[no-untyped-def]
    text = small_bvh(random_rows(3)).replace("Frames: 3", "Frames: 1000000000000")
    stream, take = read(write(text))
    assert take.clock.count == 3
    assert "1000000000000" in stream.notices[0].message


PIECES = [
    *(b"{", b"}", b"nan", b"1e999", b"-", b"\n", b"\r", b"\0", b"\xff", b"1e-400"),
    *(b"JOINT x", b"OFFSET", b"CHANNELS 3", b"End Site", b"MOTION", b"0" * 50),
]
edits = st.lists(
    st.tuples(st.integers(0, 10**6), st.integers(0, 20), st.sampled_from(PIECES)),
    min_size=1,
    max_size=5,
)


@given(edits)
def test_spoilt_files_are_read_or_refused(
    tmp_path_factory: pytest.TempPathFactory, changes: list[tuple[int, int, bytes]]
) -> None:
    text = bytearray(small_bvh(random_rows(3)).encode())
    for place, removed, piece in changes:
        at = place % (len(text) + 1)
        text[at : at + removed] = piece
    path = tmp_path_factory.getbasetemp() / "spoilt.bvh"
    path.write_bytes(text)
    with contextlib.suppress(FormatError):
        take = read_bvh(path).collect()
        assert np.isfinite(take.motion.translations.dense()).all()
        assert np.isfinite(take.motion.rotations.dense()).all()


@pytest.mark.parametrize("rows_a_block", [1, 2, 5])
def test_signs_continue_from_block_to_block(
    write,  # type: ignore[no-untyped-def]
    monkeypatch: pytest.MonkeyPatch,
    rows_a_block: int,
) -> None:
    rows = random_rows(40)
    # Every joint turns more than once, the one way and the other.
    rows[:, 3:] += np.linspace(0, 900, 40)[:, None] * [1, -1, 0.5, -0.7, 1, 0.3]
    path = write(small_bvh(rows))
    whole = read_bvh(path).collect().motion.rotations.dense()
    monkeypatch.setattr(lines_module, "BLOCK_VALUES", rows_a_block * COLUMNS)
    blocks = [block.rotations.dense() for block in read_bvh(path).blocks]
    assert len(blocks) == 40 // rows_a_block
    found = np.concatenate(blocks)
    assert_array_equal(found, whole)
    assert ((found[1:] * found[:-1]).sum(axis=-1) > 0).all()
    assert (found[..., 3] < 0).any()


def test_an_offset_on_an_axis_without_a_channel_keeps_the_bone(write) -> None:  # type: ignore[no-untyped-def]
    # 5 of 100 remain: not collapsed, whatever the unit.
    text = "HIERARCHY\nROOT hips\n{\nOFFSET 0 0 0\nCHANNELS 0\nJOINT leg\n{\n"
    text += "OFFSET 100 {side} 0\nCHANNELS 1 Xposition\nEnd Site\n{\nOFFSET 9 0 0\n}\n"
    text += "}\n}\nMOTION\nFrames: 2\nFrame Time: 0.1\n0\n0\n"
    for unit in (LengthUnit.MM, LengthUnit.CM, LengthUnit.M):
        for side, is_collapsed in (("5", False), ("0", True)):
            stream = read_bvh(write(text.replace("{side}", side)), unit=unit)
            stream.collect()
            assert ("BVH111" in [n.code for n in stream.notices]) is is_collapsed


def test_rows_of_another_take_after_the_frames(tmp_path: Path) -> None:
    path = tmp_path / "two.bvh"
    text = f"{MOTION_HEAD}Frames: 1\nFrame Time: .1\n{ROW}\n1 2\n1 2\n"
    path.write_text(text)
    with pytest.raises(FormatError) as caught:
        read_bvh(path).collect()
    (fault,) = caught.value.faults
    assert (fault.code, fault.lines) == ("BVH010", (FIRST + 3,))
    assert "1 frame of the header" in (fault.hint or "")
