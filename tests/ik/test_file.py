"""Targets files: every fault with its line, and what comes of sound ones."""

from __future__ import annotations

from fractions import Fraction
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from numpy.testing import assert_allclose
from support.faults import raises, refused
from support.targets import HEAD, legs, tracks_of, write_targets

from animtool.core.clock import Clock
from animtool.core.errors import FormatError, OptionError
from animtool.ik.file import _TargetsReader, load_targets
from animtool.ik.values import SampleFrames
from animtool.validation.run import validate

FAULTS = {
    "TGT001": "- {effector: leg_lft, position: [0, 0, 0]}",
    "TGT002": "- {effector: leg_l}",
    "TGT005": "- {effector: leg_l, hold: [[9, 2]]}",
    "TGT006": "- {effector: leg_l, position: 'arrays.npz#short'}",
    "TGT007": "- {effector: leg_l, orientation: [0, 0, 0, 0]}",
    "TGT008": "- {effector: leg_l, aim: {axis: [0, 0, 0], at: [0, 0, 1]}}",
    "TGT009": "- {effector: leg_l, position: {offset: [0, 0, 1]}}",
    "DOC014": "- {effector: leg_l, position: ../../arrays.npz}",
    "TGT012": "- {effector: leg_l, root: knee_r, position: [0, 0, 0]}",
    "CLIP004": "- {effector: leg_l, position: {keys: [{t: 2, v: [0, 0, 0]}, "
    "{t: 1, v: [0, 0, 0]}]}}",
    "CLIP007": "- {effector: leg_l, position: {keys: [{t: 2, v: 0}]}}",
    "RIG006": "- {effector: leg_l, orientation: {keys: [{t: 2, v: [0, 0, 0, 0]}]}}",
    "DOC020": "- {effector: leg_l, positon: [0, 0, 0], hold: [[1, 2]]}",
    "DOC021": "- {position: [0, 0, 0]}",
    "DOC022": "- {effector: leg_l, position: [0, .nan, 0]}",
}
MORE = [
    ("TGT001", "- {effector: leg_l, root: knees, position: [0, 0, 0]}"),
    ("TGT002", "- {effector: leg_l, pole: [0, 0, 0]}"),
    ("TGT002", "- {effector: leg_l, position: [0, 0, 0], weight: 0}"),
    ("TGT005", "- {effector: leg_l, hold: [[1, 5], [5, 8]]}"),
    ("TGT005", "- {effector: leg_l, hold: [[1, 1e12]]}"),
    ("TGT005", "- {effector: leg_l, position: [0, 0, 0], during: [[9, 2]]}"),
    ("TGT002", "- {effector: leg_l, during: [[1, 2]]}"),
    ("TGT006", "- {effector: leg_l, position: arrays.npz#wide}"),
    ("TGT006", "- {effector: leg_l, position: arrays.npz#nothing}"),
    ("TGT006", "- {effector: leg_l, position: missing.npz}"),
    ("TGT007", "- {effector: leg_l, position: arrays.npz#holes}"),
    ("TGT007", "- {effector: leg_l, orientation: arrays.npz#zeros}"),
    (
        "TGT007",
        "- {effector: leg_l, hold: [[1, 2]], weight: {position: {keys: "
        "[{t: 1, v: -1}]}}}",
    ),
    ("TGT009", "- {effector: leg_l, position: {prim: /World/prop}}"),
    (
        "TGT009",
        "- {effector: leg_l, position: {prim: /P, file: s.usda, "
        "keys: [{t: 1, v: [0, 0, 0]}]}}",
    ),
    (
        "TGT009",
        "- {effector: leg_l, orientation: {keys: [{t: 1, v: [1, 0, 0, 0]}], "
        "rotate: [1, 0, 0, 0]}}",
    ),
    ("DOC015", "- {effector: leg_l, position: {prim: /World/prop, file: no.usda}}"),
    (
        "CLIP009",
        "- {effector: leg_l, position: {euler: XYZ, keys: [{t: 1, v: [0, 0, 0]}]}}",
    ),
    ("DOC022", "- {effector: leg_l, position: [0, 0]}"),
    ("DOC022", "- {effector: leg_l, hold: [[1, 2]], ease: -1}"),
    ("DOC022", "- {effector: leg_l, hold: [[1, 2, 3]]}"),
]


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Return a folder with arrays for a range of 5 frames."""
    places = np.arange(15.0).reshape(5, 3)
    holes = places.copy()
    holes[3, 1] = np.nan
    np.savez(
        tmp_path / "arrays.npz",
        places=places,
        turns=np.tile([0.8, 0, 0.6, 0], (5, 1)),
        short=places[:4],
        wide=np.zeros((5, 4)),
        holes=holes,
        zeros=np.zeros((5, 4)),
    )
    return tmp_path


@pytest.mark.parametrize(("code", "goal"), [*FAULTS.items(), *MORE])
def test_each_fault_has_its_line(folder: Path, code: str, goal: str) -> None:
    with refused((code, 6)):
        tracks_of(folder, goal, head=HEAD + "range: [1, 5]\n")


@pytest.mark.parametrize(
    ("value", "hint"),
    [
        ("position: 1.2", "position: [0.3, 1.1, 0.4]"),
        ("position: [1, 2]", "position: [0.3, 1.1, 0.4]"),
        ("position: [0,1, 2, 3,4]", "write [0.1, 2, 3.4]"),
        ("position: 1.2 m", "write [x, y, z]"),
        ("position: {keys: [[1, 1.2]]}", "keys: [{t: 1, v: 1.2}]"),
        ("orientation: 90", "orientation: [1, 0, 0, 0]"),
    ],
)
def test_a_value_of_another_form_shows_the_right_one(
    folder: Path, value: str, hint: str
) -> None:
    with pytest.raises(FormatError) as caught:
        tracks_of(folder, f"- {{effector: leg_l, {value}}}")
    (fault,) = caught.value.faults
    assert hint in (fault.hint or "")


@pytest.mark.parametrize(
    ("effector", "root", "hint"),
    [
        ("hip_l", "ankle_l", "write effector: ankle_l, root: hip_l"),
        ("leg_l", "hip_r", "did you mean 'hip_l'?"),
        ("leg_l", "knee_r", "did you mean 'knee_l'?"),
        ("hips", "ankle_r", "write effector: ankle_r, root: hips"),
    ],
)
def test_a_root_below_its_effector_says_what_to_write(
    folder: Path, effector: str, root: str, hint: str
) -> None:
    goal = f"- {{effector: {effector}, root: {root}, position: [0, 0, 0]}}"
    with pytest.raises(FormatError) as caught:
        tracks_of(folder, goal, head=HEAD + "range: [1, 5]\n")
    (fault,) = caught.value.faults
    assert (fault.code, fault.lines) == ("TGT012", (6,))
    assert hint in (fault.hint or "")


@pytest.mark.parametrize(
    ("head", "code", "line"),
    [
        ("targets: animtool/1\nrange: [9, 1]\n", "CLIP006", 2),
        ("targets: animtool/1\nrange: [1, 1e12]\n", "CLIP006", 2),
        ("targets: animtool/1\nfps: fast\n", "SCN022", 2),
        ("targets: animtool/2\n", "DOC012", 1),
        ("clip: animtool/1\n", "DOC009", 1),
        ("targets: animtool/1\nunits: {length: ells}\n", "DOC022", 2),
    ],
)
def test_faults_of_the_head(tmp_path: Path, head: str, code: str, line: int) -> None:
    with refused((code, line)):
        tracks_of(tmp_path, "- {effector: leg_l, hold: [[1, 2]]}", head=head)


def test_a_clip_is_told_how_it_is_used(tmp_path: Path) -> None:
    with pytest.raises(FormatError) as caught:
        tracks_of(tmp_path, "", head="clip: animtool/1\n")
    [fault] = caught.value.faults
    assert fault.code == "DOC009"
    assert "--clip" in (fault.hint or "")
    assert "--match" in (fault.hint or "")


def test_all_faults_are_said_at_once(folder: Path) -> None:
    path = write_targets(folder, "\n".join(FAULTS.values()), HEAD + "range: [1, 5]\n")
    with refused(*((code, 6 + i) for i, code in enumerate(FAULTS))):
        load_targets(path, legs())


def test_the_nearest_effector_is_named(folder: Path) -> None:
    with raises(FormatError, "TGT001", match="'leg_l'"):
        tracks_of(folder, FAULTS["TGT001"])


def test_without_goals_there_is_nothing_to_load(tmp_path: Path) -> None:
    path = tmp_path / "none.targets.yaml"
    path.write_text("targets: animtool/1\ngoals: []\n")
    with pytest.raises(FormatError) as caught:
        load_targets(path, legs())
    assert caught.value.code == "DOC022"


def test_a_chain_is_its_tip(folder: Path) -> None:
    tracks = tracks_of(folder, "- {effector: leg_l, position: [0, 0, 0]}")
    goal = tracks.goals[0].goal
    assert (goal.joint, goal.root) == ("ankle_l", "hip_l")
    assert [kind.name for kind in goal.kinds] == ["position"]
    assert goal.position == 1
    tracks = tracks_of(folder, "- {effector: ankle_l, position: [0, 0, 0]}")
    assert tracks.goals[0].goal.root is None
    assert tracks.goals[0].chain is None


def test_what_a_chain_holds(folder: Path) -> None:
    held = {
        "- {effector: leg_l, hold: [[1, 2]]}": {"position", "orientation"},
        "- {effector: tail, hold: [[1, 2]]}": {"position", "orientation"},
        "- {effector: leg_l, position: [0, 0, 0], hold: [[1, 2]]}": {"position"},
    }
    for goal, parts in held.items():
        assert tracks_of(folder, goal).goals[0].hold_parts == parts


def test_lengths_are_of_the_file_or_else_of_the_rig(folder: Path) -> None:
    from dataclasses import replace

    goal = "- {effector: leg_l, offset: [1, 0, 0], position: [0, 50, 0]}"
    inches = replace(legs(), meters_per_unit=0.0254)
    for head, unit in (
        ("targets: animtool/1\n", 0.0254),
        ("targets: animtool/1\nunits: {length: cm}\n", 0.01),
    ):
        track = tracks_of(folder, goal, inches, head).goals[0]
        value = track.values["position"]
        assert value is not None
        found = value.sample(SampleFrames(np.ones(1), Fraction(24)))
        assert_allclose(found, [[0, 50 * unit, 0]])
        assert_allclose(track.goal.offset, [unit, 0, 0])


@pytest.mark.parametrize(
    ("position", "expected"),
    [
        ("[1, 2, 3]", [[1, 2, 3], [1, 2, 3]]),
        ("arrays.npz#places", [[3, 4, 5], [4.5, 5.5, 6.5]]),
        (
            "{interp: linear, keys: [{t: 1, v: [0, 0, 0]}, {t: 3, v: [4, 0, 8]}]}",
            [[2, 0, 4], [3, 0, 6]],
        ),
    ],
)
def test_values(folder: Path, position: str, expected: list[list[float]]) -> None:
    goal = f"- {{effector: leg_l, position: {position}}}"
    tracks = tracks_of(folder, goal, head=HEAD + "range: [1, 5]\n")
    value = tracks.goals[0].values["position"]
    assert value is not None
    found = value.sample(SampleFrames(np.array([2.0, 2.5]), Fraction(24)))
    assert_allclose(found, expected)


def test_orientations_are_read_w_first(folder: Path) -> None:
    for given in ("[0.8, 0, 0.6, 0]", "arrays.npz#turns",
                  "{keys: [{t: 1, v: [8, 0, 6, 0]}]}"):  # fmt: skip
        goal = f"- {{effector: leg_l, orientation: {given}}}"
        value = tracks_of(folder, goal).goals[0].values["orientation"]
        assert value is not None
        found = value.sample(SampleFrames(np.ones(1), Fraction(24)))
        assert_allclose(found, [[0, 0.6, 0, 0.8]])


def test_euler_angles_are_those_of_clips(folder: Path) -> None:
    goal = (
        "- {effector: leg_l, orientation: {euler: ZXY, keys: [{t: 1, v: [90, 0, 0]}]}}"
    )
    value = tracks_of(folder, goal).goals[0].values["orientation"]
    assert value is not None
    half = 0.5**0.5
    found = value.sample(SampleFrames(np.ones(1), Fraction(24)))
    assert_allclose(found, [[0, 0, half, half]], atol=1e-15)


def test_a_weight_that_does_nothing_is_pointed_out(folder: Path) -> None:
    goal = "- {effector: leg_l, position: [0, 0, 0], weight: {aim: 2}}"
    tracks = tracks_of(folder, goal)
    assert [notice.code for notice in tracks.notices] == ["TGT101"]


def test_the_key_with_a_weight_below_0_is_named(folder: Path) -> None:
    """The second one: the first is between 0 and 1."""
    keys = "{keys: [{t: 1, v: 0.5}, {t: 3, v: -0.25}, {t: 4, v: -1}]}"
    goal = f"- {{effector: leg_l, position: [0, 0, 0], weight: {{position: {keys}}}}}"
    with pytest.raises(FormatError) as caught:
        tracks_of(folder, goal)
    (fault,) = caught.value.faults
    assert (fault.code, fault.message) == ("TGT007", "weight -0.25 is less than 0")
    assert "keys[1].v" in str(fault.where)


def test_the_clock_is_the_range_or_all_that_is_mentioned(folder: Path) -> None:
    goal = "- {effector: leg_l, position: arrays.npz#places, hold: [[4, 9]]}"
    whole = tracks_of(folder, goal).clock
    assert (whole.start, whole.count, whole.fps) == (1, 9, 24)
    ranged = tracks_of(folder, goal, head=HEAD + "range: [101, 105]\n").clock
    assert (ranged.start, ranged.count) == (101, 5)
    constant = tracks_of(folder, "- {effector: leg_l, position: [0, 0, 0]}").clock
    assert (constant.start, constant.count) == (1, 1)


def test_frames_of_another_rate_or_length_are_refused(folder: Path) -> None:
    clock = Clock(Fraction(30), Fraction(1), Fraction(1), 7)
    tracks = tracks_of(folder, "- {effector: leg_l, position: arrays.npz#places}")
    with pytest.raises(OptionError) as caught:
        tracks.at_clock(clock)
    faults = caught.value.faults
    assert [fault.code for fault in faults] == ["TGT014", "TGT015"]
    places = [(fault.path, fault.lines[0], fault.column) for fault in faults]
    assert places == [(str(tracks.path), 3, 6), (str(tracks.path), 5, 31)]


def test_a_file_is_checked_without_its_rig(folder: Path) -> None:
    path = write_targets(folder, "- {effector: nobody, position: [0, 0, 0]}")
    assert load_targets(path).goals[0].name == "nobody"
    path = write_targets(folder, FAULTS["TGT008"])
    with pytest.raises(FormatError):
        load_targets(path)


def test_json_is_read_too(tmp_path: Path) -> None:
    path = tmp_path / "feet.targets.json"
    path.write_text('{"targets": "animtool/1", "goals": [{"effector": "leg_l", '
                    '"position": [0, 0, 1]}]}')  # fmt: skip
    assert load_targets(path, legs()).goals[0].goal.joint == "ankle_l"


@pytest.mark.parametrize(
    ("given", "length", "angle"),
    [
        ((None, None), 0.01, 2.0),
        (("mm", None), 0.001, 2.0),
        ((None, "deg"), 0.01, np.pi / 180),
        (("m", "rad"), 1.0, 1.0),
    ],
)
@pytest.mark.parametrize("has_rig", [True, False])
def test_units_are_those_of_the_file_or_of_the_rig(
    given: tuple[str | None, str | None], length: float, angle: float, has_rig: bool
) -> None:
    own = SimpleNamespace(meters_per_unit=0.01, radians_per_unit=2.0)
    units = SimpleNamespace(length=given[0], angle=given[1])
    reader = SimpleNamespace(
        rig=own if has_rig else None, model=SimpleNamespace(units=units)
    )
    found = _TargetsReader._read_units(reader)  # type: ignore[arg-type]
    assert found.length == (length if has_rig or given[0] else 1.0)
    assert found.angle == pytest.approx(angle if has_rig or given[1] else np.pi / 180)


def test_a_missing_prim_is_found_without_a_rig(tmp_path: Path) -> None:
    (tmp_path / "s.usda").write_text('#usda 1.0\ndef Xform "prop" {}\n', "utf-8")
    path = tmp_path / "page.targets.yaml"
    goal = "- {effector: hand, position: {prim: /PRIM, file: s.usda}}\n"
    text = "targets: animtool/1\nfps: 24\ngoals:\n" + goal
    path.write_text(text.replace("PRIM", "prip"), "utf-8")
    (fault,) = validate(path)
    assert (fault.code, fault.where) == ("TGT011", "goals[0].position.prim")
    assert fault.hint == "did you mean /prop?"
    path.write_text(text.replace("PRIM", "prop"), "utf-8")
    assert not validate(path)


TURNED = "- {effector: leg_l, orientation: [0, 0, 0, 1]}"


@pytest.mark.parametrize(
    ("goals", "codes"),
    [
        (TURNED, ["TGT108"]),
        (
            "- {effector: leg_l, orientation: {keys: [{t: 1, v: [0, 0, 0, 1]}]}}",
            ["TGT108"],
        ),
        (TURNED.replace("0, 1]", "0, -1]"), []),
        (f"{TURNED}\n- {{effector: leg_r, orientation: [1, 0, 0, 0]}}", []),
        ("- {effector: leg_l, orientation: [1, 1, 0, 0]}", ["RIG110"]),
        ("- {effector: leg_l, orientation: [0.71, 0.71, 0, 0]}", []),
    ],
)
def test_orientations_that_look_mistaken(
    goals: str, codes: list[str], tmp_path: Path
) -> None:
    path = write_targets(tmp_path, goals)
    assert [notice.code for notice in load_targets(path).notices] == codes


@pytest.mark.parametrize(
    ("goal", "found"),
    [
        ("position: {keys: [{t: 0, v: [0, 0, 0]}, {t: 0.5, v: [0, 1, 0]}]}", True),
        ("hold: [[0.5, 1.75]]", True),
        ("position: [0, 0, 0], during: [[0.25, 2]]", True),
        ("position: {keys: [{t: 1, v: [0, 0, 0]}, {t: 12.5, v: [0, 1, 0]}]}", False),
        ("hold: [[4, 8], [11.5, 16]]", False),
        ("position: {keys: [{t: 0, v: [0, 0, 0]}, {t: 1, v: [0, 1, 0]}]}", False),
    ],
)
def test_times_in_seconds(tmp_path: Path, goal: str, found: bool) -> None:
    tracks = tracks_of(tmp_path, f"- {{effector: leg_l, {goal}}}\n")
    assert [one.code for one in tracks.notices] == ["CLIP110"] * found


@pytest.mark.parametrize(
    ("ends", "times", "found"),
    [
        ("[1, 48]", (0, 1, 2), True),
        ("[0, 48]", (0, 1, 2), False),
        ("[1, 8]", (0, 1, 2), False),
        ("[1, 48]", (0, 24, 48), False),
    ],
)
def test_whole_seconds_of_a_range(
    tmp_path: Path, ends: str, times: tuple[int, int, int], found: bool
) -> None:
    keys = ", ".join(f"{{t: {t}, v: [0, {k}, 0]}}" for k, t in enumerate(times))
    goals = f"- {{effector: leg_l, position: {{keys: [{keys}]}}}}\n"
    path = write_targets(tmp_path, goals, f"{HEAD}range: {ends}\n")
    codes = [one.code for one in load_targets(path, legs()).notices]
    assert codes == ["CLIP110"] * found


@pytest.mark.parametrize(
    ("angle", "unit", "found"),
    [
        (-1.3963, "deg", True),
        (-1.3963, "rad", False),
        (-1.4, "deg", False),
        (-80, "deg", False),
        (-80, "rad", True),
    ],
)
def test_angles_of_orientations_in_another_unit(
    tmp_path: Path, angle: float, unit: str, found: bool
) -> None:
    keys = f"[{{t: 1, v: [0, 0, 0]}}, {{t: 24, v: [0, 0, {angle}]}}]"
    goals = f"- {{effector: leg_l, orientation: {{euler: XYZ, keys: {keys}}}}}\n"
    path = write_targets(tmp_path, goals, HEAD.replace("deg", unit))
    codes = [one.code for one in load_targets(path, legs()).notices]
    assert codes == ["CLIP107"] * found


@pytest.mark.parametrize(
    ("goal", "code"),
    [
        ("offset: [-7, -2, 0]", "TGT110"),
        ("offset: [0, 1.5, 0]", ""),  # the tip of a spear
        ("offset: [70, 20, 0]", "TGT110"),
        ("offset: [0, 600, 0]", "TGT110"),
        ("stretch: 10", "RIG114"),
        ("stretch: 0.1", ""),
    ],
)
def test_lengths_in_another_unit(tmp_path: Path, goal: str, code: str) -> None:
    goals = f"- {{effector: leg_l, position: [0, 0, 0], {goal}}}\n"
    tracks = tracks_of(tmp_path, goals)
    assert [one.code for one in tracks.notices] == [code] * bool(code)


@pytest.mark.parametrize(
    ("names", "count"),
    [
        (("arm_r", "front_x", "leg_l"), 1),
        (("arm_r", "leg_l", "leg_r"), 1),  # one fault, which has a suggestion
        (("leg_ll", "leg_rr", "leg_l"), 2),  # typing errors
        (("front", "back"), 1),
    ],
)
def test_effectors_of_another_rig_are_one_fault(
    tmp_path: Path, names: tuple[str, ...], count: int
) -> None:
    goals = "".join(f"- {{effector: {name}, position: [0, 0, 0]}}\n" for name in names)
    with pytest.raises(FormatError) as caught:
        tracks_of(tmp_path, goals)
    assert [fault.code for fault in caught.value.faults] == ["TGT001"] * count
