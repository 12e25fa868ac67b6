"""Every glTF of the data: in its class, at its place, and as its expected file says."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from support.data import data_files
from support.gltf_states import Apart, Character, compare
from support.suite import some_quick

from animtool.core.errors import FormatError, Severity
from animtool.formats.gltf.document import open_gltf
from animtool.formats.gltf.read import read_gltf

TOLERANCE = 1e-6


def classes(pattern: str) -> list[Any]:
    """Return a parameter for each file that a list of classes names."""
    found = []
    for parameter in data_files("gltf", pattern):
        path = parameter.values[0]
        if path is None:
            return [pytest.param(None, None, marks=parameter.marks, id="no-data")]
        entries = json.loads(path.read_text("utf-8"))
        found += [
            pytest.param(path.parent / entry["file"], entry, id=entry["file"])
            for entry in (entries if isinstance(entries, list) else [entries])
        ]
    return found


LISTED = [
    *classes("expected.json"),
    *classes("broken/expected.json"),
    *classes("variants/*.expected.json"),
]
# Files that are others with a fault that is mended.
MENDED = [one for one in LISTED if "same_as" in (one.values[1] or {"same_as": ""})]
STATES = [
    *data_files("gltf", "*/*.expected.json"),
    *data_files("gltf", "*/*/*.expected.json"),
    *data_files("rigs/real", "*.expected.json"),
]


def object_of(pointer: str) -> str:
    """Return the object of the file that a pointer is in, as ``/nodes/3``."""
    return "/".join(pointer.split("/")[:3])


@pytest.mark.parametrize(("path", "entry"), some_quick(LISTED, 60))
def test_a_file_is_of_its_class(path: Path, entry: dict[str, Any]) -> None:
    allowed = [entry["class"], *entry.get("also", ())]
    offsets = [entry.get("offset"), *(entry.get("places") or ())]
    places = {f"byte {one}" for one in offsets if isinstance(one, int)}
    pointers = [entry.get("pointer"), *(entry.get("places") or ())]
    objects = {object_of(one) for one in pointers if isinstance(one, str)}
    try:
        gltf = open_gltf(path)
    except FormatError as error:
        (fault,) = error.faults
        assert "refuses" in allowed, fault
        assert entry.get("names", "") in fault.message
        where = fault.where or ""
        if where.startswith("byte"):
            # A length is at its field, or at the end of the file.
            assert where in places | {f"byte {path.stat().st_size}"}
        elif objects and entry["class"] == "refuses":
            assert object_of(where) in objects, fault
        return
    warned = [n for n in gltf.diagnostics.notices if n.severity is Severity.WARNING]
    assert ("repairs" if warned else "reads") in allowed, warned
    counts = entry.get("counts")
    if counts:
        found = {
            "nodes": len(gltf.nodes),
            "skins": len(gltf.skins),
            "animations": len(gltf.animations),
            "scenes": len(gltf.scenes),
            "meshes": len(gltf.meshes),
        }
        assert counts == {name: found[name] for name in counts}


@pytest.mark.parametrize("path", some_quick(STATES, 20))
def test_what_comes_out_is_what_is_expected(path: Path) -> None:
    expected = json.loads(path.read_text("utf-8"))
    if expected["class"] == "refuses":
        with pytest.raises(FormatError):
            open_gltf(path.parent / expected["file"])
        return
    character = Character.of(path.parent / expected["file"])
    gltf = character.gltf
    assert [node.name for node in gltf.nodes] == [n["name"] for n in expected["nodes"]]
    assert [one.name for one in gltf.animations] == [
        clip["name"] for clip in expected["clips"]
    ]
    for animation, clip in zip(gltf.animations, expected["clips"], strict=True):
        if clip["channels"]:
            spans = (clip["first_key_s"], clip["last_key_s"])
            assert animation.span == pytest.approx(spans, abs=1e-7)
        assert len(animation.tracks) == len(clip["channels"])
        for track, channel in zip(animation.tracks, clip["channels"], strict=True):
            part = "" if track.weight_index < 0 else f"/{track.weight_index}"
            moved = [f"{track.path}{part}", str(track.interpolation)]
            assert moved == channel[1:3]
            assert len(track.times) == channel[3]
    apart = Apart()
    compare(character, expected, apart)
    assert max(apart.position, apart.point, apart.weight) <= TOLERANCE, apart
    assert apart.matrix <= 1e-5
    assert apart.seen["position"]


@pytest.mark.parametrize(("path", "entry"), some_quick(MENDED, 8))
def test_what_is_broken_but_repaired_is_the_file_without_the_fault(
    path: Path, entry: dict[str, Any]
) -> None:
    other = path.with_name(entry["same_as"])
    expected = json.loads(other.with_suffix(".expected.json").read_text("utf-8"))
    apart = Apart()
    compare(Character.of(path), expected, apart)
    assert max(apart.position, apart.point, apart.weight) <= TOLERANCE, apart


@pytest.mark.parametrize("path", some_quick(STATES, 8))
def test_a_take_of_every_file_is_finite(path: Path) -> None:
    expected = json.loads(path.read_text("utf-8"))
    if expected["class"] == "refuses":
        pytest.skip("is refused")
    stream = read_gltf(path.parent / expected["file"])
    # A take checks that all its numbers are finite, and rotations unit quaternions.
    assert stream.collect().motion.frames >= 1
