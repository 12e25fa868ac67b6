from __future__ import annotations

from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
from support.cli import animtool
from support.clips import RIG, hero, loaded, write_clip, write_rig

from animtool.clip.clip import Clip
from animtool.clip.file import check_clip, load_clip, open_clip
from animtool.core.errors import FormatError
from animtool.maths.curves import Extrapolation, Interp
from animtool.maths.tangents import Parametrization, Tangent
from animtool.rig.file import load_rig

GOOD = """\
- target: joint/hips.translation
  interp: linear
  pre: linear
  post: cycle_offset
  keys:
  - {t: 1, v: [1, 2, 3]}
  - {t: 2.5, v: [4, 5, 6], interp: step}
- target: joint/elbow_l.angle
  tangents: flat
  keys:
  - {t: 0, v: 0, out: [2, 30]}
  - {t: 8, v: 90, in: [-1, -9], out: auto}
- target: joint/shoulder_l.rotation
  keys:
  - {t: 0, v: [2, 0, 0, 0]}
  - {t: 4, v: [-0.6, 0, -0.8, 0], interp: slerp}
- target: joint/chest.rotation
  euler: ZXY
  interp: catmull_rom
  parametrization: centripetal
  keys:
  - {t: 0, v: [0, 0, 0]}
  - {t: 4, v: [720, 10, 20]}
- target: joint/piston.scale
  interp: tcb
  keys: [{t: 3, v: 2, tcb: [0.1, 0.2, 0.3]}]
"""


def test_a_good_clip(tmp_path: Path) -> None:
    clip, _ = loaded(tmp_path, GOOD)
    assert (clip.name, clip.fps, clip.first, clip.last) == ("shot", 24, 0, 8)
    hips, elbow, shoulder, chest, piston = clip.channels
    np.testing.assert_allclose(hips.values, [[0.01, 0.02, 0.03], [0.04, 0.05, 0.06]])
    assert hips.times.tolist() == [1.0, 2.5]
    assert hips.interps == (Interp.LINEAR, Interp.STEP)
    assert (hips.pre, hips.post) == (Extrapolation.LINEAR, Extrapolation.CYCLE_OFFSET)
    np.testing.assert_allclose(elbow.values, [[0.0], [np.pi / 2]])
    np.testing.assert_allclose(elbow.out_handles[0], [2, np.pi / 6])
    np.testing.assert_allclose(elbow.in_handles[1], [-1, -np.pi / 20])
    assert elbow.tangents == (
        (Tangent.FLAT, Tangent.FREE),
        (Tangent.FREE, Tangent.AUTO),
    )
    assert elbow.interps == (Interp.BEZIER, Interp.BEZIER)
    np.testing.assert_allclose(shoulder.values, [[0, 0, 0, 1], [0, 0.8, 0, 0.6]])
    assert shoulder.interps == (Interp.SPLINE, Interp.SLERP)
    assert (chest.euler, chest.parametrization) == ("ZXY", Parametrization.CENTRIPETAL)
    np.testing.assert_allclose(chest.values[1], np.radians([720, 10, 20]))
    assert piston.values.tolist() == [[2, 2, 2]]
    assert piston.tcb.tolist() == [[0.1, 0.2, 0.3]]


def test_units_of_the_clip_outrank_the_rigs(tmp_path: Path) -> None:
    head = "fps: 24\nunits: {length: m, angle: rad}"
    clip, _ = loaded(tmp_path, GOOD, head)
    assert clip.channels[0].values[0].tolist() == [1, 2, 3]
    assert clip.channels[1].values[1].tolist() == [90]
    assert clip.channels[3].values[1].tolist() == [720, 10, 20]


def test_units_of_the_rig(tmp_path: Path) -> None:
    text = RIG.replace("angle: deg", "angle: rad").replace("swing: 40", "swing: 1")
    rig = load_rig(write_rig(tmp_path, text.replace("[-45, 45]", "[-1, 1]")))
    clip = load_clip(open_clip(write_clip(tmp_path, GOOD)), rig)
    assert clip.channels[1].values[1].tolist() == [90]


@pytest.mark.parametrize(
    ("fps", "exact"),
    [
        ("24", Fraction(24)),
        ("23.976", Fraction(24000, 1001)),
        ("'24000/1001'", Fraction(24000, 1001)),
        ("29.97", Fraction(30000, 1001)),
        ("12.5", Fraction(25, 2)),
    ],
)
def test_rates(tmp_path: Path, fps: str, exact: Fraction) -> None:
    clip, _ = loaded(tmp_path, GOOD, f"fps: {fps}")
    assert clip.fps == exact


