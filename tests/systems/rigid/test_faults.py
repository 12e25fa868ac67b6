"""What of rigid bodies and their joints is refused, or warned of, and where."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support.rigid import FLOOR, Rigid, ball, box

from animtool.core.errors import AnimtoolError, FormatError, Severity
from animtool.scene.file.read import load_scene
from animtool.scene.systems.simulation import open_systems
from animtool.systems.rigid import kind

MOVES = [[0, 0, 0, 0], [1, 1, 0, 0]]
NONE = [0, 0, 0, 0]
ROW = {"count": [2, 1, 1], "spacing": [3, 0, 0]}
ROUND = {"shape": {"sphere": {"radius": 1}}}
FLAT = {"mesh": {"points": "a.npz#flat", "triangles": "a.npz#corners"}}
BOX = box((1, 1, 1), at=[5, 0, 0])


def body(**keys: Any) -> tuple[list[dict[str, Any]], list[dict[str, Any]]]:
    """Return bodies, the second with keys, and no joints."""
    return [BOX, ball(1, **keys)], []


def shapes(*entries: dict[str, Any]) -> tuple[list[Any], list[Any]]:
    return [BOX, {"name": "nut", "shapes": list(entries)}], []


def joint(*others: dict[str, Any], **keys: Any) -> tuple[list[Any], list[Any]]:
    """Return bodies, and joints of which the second has keys."""
    sound = {"type": "ball", "body": "box", "at": [5, 0, 0]}
    bodies = [BOX, *(others or [ball(1)])]
    return bodies, [sound, {"type": "pin", "body": "ball", **keys}]


REFUSED = {
    "two of a name": (([ball(1), BOX, ball(2)], []), "bodies[2].name", "'ball'"),
    "no shape": (([BOX, {"name": "nut"}], []), "bodies[1]", "'nut' has no shape"),
    "a shape and shapes": (body(shapes=[ROUND]), "bodies[1].shapes", "a shape and"),
    "a plane": (
        ([BOX, {"name": "nut", "shape": {"plane": None}}], []),
        "bodies[1].shape",
        "plane",
    ),
    "a plane of several": (
        shapes(ROUND, {"shape": {"plane": None}}),
        "bodies[1].shapes[1]",
        "plane",
    ),
    "a flat mesh": (
        ([BOX, {"name": "nut", "shape": FLAT}], []),
        "bodies[1].shape",
        "no volume",
    ),
    "a shape turned by nothing": (
        shapes(ROUND, {**ROUND, "rotate": NONE}),
        "bodies[1].shapes[1].rotate",
        "'nut'",
    ),
    "inertia of no body": (body(inertia=[1, 1, 2.1]), "bodies[1].inertia", "2.1"),
    "inertia of a point": (body(inertia=[1, 0, 0]), "bodies[1].inertia", "no body"),
    "a grain": (([BOX, ball(1e-300)], []), "bodies[1]", "1e-30 kg"),
    "no weight": (body(mass=1e-33), "bodies[1]", "1e-30 kg"),
    "inertia of a grain": (body(inertia=[1e-320] * 3), "bodies[1]", "1e-100 kg m²"),
    "no inertia": (body(inertia=[0, 0, 0]), "bodies[1].inertia", "two moments"),
    "a grid and points": (
        body(grid=ROW, points="a.npz#flat"),
        "bodies[1].points",
        "grid",
    ),
    "a grid of too many": (
        body(grid={**ROW, "count": [1001, 1000, 1]}),
        "bodies[1].grid",
        "1000000",
    ),
    "rotations of nothing": (
        body(rotations="a.npz#none"),
        "bodies[1].rotations",
        "no",
    ),
    "points of two numbers": (
        body(points="a.npz#pairs"),
        "bodies[1].points",
        "(4, 3)",
    ),
    "rotations of three numbers": (
        body(points="a.npz#flat", rotations="a.npz#flat"),
        "bodies[1].rotations",
        "(4, 4)",
    ),
    "more rotations than copies": (
        body(grid=ROW, rotations="a.npz#none"),
        "bodies[1].rotations",
        "(2, 4)",
    ),
    "rotations by nothing": (
        body(points="a.npz#flat", rotations="a.npz#none"),
        "bodies[1].rotations",
        "zero quaternion",
    ),
    "moves of what is pushed": (body(moves=MOVES), "bodies[1].moves", "moves"),
    "turns of what is pushed": (
        body(turns=[[0, 1, 0, 0, 0], [1, 0, 1, 0, 0]]),
        "bodies[1].turns",
        "turns",
    ),
    "velocity of what is moved": (
        body(kinematic=True, velocity=[1, 0, 0]),
        "bodies[1].velocity",
        "kinematic",
    ),
    "mass and density": (body(mass=1, density=2), "bodies[1].density", "keep one"),
    "target of a ball": (
        joint(type="ball", drive={"stiffness": 1, "target": 3}),
        "joints[1].drive.target",
        "rotation",
    ),
    "rotation of a pin": (
        joint(drive={"stiffness": 1, "rotation": [1, 0, 0, 0]}),
        "joints[1].drive.rotation",
        "target",
    ),
    "pushes of what is moved": (
        body(kinematic=True, pushes=[{"force": [1, 0, 0]}]),
        "bodies[1].pushes",
        "kinematic",
    ),
    "a push that ends first": (
        body(pushes=[{"end": 1}, {"start": 2, "end": 1}]),
        "bodies[1].pushes[1].end",
        "2 s",
    ),
    "no such body": (joint(body="bal"), "joints[1].body", "did you mean 'ball'"),
    "a copy without its number": (
        joint(ball(1, grid=ROW)),
        "joints[1].body",
        "write 'ball[0]' to 'ball[",
    ),
    "no such other": (joint(to="bix"), "joints[1].to", "did you mean 'box'"),
    "a kinematic body": (joint(ball(1, kinematic=True)), "joints[1].body", "kinem"),
    "a body and itself": (joint(to="ball", name="hip"), "joints[1].to", "'hip'"),
    "moves beside a body": (joint(to="box", moves=MOVES), "joints[1]", "'box'"),
    "limits of a ball": (
        joint(type="ball", limits=[0, 1]),
        "joints[1].limits",
        "swing: 40",
    ),
    "swing of a pin": (joint(swing=30), "joints[1].swing", "type: ball"),
    "twist of a slide": (
        joint(type="prismatic", twist=[0, 1]),
        "joints[1].twist",
        "type: ball",
    ),
    "drive of what is fixed": (
        joint(type="fixed", drive={"stiffness": 3}),
        "joints[1].drive",
        "prismatic",
    ),
    "an axis of nothing": (joint(axis=[0, 0, 0]), "joints[1].axis", "direction"),
    "limits the wrong way": (joint(limits=[3, 1]), "joints[1].limits", "3, is above"),
    "limits of two turns": (
        joint(limits=[-360, 360.1]),
        "joints[1].limits",
        "are more than 360 degrees apart",
    ),
    "twist the wrong way": (
        joint(type="ball", twist=[3, 1]),
        "joints[1].twist",
        "3, is above",
    ),
    "swing of nothing": (
        joint(type="ball", swing=[10, 0]),
        "joints[1].swing",
        "above 0",
    ),
    "a drive to nowhere": (
        joint(type="ball", drive={"rotation": NONE}),
        "joints[1].drive",
        "zero quaternion",
    ),
}


@pytest.fixture
def arrays(tmp_path: Path) -> Path:
    """Write arrays that bodies name; return their folder."""
    np.savez(
        tmp_path / "a.npz",
        flat=np.array([[0.0, 0, 0], [1, 0, 0], [0, 0, 1], [1, 0, 1]]),
        corners=np.array([[0, 2, 1], [1, 2, 3]]),
        pairs=np.zeros((4, 2)),
        none=np.zeros((4, 4)),
    )
    return tmp_path


@pytest.mark.parametrize("case", REFUSED)
def test_what_makes_no_sense_is_refused_at_its_place(case: str, arrays: Path) -> None:
    (bodies, joints), where, word = REFUSED[case]
    with pytest.raises(AnimtoolError) as error:
        Rigid(arrays, *bodies, joints=joints)
    (fault,) = error.value.faults
    assert fault.code == "SIM061"
    assert fault.where == f"systems[0].rigid.{where}"
    assert fault.lines
    assert word in str(fault)


SCENE = """\
scene: animtool/1
fps: 24
range: [1, 2]
systems:
- rigid:
    name: it
    bodies:
    - {name: box, shape: {box: {size: [1, 1, 1]}}}
    - name: ball
      inertia: [1, 1, 3]
      shape: {sphere: {radius: 1}}
