"""OpenSim motion files: read on rigs, written, and refused where they are broken."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support.cli import animtool
from support.faults import raises

from animtool.core.clock import Clock
from animtool.core.errors import AnimtoolError
from animtool.formats.mot.coordinates import (
    column_names,
    coordinates_by_name,
    list_coordinates,
)
from animtool.formats.mot.read import read_mot, read_mot_rig
from animtool.formats.mot.write import build_mot_text
from animtool.formats.take_text import write_text
from animtool.maths import so3
from animtool.motion.motion import Channel, Motion
from animtool.motion.take import Take
from animtool.rig.joints import local_from_coordinates, project_to_coordinates
from animtool.rig.skeleton import Joint, JointType, Mimic, Rig
from animtool.rig.write import rig_text

HEAD = "Coordinates\nversion=1\nnRows=3\nnColumns=3\ninDegrees=yes\nendheader\n"
ROWS = "time\tknee\tlift\n0\t10\t.1\n0.01\t20\t.2\n0.02\t30\t.3\n"
# Its names are as nasty as names of joints get: a pin named like a ball's X column.
RIG = Rig(
    "leg",
    (
        Joint("hips", -1, JointType.FREE, (0, 1, 0), (0.6, 0, 0, 0.8)),
        Joint("hip", 0, JointType.BALL, (0.1, 0, 0)),
        Joint("knee", 1, JointType.PIN, (0, -0.4, 0), axis=(1.0, 0.0, 0.0)),
        Joint("lift", 2, JointType.PRISMATIC, axis=(0.0, 1.0, 0.0)),
        Joint("hip_x", 1, JointType.PIN),
        Joint("shadow", 1, JointType.PIN, mimic=Mimic("knee", 0.5, 0.1)),
        Joint("end", 3, JointType.FIXED, (0, -0.4, 0)),
    ),
)  # fmt: skip


@pytest.fixture
def write(tmp_path: Path) -> Callable[[str | bytes], Path]:
    def written(content: str | bytes) -> Path:
        path = tmp_path / "ik.mot"
        path.write_bytes(content.encode() if isinstance(content, str) else content)
        return path

    return written


@pytest.fixture
def rig_file(tmp_path: Path) -> Path:
    path = tmp_path / "leg.rig.yaml"
    path.write_text(rig_text(RIG), "utf-8")
    return path


def codes(notices: list[object]) -> list[str]:
    return [notice.code for notice in notices]  # type: ignore[attr-defined]


def coordinates(take: Take) -> np.ndarray:
    from animtool.rig.joints import LocalTransforms

    translations, rotations, _ = take.motion.dense()
    return project_to_coordinates(take.rig, LocalTransforms(translations, rotations))


def test_columns_are_coordinates_of_the_rig(
    write: Callable[[str], Path], rig_file: Path
) -> None:
    table = (
        "time hips_tx hips.translation.z hip_y knee.angle lift hip_x muscle\n"
        "1.00 .5 .25 90 -45 .1 30 7\n1.01 .5 .5 0 0 .2 31 8\n"
    )
    stream = read_mot(write("inDegrees=yes\nendheader\n" + table), rig=rig_file)
    take = stream.collect()
    assert take.fps == 100
    assert take.clock.start == 101
    assert codes(stream.notices) == ["MOF102"]
    assert "muscle" in stream.notices[0].message
    q = coordinates(take)
    half = np.sqrt(0.5)
    # Free 7, ball 4, knee, lift, hip_x, shadow.
    hips = [0.5, 0, 0.25, 0, 0, 0, 1]
    knee = -np.pi / 4
    others = [knee, 0.1, np.radians(30), 0.5 * knee + 0.1]
    assert q[0] == pytest.approx([*hips, 0, half, 0, half, *others], abs=1e-12)


def test_radians_and_what_says_nothing(
    write: Callable[[str], Path], rig_file: Path
) -> None:
    for header, factor, said in (
        ("inDegrees=no", 1.0, ["MOF112"]),
        ("Angles are in degrees.", np.pi / 180, []),
        ("datacolumns 3\ndatarows 3", np.pi / 180, []),
        ("version=1", 1.0, ["MOF107", "MOF112"]),
        ("inDegrees=maybe", 1.0, ["MOF107", "MOF112"]),
    ):
        stream = read_mot(write(f"{header}\nendheader\n{ROWS}"), rig=rig_file)
        assert codes(stream.notices) == said
        q = coordinates(stream.collect())
        turn = 2 * np.pi
        off = q[:, 11] - factor * np.array([10, 20, 30])
        assert off - turn * np.round(off / turn) == pytest.approx(np.zeros(3))
        # A slide is metres whatever the angles are in.
        assert q[:, 12] == pytest.approx([0.1, 0.2, 0.3])


def test_a_rig_of_its_own(write: Callable[[str], Path]) -> None:
    path = write(HEAD + ROWS.replace("lift", "pelvis_ty"))
    stream = read_mot(path)
    assert codes(stream.notices) == ["MOF106"]
    assert stream.rig == read_mot_rig(path)
    types = {joint.name: joint.type for joint in stream.rig.joints}
    assert types == {"knee": JointType.PIN, "pelvis_ty": JointType.PRISMATIC}


@pytest.mark.parametrize(
    ("column", "code"),
    [("77\t78\t79", ["MOF114"]), ("10.72958\t15.72958\t20.72958", [])],
)
def test_a_column_of_a_mimic_joint_is_used(
    write: Callable[[str], Path], tmp_path: Path, column: str, code: list[str]
) -> None:
    rig_file = tmp_path / "leg.rig.yaml"
    rig_file.write_text(rig_text(RIG), "utf-8")
    values = column.split()
    rows = "".join(f"{i / 100}\t{10 + 10 * i}\t{values[i]}\n" for i in range(3))
    stream = read_mot(write(f"{HEAD}time\tknee\tshadow\n{rows}"), rig=rig_file)
    assert codes(stream.notices) == code
    shadow = np.degrees(coordinates(stream.collect())[:, 14])
    assert shadow == pytest.approx([float(value) for value in values])


@pytest.mark.parametrize(
    ("first", "code", "start"),
    [(10.25, ["MOF113"], 513), (10.26, [], 514), (10.250004, ["MOF113"], 514)],
)
def test_starts_between_frames_are_noted(
    write: Callable[[str], Path], first: float, code: list[str], start: int
) -> None:
    rows = "".join(f"{first + i / 50:.6f}\t{i}\t0\n" for i in range(4))
    stream = read_mot(write(f"{HEAD}time\tknee\tlift\n{rows}".replace("=3", "=4")))
    assert [c for c in codes(stream.notices) if c == "MOF113"] == code
    assert stream.start == start


def test_names_with_separators_come_back(tmp_path: Path) -> None:
    names = ["a b", "a_b", "a,b", "a  b.x", "é\u00a0c"]
    rig = Rig(
        "odd", tuple(Joint(name, i - 1, JointType.PIN) for i, name in enumerate(names))
    )
    rig_file, path = tmp_path / "odd.rig.yaml", tmp_path / "odd.mot"
    rig_file.write_text(rig_text(rig), "utf-8")
    q = np.random.default_rng(1).uniform(-1, 1, (3, len(names)))
    local = local_from_coordinates(rig, q)
    motion = Motion(*map(Channel.from_dense, (local.translations, local.rotations)))
    clock = Clock(Fraction(100), Fraction(1), Fraction(1), 3)
    write_text(Take(rig, clock, motion), path, build_mot_text, overwrite=False)
    assert len(set(path.read_text("utf-8").splitlines()[6].split("\t"))) == 6
    stream = read_mot(path, rig=rig_file)
    assert "MOF102" not in codes(stream.notices)
    assert coordinates(stream.collect()) == pytest.approx(q, abs=1e-9)


def test_states_of_opensim(write: Callable[[str], Path]) -> None:
    table = (
        "time\t/jointset/knee_r/knee/value\t/jointset/knee_r/knee/speed\t/f/soleus\n"
        "0\t1\t2\t3\n0.1\t1\t2\t3\n"
    )
    stream = read_mot(write(f"inDegrees=no\nendheader\n{table}"))
    assert stream.rig.names == ["knee"]


@pytest.mark.parametrize("separator", ["\t", ",", "  ", " \t", ";"])
def test_separators_ends_of_lines_and_marks(
    write: Callable[[bytes], Path], separator: str
) -> None:
    text = (HEAD + ROWS.replace("lift", "a_tx").replace("\t", separator)).replace(
        "\n", "\r\n"
    )
    if separator == ",":
        text = text.replace("\r\n", ",,\r\n", 6)
    take = read_mot(write(b"\xef\xbb\xbf" + text.encode())).collect()
    assert coordinates(take)[:, 1].tolist() == [0.1, 0.2, 0.3]


@pytest.mark.parametrize(
    ("times", "rate", "start"),
    [
        # As printed with three places, at 240 and 120 Hz and NTSC film.
        ([0.0, 0.004, 0.008, 0.013, 0.017, 0.021, 0.025], 240, 1),
        ([f"{i / 120:.3f}" for i in range(100)], 120, 1),
        ([f"{1 + i * 1001 / 24000:.8f}" for i in range(50)], Fraction(24000, 1001), 25),
        ([f"{i / 59.3:.9f}" for i in range(50)], Fraction(593, 10), 1),
        ([-0.02, -0.01, 0.0], 100, -1),
    ],
)
def test_rates(
    write: Callable[[str], Path], times: list[object], rate: Fraction, start: int
) -> None:
    rows = "".join(f"{t}\t1\t2\n" for t in times)
    stream = read_mot(write(f"inDegrees=yes\nendheader\ntime\ta\tb\n{rows}"))
    assert "MOF105" not in codes(stream.notices)
    assert stream.fps == rate
    assert stream.start == start


def test_uneven_times_become_even(write: Callable[[str], Path]) -> None:
    times = [0.0, 0.1, 0.2, 0.35, 0.4, 0.5]
    rows = "".join(f"{t}\t{100 * t}\t0\n" for t in times)
    path = write(f"inDegrees=yes\nendheader\ntime\ta\tb\n{rows}")
    stream = read_mot(path)
    assert "MOF105" in codes(stream.notices)
    take = stream.collect()
    assert np.degrees(coordinates(take)[:, 0]) == pytest.approx([0, 10, 20, 30, 40, 50])
    assert read_mot(path, fps=24).collect().fps == 24


def test_decimal_commas_are_reported(write: Callable[[str], Path]) -> None:
    stream = read_mot(write(HEAD + ROWS.replace("lift", "a_tx").replace(".", ",")))
    assert codes(stream.notices) == ["MOF110", "MOF106"]
    assert coordinates(stream.collect())[:, 1].tolist() == [0.1, 0.2, 0.3]


@pytest.mark.parametrize(
    ("kind", "cell", "named"),
    [
        ("DataType=Quaternion\n", "1,0,0,0", "Quaternion"),
        ("DataType=Vec3\n", "1,0,0", "Vec3"),
        ("DataType=SpatialVec\n", "1,0,0,1,2,3", "SpatialVec"),
        ("", "1,0,0", "3 numbers"),
    ],
)
def test_cells_of_several_numbers_are_refused(
    write: Callable[[str], Path], kind: str, cell: str, named: str
) -> None:
    rows = f"0\t{cell}\t{cell}\n0.01\t{cell}\t{cell}\n"
    with raises(AnimtoolError, "MOF009", match=named):
        read_mot(write(f"{kind}endheader\ntime\ta\tb\n{rows}"))


@pytest.mark.parametrize(
    ("content", "code", "line"),
    [
        ("", "MOF001", None),
        (ROWS, "MOF001", None),
        ("x\n" * 5000 + HEAD + ROWS, "MOF001", None),
        (HEAD, "MOF002", 6),
        (HEAD + ROWS.replace("time", "frame"), "MOF002", 7),
        (HEAD + "time\n0\n1\n", "MOF002", 7),
        (HEAD + "time\ta\t\tb\n0\t1\t2\t3\n", "MOF002", 7),
        (HEAD + "time" + "".join(f"\t{i}" for i in range(10_001)) + "\n0", "MOF002", 7),
        (HEAD + "time\ta\tb\n", "MOF003", None),
        (HEAD + ROWS.replace("20\t", "20\t20\t"), "MOF003", 9),
        (HEAD + ROWS.replace("20\t", ""), "MOF003", 9),
        (HEAD + ROWS.replace("20", "2O"), "MOF003", 9),
        (HEAD + ROWS.replace("lift", "knee"), "MOF004", 7),
        (HEAD + ROWS.replace("0.01", "0.03"), "MOF005", 10),
        (HEAD + ROWS.replace("0.01", "0"), "MOF005", 9),
        (HEAD + ROWS.replace("0.01", "nan"), "MOF005", 9),
        (HEAD + ROWS.replace("0.02", "1e999"), "MOF005", 10),
        (HEAD + ROWS.replace("0.02", "1e300"), "MOF006", None),
        (HEAD + ROWS.replace("0.02", "1000"), "MOF006", None),
        (HEAD + "time\ta\n0\t1\n1e-300\t1\n", "MOF006", None),
        (HEAD + "time\ta\n1\t1\n", "MOF006", None),
    ],
)
def test_broken_files(
    write: Callable[[str], Path], content: str, code: str, line: int | None
) -> None:
    with pytest.raises(AnimtoolError) as error:
        read_mot(write(content))
    assert error.value.code == code
    assert error.value.faults[0].lines == (() if line is None else (line,))


def test_a_coordinate_given_twice(write: Callable[[str], Path], rig_file: Path) -> None:
    table = ROWS.replace("lift", "knee.angle")
    with raises(AnimtoolError, "MOF004"):
        read_mot(write(HEAD + table), rig=rig_file)


def test_a_rig_with_none_of_the_columns(
    write: Callable[[str], Path], rig_file: Path
) -> None:
    table = "time\tkneee\n0\t1\n1\t2\n"
    with pytest.raises(AnimtoolError) as error:
        read_mot(write(HEAD + table), rig=rig_file)
    assert error.value.code == "MOF007"
    assert error.value.faults[0].hint == "did you mean knee?"


def test_odd_files_are_read_with_a_word(write: Callable[[str], Path]) -> None:
    head = HEAD.replace("nRows=3", "nRows=" + "9" * 400).replace("3\nin", "99\nin")
    table = ROWS.replace("20", "nan").replace("10", "1e39").replace(".3", "inf")
    stream = read_mot(write(head + table + "0.03\t4"))
    said = codes(stream.notices)
    assert said == ["MOF103", "MOF101", "MOF104", "MOF106"]
    q = coordinates(stream.collect())
    assert np.isfinite(q).all()
    assert np.degrees(q[:, 0]) == pytest.approx([30, 30, 30])


@pytest.mark.slow
@settings(max_examples=60, deadline=None)
@given(
    st.lists(
        st.lists(st.floats(-1, 1), min_size=10, max_size=10), min_size=2, max_size=5
    )
)
def test_what_is_written_is_read_again(
    tmp_path_factory: pytest.TempPathFactory, rows: list[list[float]]
) -> None:
    folder = tmp_path_factory.mktemp("mot")
    raw = np.array(rows)
    turn = so3.exp(3.0 * raw[:, 3:6])
    ball = so3.exp(3.0 * raw[:, 6:9])
    knee = 5 * raw[:, 9:]
    q = np.concatenate(
        [raw[:, :3], turn, ball, knee, raw[:, :1], -knee, 0.5 * knee + 0.1], axis=1
    )
    local = local_from_coordinates(RIG, q)
    motion = Motion(
        Channel.from_dense(local.translations), Channel.from_dense(local.rotations)
    )
    take = Take(RIG, Clock(Fraction(30), Fraction(7), Fraction(1), len(q)), motion)
    rig = folder / "leg.rig.yaml"
    rig.write_text(rig_text(RIG), "utf-8")
    assert write_text(take, folder / "a.mot", build_mot_text, overwrite=False) == []
    again = read_mot(folder / "a.mot", rig=rig)
    assert again.notices == []
    found = again.collect()
    assert found.clock == take.clock
    back = found.world().positions
    assert back == pytest.approx(take.world().positions, abs=1e-8)
    write_text(
        replace(found, rig=RIG), folder / "b.mot", build_mot_text, overwrite=False
    )


def test_commands_read_and_write_it(
    write: Callable[[str], Path], rig_file: Path, tmp_path: Path
) -> None:
    path = write(HEAD + ROWS)
    rig = ["--rig", str(rig_file)]
    for words in (
        ["bake", str(path), *rig, "-o", "ik.usda"],
        ["convert", str(path), *rig, "again.mot"],
        ["convert", "ik.usda", "usd.mot"],
        ["info", str(path)],
    ):
        done = animtool(*words, cwd=tmp_path)
        assert done.code == 0, done.stderr
    table = (tmp_path / "again.mot").read_text().splitlines()
    assert table[:6] == [
        *HEAD.splitlines()[:3],
        f"nColumns={len(table[6].split())}",
        "inDegrees=yes",
        "endheader",
    ]
    knee = table[6].split().index("knee")
    assert [line.split()[knee] for line in table[7:]] == ["10", "20", "30"]
    (tmp_path / "bad.mot").write_text(HEAD)
    done = animtool("convert", "bad.mot", "bad.usda", cwd=tmp_path)
    assert done.code != 0
    assert "MOF002" in done.stderr
    assert not (tmp_path / "bad.usda").exists()


def test_names_that_clash_are_spelled_out() -> None:
    names = column_names(RIG, list_coordinates(RIG))
    assert "hip.rotation.x" in names
    assert names.count("hip_x") == 1
    known = coordinates_by_name(RIG)
    assert [known[name] for name in names] == list_coordinates(RIG)


def test_what_the_format_cannot_hold(tmp_path: Path) -> None:
    rig = Rig("door", (Joint("hinge", -1, JointType.PIN),))
    bent = so3.from_axis_angle((1.0, 0.0, 0.0), 0.5)[None, None]
    motion = Motion(
        Channel.from_dense(np.zeros((1, 1, 3))),
        Channel.from_dense(bent),
        scales=Channel.from_dense(np.full((1, 1, 3), 2.0)),
    )
    clock = Clock(Fraction(24), Fraction(1), Fraction(1), 1)
    take = Take(rig, clock, motion)
    assert codes(build_mot_text(take).notices) == ["MOF108", "MOF109"]
    fixed = Rig("wall", (Joint("stone", -1, JointType.FIXED),))
    with pytest.raises(AnimtoolError) as error:
        build_mot_text(replace(take, rig=fixed))
    assert error.value.code == "MOF008"
    assert not (tmp_path / "b.mot").exists()


def test_an_angle_unit_that_is_neither_yes_nor_no(write: Callable[[str], Path]) -> None:
    stream = read_mot(write(f"inDegrees=Maybe\nendheader\n{ROWS}"))
    (notice,) = [one for one in stream.notices if one.code == "MOF107"]
    assert "inDegrees is 'Maybe', not yes or no" in notice.message


def test_degrees_declared_as_radians(write: Callable[[str], Path]) -> None:
    rows = "time\tknee\thip\n0\t1\t2\n0.01\t170\t3\n"
    stream = read_mot(write(f"inDegrees=no\nendheader\n{rows}"))
    (notice,) = [one for one in stream.notices if one.code == "MOF112"]
    assert "'knee' reaches 170, which is 27.1 revolutions" in notice.message
    small = rows.replace("170", "12.5")
    notices = read_mot(write(f"inDegrees=no\nendheader\n{small}")).notices
    assert "MOF112" not in codes(notices)


@pytest.mark.parametrize(
    ("angle", "count", "travel", "found"),
    [
        (1.2, 8, 0.0, True),  # a body that stands, in radians
        (12.0, 8, 0.0, False),
        (1.2, 7, 0.0, False),  # a hand
        (5.0, 5, 1.0, True),  # a body that walks
        (40.0, 5, 1.0, False),
    ],
)
def test_radians_declared_as_degrees(
    write: Callable[[str], Path], angle: float, count: int, travel: float, found: bool
) -> None:
    names = "\t".join(["time", "pelvis_tx", *(f"angle_{i}" for i in range(count))])
    lines = [
        "\t".join(map(str, [0.01 * row, travel * row, *[angle * row] * count]))
        for row in range(2)
    ]
    text = "\n".join(["inDegrees=yes", "endheader", names, *lines, ""])
    assert ("MOF112" in codes(read_mot(write(text)).notices)) is found