def test_the_range(tmp_path: Path) -> None:
    clip, _ = loaded(tmp_path, GOOD, "fps: 24\nrange: [-2, 100.5]")
    assert (clip.first, clip.last) == (-2, Fraction(201, 2))


def faults(tmp_path: Path, channels: str, head: str) -> list[tuple[str, int, str]]:
    rig = hero(tmp_path)
    with pytest.raises(FormatError) as caught:
        load_clip(open_clip(write_clip(tmp_path, channels, head)), rig)
    return [(f.code, f.lines[0], str(f)) for f in caught.value.faults]


PIN = "- target: joint/elbow_l.angle\n  keys:\n"
# Channels from line 5 on: what is planted, its code, its line, words that it says.
PLANTED = [
    ("- {target: elbow_l.angle, keys: [{t: 0, v: 0}]}", "CLIP001", 5, "/elbow_l.angle"),
    ("- {target: joint/elbow_l, keys: [{t: 0, v: 0}]}", "CLIP001", 5, ".angle"),
    ("- {target: joint/elbw_l.angle, keys: [{t: 0, v: 0}]}", "CLIP002", 5, "'elbow_l'"),
    ("- {target: control/grim, keys: [{t: 0, v: 0}]}", "CLIP002", 5, "'grin'"),
    ("- {target: shape/grin, keys: [{t: 0, v: 0}]}", "CLIP002", 5, "control/grin"),
    ("- {target: shape/smile, keys: [{t: 0, v: 0}]}", "CLIP002", 5, "none are defined"),
    ("- {target: joint/hips.angle, keys: [{t: 0, v: 0}]}", "CLIP003", 5, "translation"),
    ("- {target: joint/chest.translation, keys: [{t: 0, v: [0, 0, 0]}]}",
     "CLIP003", 5, "a ball joint"),
    (PIN + "  - {t: 2, v: 0}\n  - {t: 1, v: 0}", "CLIP004", 8, "the key at 2"),
    (PIN + "  - {t: 2, v: 0}\n  - {t: 2, v: 0}", "CLIP004", 8, "twice"),
    (PIN + "  - {t: 2, v: 0}\n  - {t: 50, v: 0}\n  - {t: 7, v: 0}\n  - {t: 9, v: 0}",
     "CLIP004", 8, "such as 5"),
    (PIN + "  - {t: 2, v: 0}\n  - {t: 9, v: 0}\n  - {t: 5, v: 0}\n  - {t: 12, v: 0}",
     "CLIP004", 9, "the key at 9"),
    (PIN + "  - {t: 2.0e9, v: 0}", "CLIP004", 7, "beyond"),
    (PIN + "  - {t: 0, v: 0}\n  - {t: 9, v: 0, in: [1, 0]}", "CLIP005", 8, "'in'"),
    (PIN + "  - {t: 0, v: 0, out: [-1, 0]}", "CLIP005", 7, "'out'"),
    ("- target: joint/hips.translation\n  keys:\n  - {t: 0, v: 2.1}",
     "CLIP007", 7, "1 number instead of 3; write [x, y, z]"),
    ("- target: joint/hips.rotation\n  euler: ZXY\n  keys:\n  - {t: 0, v: 2}",
     "CLIP007", 8, "write [z, x, y]"),
    (PIN + "  - {t: 0, v: [1, 2]}", "CLIP007", 7, "write one number"),
    ("- target: joint/hips.rotation\n  keys:\n  - {t: 0, v: [1, 2, 3]}",
     "CLIP007", 7, "3 numbers instead of 4"),
    (PIN + "  - {t: 0, v: 0, out: [1, [2, 3]]}", "CLIP007", 7, "1 value"),
    (PIN + "  - {t: 0, v: 0, interp: slerp}", "CLIP009", 7, "slerp does not apply"),
    ("- target: joint/hips.rotation\n  interp: bezier\n"
     "  keys: [{t: 0, v: [1, 0, 0, 0]}]", "CLIP009", 6, "squad"),
    ("- target: joint/elbow_l.angle\n  euler: XYZ\n  keys: [{t: 0, v: 0}]",
     "CLIP009", 6, "not a rotation"),
    ("- {target: control/grin, keys: [{t: 0, v: 0}]}\n"
     "- {target: control/grin, keys: [{t: 0, v: 0}]}", "CLIP010", 6, "line 5"),
    ("- {target: joint/hips.rotation, keys: [{t: 0, v: [1, 0, 0, 0]}]}\n"
     "- {target: joint/hips.local_rotation, keys: [{t: 0, v: [1, 0, 0, 0]}]}",
     "CLIP010", 6, "line 5"),
    ("- {target: joint/elbow_l.local_rotation, keys: [{t: 0, v: [1, 0, 0, 0]}]}\n"
     "- {target: joint/elbow_l.angle, keys: [{t: 0, v: 0}]}",
     "CLIP010", 6, "line 5"),
    ("- {target: joint/piston.slide, keys: [{t: 0, v: 0}]}\n"
     "- {target: joint/piston.local_translation, keys: [{t: 0, v: [1, 0, 0]}]}",
     "CLIP010", 6, "line 5"),
    ("- target: joint/hips.rotation\n  keys:\n  - {t: 0, v: [0, 0, 0, 0]}",
     "RIG006", 7, "zero length"),
    (PIN + "  - {t: 0, v: .nan}", "DOC022", 7, "finite"),
    (PIN + "  - {t: .inf, v: 0}", "DOC022", 7, "finite"),
    (PIN + "  - {t: 0, v: 0, interp: besier}", "DOC022", 7, "bezier"),
    (PIN + "  - {t: 0, v: 0, ease: 1}", "DOC020", 7, "ease"),
    ("- {target: control/grin, keys: []}", "DOC022", 5, "0 items"),
]  # fmt: skip


