"""Attachments of a rig file: what each kind wants, and that it comes back."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_array_equal
from support.suite import examples
from support.surfaces import held, shaped_rig

from animtool.core.errors import Fault, FormatError
from animtool.documents.document import parse_document
from animtool.rig.file import load_rig, parse_rig
from animtool.rig.parts import Attachment, LoadedArray
from animtool.rig.skeleton import Rig
from animtool.rig.surfaces import with_array_file
from animtool.rig.write import rig_text

RIG = """\
rig: animtool/1
name: hero
units: {length: cm}
joints:
- {name: hips, type: free}
- {name: head, parent: hips, type: ball, translate: [0, 60, 0]}
meshes:
- {name: cape, points: a.npz, faces: a.npz}
attach:
- {name: tail, kind: spring_chain, joints: [head]}
- {name: cloak, kind: cloth, mesh: cape, pins: a.npz}
- {name: hair, kind: strands, joint: head, points: a.npz#hair}
- {name: jelly, kind: soft, joints: [hips, head]}
"""


@pytest.fixture(scope="module")
def yard(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("yard")
    hair = np.cumsum(np.ones((3, 4, 3)), axis=1)
    broken, still = hair.copy(), hair.copy()
    broken[1, 2, 0] = np.nan
    still[2, 1] = still[2, 2]
    np.savez(
        folder / "a.npz",
        points=np.eye(3),
        faces=np.array([[0, 1, 2]]),
        pins=np.array([2, 0]),
        beyond=np.array([1, 3]),
        below=np.array([-1]),
        halves=np.array([0.5]),
        grid=np.array([[0, 1]]),
        hair=hair,
        broken=broken,
        still=still,
        bald=hair[:0],
        stubs=hair[:, :1],
        flat=hair[0],
    )
    return folder


def load(yard: Path, text: str) -> Rig:
    return parse_rig(parse_document(text, yard / "hero.rig.yaml"))


def faults(yard: Path, text: str) -> list[Fault]:
    with pytest.raises(FormatError) as caught:
        load(yard, text)
    return list(caught.value.faults)


def test_every_kind_is_read(yard: Path) -> None:
    tail, cloak, hair, jelly = load(yard, RIG).attach
    assert tail == Attachment("tail", "spring_chain", ("head",))
    assert (cloak.mesh, cloak.joints) == ("cape", ())
    assert cloak.pins is not None
    assert_array_equal(cloak.pins.load(), [2, 0])
    assert hair.joints == ("head",)
    assert hair.points is not None
    assert hair.points.load().shape == (3, 4, 3)
    assert jelly == Attachment("jelly", "soft", ("hips", "head"))


FAULTS = [
    ("kind: spring_chain, joints: [head]", "kind: spring_chain", "RIG031", 10),
    ("joints: [head]", "joints: [head], mesh: cape", "RIG031", 10),
    ("joints: [head]", "joints: [haed]", "RIG008", 10),
    ("kind: cloth, mesh: cape, pins: a.npz", "kind: cloth", "RIG031", 11),
    ("mesh: cape,", "mesh: cap,", "RIG012", 11),
    ("mesh: cape,", "mesh: cape, joints: [hips],", "RIG031", 11),
    ("mesh: cape,", "mesh: cape, points: a.npz#hair,", "RIG031", 11),
    ("pins: a.npz", "pins: a.npz#none", "RIG018", 11),
    ("pins: a.npz", "pins: a.npz#beyond", "RIG027", 11),
    ("pins: a.npz", "pins: a.npz#below", "RIG027", 11),
    ("pins: a.npz", "pins: a.npz#halves", "RIG019", 11),
    ("pins: a.npz", "pins: a.npz#grid", "RIG019", 11),
    ("joint: head, ", "", "RIG031", 12),
    (", points: a.npz#hair", "", "RIG031", 12),
    ("joint: head", "joint: haed", "RIG008", 12),
    ("joint: head", "joint: head, pins: a.npz", "RIG031", 12),
    ("a.npz#hair", "../a.npz#hair", "DOC014", 12),
    ("a.npz#hair", "a.npz#broken", "RIG027", 12),
    ("a.npz#hair", "a.npz#still", "RIG027", 12),
    ("a.npz#hair", "a.npz#bald", "RIG019", 12),
    ("a.npz#hair", "a.npz#stubs", "RIG019", 12),
    ("a.npz#hair", "a.npz#flat", "RIG019", 12),
    ("name: hair", "name: tail", "RIG011", 12),
    ("kind: strands", "kind: 5", "DOC022", 12),
    ("joint: head,", "joint: 5,", "DOC022", 12),
    ("mesh: cape,", "mesh: [cape],", "DOC022", 11),
]


@pytest.mark.parametrize(("old", "new", "code", "line"), FAULTS)
def test_a_fault(yard: Path, old: str, new: str, code: str, line: int) -> None:
    assert old in RIG
    found = faults(yard, RIG.replace(old, new, 1))
    assert [(fault.code, fault.lines[0]) for fault in found] == [(code, line)]


def test_the_nearest_kind_is_named(yard: Path) -> None:
    found = faults(yard, RIG.replace("kind: cloth", "kind: cloht"))
    assert {fault.code for fault in found} == {"RIG031"}
    assert {fault.hint for fault in found} == {"did you mean 'cloth'?"}
    messages = [fault.message for fault in found]
    assert messages == [
        "an attachment of kind 'cloht' has no joints",
        "an attachment of kind 'cloht' does not use mesh",
        "an attachment of kind 'cloht' does not use pins",
    ]


def test_the_place_of_a_strand_without_length_is_said(yard: Path) -> None:
    [fault] = faults(yard, RIG.replace("a.npz#hair", "a.npz#still"))
    assert fault.message == (
        "'a.npz#still' has points 1 and 2 of strand 2 at the same position"
    )


def test_what_is_written_comes_back_equal(yard: Path) -> None:
    rig = load(yard, RIG)
    assert load(yard, rig_text(rig)) == rig


coordinates = st.floats(-100, 100, width=32)
strands = st.tuples(st.integers(1, 4), st.integers(2, 5)).flatmap(
    lambda size: st.lists(
        coordinates, min_size=3 * size[0] * size[1], max_size=3 * size[0] * size[1]
    ).map(lambda values: np.reshape(values, (*size, 3)))
)


@pytest.mark.slow
@settings(max_examples=examples(30))
@given(
    strands.filter(lambda s: bool((s[:, 1:] != s[:, :-1]).any(axis=-1).all())),
    st.lists(st.integers(0, 39), unique=True),
    st.sampled_from(["hair", "a b", "ü", "x/y"]),
)
def test_arrays_in_memory_go_to_a_file(
    points: np.ndarray, pins: list[int], name: str
) -> None:
    attach = (
        Attachment(name, "strands", ("hand",), points=held(points)),
        Attachment(
            "cloak", "cloth", mesh="body", pins=LoadedArray(np.array(pins, float))
        ),
        Attachment("bare", "cloth", mesh="Skel"),
    )
    rig = replace(shaped_rig(), attach=attach)
    with TemporaryDirectory() as folder:
        path = Path(folder) / "hero.rig.yaml"
        stored, arrays = with_array_file(rig, path.with_name("hero.npz"))
        np.savez(path.with_name("hero.npz"), allow_pickle=False, **arrays)
        path.write_text(rig_text(stored), "utf-8")
        back = load_rig(path)
        assert rig_text(back) == rig_text(stored)
        for one, other in zip(attach, back.attach, strict=True):
            assert (one.name, one.kind, one.joints, one.mesh) == (
                other.name,
                other.kind,
                other.joints,
                other.mesh,
            )
            for a, b in ((one.pins, other.pins), (one.points, other.points)):
                assert (a is None) is (b is None)
                if a is not None and b is not None:
                    assert_array_equal(a.load(), b.load())


@pytest.mark.parametrize(
    ("kind", "near"),
    [("spring_chian", "spring_chain"), ("spring-chain", "spring_chain"), ("soft", "")],
)
def test_a_slip_in_a_kind_is_pointed_out(yard: Path, kind: str, near: str) -> None:
    rig = parse_rig(
        parse_document(RIG.replace("kind: soft", f"kind: {kind}"), yard / "x.rig.yaml")
    )
    assert rig.attach[-1].kind == kind
    said = [(note.code, note.lines, note.hint) for note in rig.notices]
    assert said == ([("RIG102", (13,), f"did you mean {near!r}?")] if near else [])