"""


def test_the_line_is_that_of_the_key(tmp_path: Path) -> None:
    file = tmp_path / "a.scene.yaml"
    file.write_text(SCENE, "utf-8")
    with pytest.raises(FormatError) as error:
        open_systems(load_scene(file).systems, 1.0)
    (fault,) = error.value.faults
    assert (fault.lines, fault.column) == ((10,), 16)


def warned(found: Rigid, code: str) -> list[str | None]:
    """Return the places of warnings of a code, after a step."""
    found.to(0.05)
    faults = [fault for fault in found.run.notices if fault.code == code]
    assert all(fault.severity is Severity.WARNING for fault in faults)
    return [fault.where for fault in faults]


def hollow(folder: Path, dent: float, triangles: int) -> dict[str, Any]:
    """Return a pyramid whose base is dented, without some of its six triangles."""
    points = [[0, 1, 0], [1, 0, 0], [0, 0, 1], [-1, 0, 0], [0, 0, -1], [0, dent, 0]]
    sides = [[0, b, a] for a, b in ((1, 2), (2, 3), (3, 4), (4, 1))]
    base = [[5, a, b] for a, b in ((1, 2), (2, 3), (3, 4), (4, 1))]
    corners = (sides + base)[:triangles]
    np.savez(folder / "m.npz", points=np.array(points, np.float64), corners=corners)
    return {"mesh": {"points": "m.npz#points", "triangles": "m.npz#corners"}}


@pytest.mark.parametrize(
    ("dent", "triangles", "warns"), [(-0.5, 8, 0), (0.5, 8, 1), (-0.5, 7, 1)]
)
def test_a_mesh_that_is_not_its_hull_is_warned_of(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    dent: float,
    triangles: int,
    warns: int,
) -> None:
    """SIM125: convex and closed is fine, dented or open is not."""
    monkeypatch.setattr(kind, "can_decompose", lambda: False)
    mesh = {"shape": hollow(tmp_path, dent, triangles)}
    nut = {"name": "nut", "shapes": [ROUND, {**mesh, "at": [0, 3, 0]}]}
    found = Rigid(tmp_path, BOX, nut, forces=[])
    assert warned(found, "SIM125") == ["bodies[1].shapes[1]"] * warns


@pytest.mark.parametrize(("height", "warns"), [(1.0, 0), (0.99, 0), (0.9, 1)])
def test_bodies_that_begin_in_others_are_warned_of(
    tmp_path: Path, height: float, warns: int
) -> None:
    """SIM126: from a fiftieth of the size of the smallest on."""
    found = Rigid(tmp_path, ball(1, at=[0, height, 0]), colliders=[FLOOR])
    assert len(warned(found, "SIM126")) == warns


def test_the_deepest_of_bodies_and_colliders_are_named(tmp_path: Path) -> None:
    cube = {"size": [1, 1, 1]}
    wall = {"shape": {"box": cube}, "name": "wall", "at": [0, 0, 0.85]}
    lift = box([1, 1, 1], at=[0, 0, -0.9]) | {"name": "lift", "kinematic": True}
    nuts = [box([1, 1, 1], at=[x, 0, 0]) | {"name": f"nut {x}"} for x in (0, 0.8, 1.7)]

    def said(*bodies: dict[str, Any], **keys: Any) -> str:
        found = Rigid(tmp_path, *bodies, forces=[], substeps=1, step=1e-3, **keys)
        found.to(2e-3)
        (fault,) = found.run.notices
        return fault.message

    floor = FLOOR | {"at": [0, -9, 0]}
    assert "'nut 0' and 'nut 0.8' start 198" in said(*nuts)
    assert "'nut 0' and 'lift' start 99" in said(
        lift, nuts[2], nuts[0], colliders=[floor]
    )
    assert "'nut 0' and 'wall' start 150" in said(
        lift, nuts[0], colliders=[floor, wall]
    )
    assert "'nut 0' and 'colliders[0]' start 499" in said(nuts[0], colliders=[FLOOR])


@pytest.mark.parametrize(("distance", "warns"), [(3.9, 0), (4.1, 1)])
@pytest.mark.parametrize("kinematic", [False, True])
@pytest.mark.parametrize("end", ["body", "to"])
def test_a_joint_far_from_its_body_is_warned_of(
    tmp_path: Path, distance: float, warns: int, end: str, *, kinematic: bool
) -> None:
    """SIM127: from four times what the body reaches on, of both that it joins."""
    ends: dict[str, Any] = {} if end == "body" else {"body": "bar", "to": "ball"}
    bar = box((1, 99, 1)) | {"name": "bar"}
    near = ball(1, kinematic=kinematic and end == "to")
    bodies, joints = joint(near, bar, at=[0, distance, 0], **ends)
    found = Rigid(tmp_path, *bodies, joints=joints, forces=[], sleep={"speed": 0})
    assert warned(found, "SIM127") == ["joints[1].at"] * warns


@pytest.mark.parametrize(
    ("w_last", "count", "shift", "warns"),
    [
        (True, 3, 0.0, 1),
        (False, 3, 0.0, 0),
        # One end of a joint may fit by chance, and massless rods are longer.
        (True, 1, 0.0, 0),
        (True, 3, 0.2, 0),
    ],
)
def test_joints_that_are_at_bodies_with_w_last_are_warned_of(
    tmp_path: Path, count: int, shift: float, warns: int, *, w_last: bool
) -> None:
    """SIM127: links along a slope, each held at its ends."""
    w, x = np.cos(np.radians(32)), np.sin(np.radians(32))
    along = (0.6 + shift) * np.array([0, 1 - 2 * x * x, 2 * w * x])
    capsule = {"shape": {"capsule": {"radius": 0.05, "length": 0.5}}}
    links, joints = [], []
    for i in range(count):
        rotate = [x, 0.0, 0.0, w] if w_last else [w, x, 0.0, 0.0]
        link = {"name": f"link {i}", "at": [*((i + 0.5) * along)], "rotate": rotate}
        links.append(capsule | link)
        hinge = {"type": "ball", "body": f"link {i}", "at": [*(i * along)]}
        joints.append(hinge | ({"to": f"link {i - 1}"} if i else {}))
    found = Rigid(tmp_path, *links, joints=joints, forces=[], sleep={"speed": 0})
    assert warned(found, "SIM127") == ["joints[0].at"] * warns


def test_faults_of_bodies_and_joints_come_at_once(tmp_path: Path) -> None:
    """Each is one cause: a joint to a body that is wrong is no fault more."""
    bodies = [
        ball(1, moves=MOVES, inertia=[1, 1, 5]),
        {"name": "nut"},
        {"name": "bolt", "shape": {"plane": None}},
        box((1, 1, 1), at=[5, 0, 0], kinematic=True),
    ]
    joints = [
        {"type": "pin", "body": "nobody"},
        {"type": "ball", "body": "nut", "limits": [0, 10]},
        {"type": "pin", "body": "ball", "limits": [10, 0], "axis": [0, 0, 0]},
        {"type": "pin", "body": "box"},
    ]
    with pytest.raises(FormatError) as caught:
        Rigid(tmp_path, *bodies, joints=joints)
    found = {(fault.code, fault.where) for fault in caught.value.faults}
    at = "systems[0].rigid"
    assert found == {
        ("SIM061", f"{at}.{key}")
        for key in (
            "bodies[0].moves",
            "bodies[0].inertia",
            "bodies[1]",
            "bodies[2].shape",
            "joints[0].body",
            "joints[1].limits",
            "joints[2].limits",
            "joints[2].axis",
            "joints[3].body",
        )
    }


@pytest.mark.parametrize(
    ("other", "link", "warns"),
    [
        ({}, None, True),
        ({}, [0, 2, 0], True),
        ({}, [0, 5, 0], False),  # a gimbal
        ({"at": [0, 5.5, 0]}, [0, 5.2, 0], False),
        ({"rotate": [0.8, 0.6, 0, 0]}, [0, 5.2, 0], False),
        ({"shape": {"sphere": {"radius": 0.2}}}, [0, 5.2, 0], False),
        ({"density": 500}, [0, 5.2, 0], False),
    ],
)
def test_copies_of_bodies_are_warned_of(
    tmp_path: Path, other: dict[str, Any], link: list[float] | None, *, warns: bool
) -> None:
    """SIM126, even if a joint links them, so that they do not collide."""
    bar = box((0.4, 0.2, 0.1), at=[0, 5, 0])
    joints = [{"type": "ball", "body": "copy", "to": "box", "at": link}] if link else []
    found = Rigid(tmp_path, bar, bar | {"name": "copy"} | other, joints=joints)
    assert warned(found, "SIM126") == ["bodies[1].at"] * warns


def test_copies_that_stand_still_are_no_fault(tmp_path: Path) -> None:
    wall = box((1, 1, 1), at=[9, 0, 0], kinematic=True)
    found = Rigid(tmp_path, ball(1), wall, wall | {"name": "copy"}, forces=[])
    assert not warned(found, "SIM126")


@pytest.mark.parametrize(("radius", "asks"), [(1.0, False), (24.0, True)])
def test_bodies_far_inside_others_ask_for_the_unit(
    tmp_path: Path, radius: float, asks: bool
) -> None:
    found = Rigid(tmp_path, ball(radius, at=[0, 0.5 * radius, 0]), colliders=[FLOOR])
    assert warned(found, "SIM126")
    (hint,) = (fault.hint for fault in found.run.notices if fault.code == "SIM126")
    assert ("same unit" in (hint or "")) == asks