@pytest.mark.parametrize(("channels", "code", "line", "words"), PLANTED)
def test_a_planted_fault(
    tmp_path: Path, channels: str, code: str, line: int, words: str
) -> None:
    found = faults(tmp_path, channels, "fps: 24")
    assert [(c, n) for c, n, _ in found] == [(code, line)], found
    assert words in found[0][2]


@pytest.mark.parametrize(
    ("head", "code"),
    [
        ("fps: 24\nrange: [9, 1]", "CLIP006"),
        ("fps: 24\nrange: [0, 2.0e9]", "CLIP006"),
        ("\nfps: fast", "SCN022"),
        ("\nfps: 0", "SCN022"),
        ("\nfps: -24", "SCN022"),
        ("\nfps: 1/0", "SCN022"),
        ("\nfps: .nan", "DOC022"),
    ],
)
def test_a_fault_of_the_head(tmp_path: Path, head: str, code: str) -> None:
    good = "- {target: control/grin, keys: [{t: 0, v: 0}]}"
    found = faults(tmp_path, good, head)
    assert [(c, n) for c, n, _ in found] == [(code, 4)], found


def test_no_channels(tmp_path: Path) -> None:
    assert [f[0] for f in faults(tmp_path, "  []\n", "fps: 24")] == ["CLIP013"]


def test_a_rig_outside_the_project(tmp_path: Path) -> None:
    path = write_clip(tmp_path, GOOD)
    path.write_text(path.read_text().replace("hero.rig", "../hero.rig"))
    with pytest.raises(FormatError) as caught:
        check_clip(open_clip(path))
    (fault,) = caught.value.faults
    assert (fault.code, fault.lines) == ("DOC014", (2,))


def test_all_faults_in_one_go(tmp_path: Path) -> None:
    chosen = [
        fault
        for fault in PLANTED
        if fault[1].startswith("CLIP") and fault[1] not in {"CLIP010"}
    ]
    text, expected, line = "", [("CLIP006", 3), ("SCN022", 4)], 6
    for channels, code, at, _ in chosen:
        text += channels + "\n"
        expected.append((code, line + at - 5))
        line += channels.count("\n") + 1
    found = faults(tmp_path, text, "range: [2, 1]\nfps: 0")
    said = [(code, at) for code, at, _ in found if code != "CLIP010"]
    assert said == expected


def test_every_value_of_a_wrong_width_is_named(tmp_path: Path) -> None:
    keys = "  - {t: 0, v: [1, 2]}\n  - {t: 1, v: [1, 2], in: [1, 0]}"
    found = faults(tmp_path, PIN + keys, "fps: 24")
    assert [(c, n) for c, n, _ in found] == [
        ("CLIP007", 7),
        ("CLIP007", 8),
        ("CLIP005", 8),
    ]


MIXED = """\
clip: animtool/1
rig: hero.rig.yaml
fps: fast
range: [9]
channels:
- target: joint/elbow_l.angel
  keys: [{t: 0, v: 0}, {t: 0, v: 0}]
- target: joint/hips.rotation
  euler: XYX
  keys: [{t: 0, v: [0, 0, 0]}, {t: 1, v: [0, 0, 0], in: [3, [0, 0, 0]]}]
- target: joint/chest.rotation
  keys:
  - {t: 0, v: [1, 0, 0, 0], tcb: [0, 0, 0]}
  - {t: soon, v: [1, 0, 0, 0]}
  - {t: 2, vv: [1, 0, 0, 0]}
- {target: control/grin, pre: hold, keys: [{t: 0, v: [x]}]}
"""
MIXED_FAULTS = [
    ("SCN022", 3),
    ("DOC022", 4),
    ("CLIP001", 6),
    ("CLIP004", 7),
    ("DOC022", 9),
    ("CLIP005", 10),
    ("CLIP009", 13),
    ("DOC022", 14),
    ("DOC020", 15),
    ("DOC022", 16),
]


def test_ten_mixed_faults_in_one_go(tmp_path: Path) -> None:
    path = write_clip(tmp_path, "")
    path.write_text(MIXED)
    with pytest.raises(FormatError) as caught:
        load_clip(open_clip(path), hero(tmp_path))
    found = caught.value.faults
    assert [(f.code, f.lines[0]) for f in found] == MIXED_FAULTS, caught.value


def test_ten_mixed_faults_are_printed(tmp_path: Path) -> None:
    write_rig(tmp_path)
    path = tmp_path / "shot.clip.yaml"
    path.write_text(MIXED)
    done = animtool("bake", path, "-o", tmp_path / "shot.usda")
    assert done.code == 3
    said = [line.removeprefix(f"{path}:").split() for line in done.fault_lines]
    assert [(c, int(at.split(":")[0])) for at, c, *_ in said] == MIXED_FAULTS
    assert sorted(p.name for p in tmp_path.iterdir()) == [
        "hero.rig.yaml",
        "shot.clip.yaml",
    ]


def test_faults_of_a_clip_and_its_rig_in_one_go(tmp_path: Path) -> None:
    rig = write_rig(tmp_path, RIG.replace("axis: [1,", "axis: [x,"))
    path = write_clip(tmp_path, PIN + "  - {t: 0, v: x}\n  - {t: 0, v: 1}\n")
    done = animtool("bake", path, "-o", tmp_path / "shot.usda")
    assert done.code == 3
    said = [line.split()[:2] for line in done.fault_lines]
    assert [(at.split(":")[0], code) for at, code in said] == [
        (str(path), "DOC022"),
        (str(path), "CLIP004"),
        (str(rig), "DOC022"),
    ]


@pytest.mark.parametrize(
    ("entry", "line"),
    [
        ("  tangents: flat\n  keys: [{t: 0, v: [1, 0, 0, 0]}]", 6),
        ("  parametrization: chordal\n  keys: [{t: 0, v: [1, 0, 0, 0]}]", 6),
        ("  keys:\n  - {t: 0, v: [1, 0, 0, 0], in: [-1, 0]}", 7),
        ("  keys:\n  - {t: 0, v: [1, 0, 0, 0], out: flat}", 7),
        ("  keys:\n  - {t: 0, v: [1, 0, 0, 0], tcb: [0, 0, 0]}", 7),
    ],
)
def test_quaternions_have_no_slopes(tmp_path: Path, entry: str, line: int) -> None:
    text = f"- target: joint/hips.rotation\n{entry}"
    ((code, at, words),) = faults(tmp_path, text, "fps: 24")
    assert (code, at) == ("CLIP009", line)
    assert "euler" in words


def test_a_misspelt_part_gives_the_nearest(tmp_path: Path) -> None:
    text = "- {target: joint/elbow_l.angel, keys: [{t: 0, v: 0}]}"
    ((code, _, words),) = faults(tmp_path, text, "fps: 24")
    assert code == "CLIP001"
    assert "did you mean '.angle'?" in words


@pytest.mark.parametrize(
    ("keys", "places"),
    [
        ("interp: linear, keys: [{t: 0, v: 1, tcb: [0, 0, 1]}, {t: 1, v: 2}]", ["tcb"]),
        ("interp: tcb, keys: [{t: 0, v: 1}, {t: 1, v: 2, tcb: [0, 0, 1]}]", []),
        ("interp: step, keys: [{t: 0, v: 1, out: [1, 0]}, {t: 1, v: 2}]", ["out"]),
        ("interp: catmull_rom, keys: [{t: 0, v: 1}, {t: 1, v: 2, in: flat}]", ["in"]),
        ("interp: tcb, keys: [{t: 0, v: 1}, {t: 1, v: 2, in: flat}]", ["in"]),
        ("interp: linear, keys: [{t: 0, v: 1, in: flat}, {t: 1, v: 2, out: flat}]", []),
        ("keys: [{t: 0, v: 1, out: flat}, {t: 1, v: 2, interp: step, in: flat}]", []),
        (
            "parametrization: chordal, keys: [{t: 0, v: 1}, {t: 1, v: 2}]",
            ["parametrization"],
        ),
        (
            "interp: catmull_rom, parametrization: chordal, "
            "keys: [{t: 0, v: 1}, {t: 1, v: 2}]",
            [],
        ),
    ],
)
def test_keys_that_do_nothing_are_pointed_out(
    tmp_path: Path, keys: str, places: list[str]
) -> None:
    rig = hero(tmp_path)
    file = open_clip(write_clip(tmp_path, f"- {{target: control/grin, {keys}}}\n"))
    load_clip(file, rig)
    found = file.document.notices
    assert [fault.code for fault in found] == ["CLIP104"] * len(places)
    assert [fault.where.split(".")[-1] for fault in found if fault.where] == places
    assert all(fault.lines == (5,) for fault in found)
    assert Clip.load(file.document.path, rig).notices == tuple(found)


def test_keys_that_do_nothing_are_errors_where_warnings_are(tmp_path: Path) -> None:
    hero(tmp_path)
    channel = "- {target: control/grin, interp: linear, "
    channel += "keys: [{t: 0, v: 1, out: flat}, {t: 1, v: 1}]}\n"
    clip = write_clip(tmp_path, channel)
    done = animtool("bake", clip, "-o", tmp_path / "o.usda", "--strict")
    assert done.code != 0
    assert "shot.clip.yaml:5:" in done.stderr
    assert "CLIP104" in done.stderr
    assert not (tmp_path / "o.usda").exists()


OTHER_RIG = """\
rig: animtool/1
name: other
joints:
- {name: Hips, type: free}
- {name: Spine, type: ball, parent: Hips}
- {name: Head, type: ball, parent: Spine}
controls:
- {name: nod, drives: [{joint: Head.rotation.x, expr: nod}]}
"""


def blamed(folder: Path, targets: list[str], own: str = "") -> list[tuple[str, str]]:
    """Return code and place of the faults of a clip on the rig of other tests."""
    rig = hero(folder)
    (folder / "other.rig.yaml").write_text(OTHER_RIG, "utf-8")
    lines = [f"- {{target: {target}, keys: [{{t: 1, v: 0}}]}}" for target in targets]
    path = write_clip(folder, "\n".join(lines) + "\n", "fps: 24")
    text = path.read_text("utf-8")
    rows = [row for row in text.splitlines() if not row.startswith("rig:")]
    rows[1:1] = [f"rig: {own}"] * bool(own)
    path.write_text("\n".join(rows) + "\n", "utf-8")
    with pytest.raises(FormatError) as caught:
        load_clip(open_clip(path), rig)
    return [(fault.code, fault.where or "") for fault in caught.value.faults]


def test_targets_of_another_rig_are_one_fault(tmp_path: Path) -> None:
    targets = ["control/nod", "joint/Hips.scale", "joint/Head.scale"]
    own = "other.rig.yaml"
    assert blamed(tmp_path, targets, own) == [("CLIP002", "rig")]
    # A single target, of those that only its own rig has.
    assert blamed(tmp_path, ["control/nod"], own) == [("CLIP002", "rig")]
    assert len(blamed(tmp_path, [*targets, "joint/Foot.scale"])) == 1


def test_misspelt_targets_are_a_fault_each(tmp_path: Path) -> None:
    targets = ["joint/elbw_l.angle", "joint/sholder_l.scale", "control/gri"]
    assert [code for code, _ in blamed(tmp_path, targets)] == ["CLIP002"] * 3


def test_names_of_parts_of_the_body_are_those_of_another_rig(tmp_path: Path) -> None:
    # A part of the body is a hint, but not a typing error.
    targets = [f"joint/{name}.scale" for name in ("LeftForeArm", "LeftUpLeg", "Jaw")]
    assert len(blamed(tmp_path, targets)) == 1
