from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import pytest
from annotated_types import Len
from pydantic import Field

from animtool.core.errors import Fault, FormatError
from animtool.core.options import key
from animtool.documents.check import FileModel, check_version, validate_document
from animtool.documents.document import Document, read_document
from animtool.documents.model_faults import MAX_REPLACED_VALUES
from animtool.documents.value_hints import OptionExamplesAnnotation


class Round(FileModel):
    kind: Literal["round"]
    type: Literal["round"]
    radius: Annotated[float, Field(gt=0)]


class Square(FileModel):
    type: Literal["square"]
    side: float | Annotated[list[float], Len(2, 2)]
    count: int = 1
    shown: bool = True


class Turned(FileModel):
    up: Literal["Y", "Z"] = "Y"
    order: Literal["XYZ", "ZYX"] = "XYZ"


class Box(FileModel):
    rig: str
    items: list[Annotated[Square | Round, Field(discriminator="type")]] = Field(
        default=[]
    )
    named: dict[str, Square] = Field(default={})
    source: str | None = Field(default=None, alias="from")


class File(FileModel):
    file: str
    shown: bool = True


class Shown(FileModel):
    """Keys with examples, as the models of formats have them."""

    crate: Annotated[
        dict[str, dict[str, object]] | None,
        OptionExamplesAnnotation({"box": {"size": [1, 1, 1]}, "ball": {"radius": 0.5}}),
    ] = key("A shape.", {"box": {"size": [2, 2, 2]}}, default=None)
    items: list[Square] = key("Squares.", [{"type": "square"}], default=[])
    take: File | None = key("A take.", {"file": "a.bvh"}, default=None)
    takes: list[File] = key("Takes.", [{"file": "a.bvh"}], default=[])
    span: list[float] = key("Ends.", [-60.0, 60.0], default=[])


def document(folder: Path, text: str) -> Document:
    path = folder / "a.yaml"
    path.write_text(text)
    return read_document(path)


def faults(folder: Path, text: str) -> list[Fault]:
    read = document(folder, "rig: x\n" + text)
    validate_document(read, Box)
    with pytest.raises(FormatError) as caught:
        read.check()
    return list(caught.value.faults)


def test_a_sound_document(tmp_path: Path) -> None:
    text = "rig: x\nfrom: y\nitems:\n- {type: square, side: 1}\n"
    box = validate_document(document(tmp_path, text), Box)
    assert (box.source, box.items[0].type) == ("y", "square")


@pytest.mark.parametrize(
    ("text", "code", "line", "words"),
    [
        ("form: y", "DOC020", 2, "did you mean 'from'?"),
        ("source: y", "DOC020", 2, "unknown key 'source'"),
        ("-source: y", "DOC001", 2, "write '- source: …'"),
        ("items:\n-{type: square}", "DOC001", 3, "write '- {type: …'"),
        ("items:\n  -type: square", "DOC001", 3, "write '- type: …'"),
        ("items: 5", "DOC022", 2, "5 is not a list"),
        ("items: [{type: square, side: '60'}]", "DOC022", 2, "remove the quotes: 60"),
        ("items: [{type: square, side: 6Hz}]", "DOC022", 2, "write 6, without a unit"),
        ("items:\n- type: square\n  side: 0,5", "DOC022", 4, "write 0.5"),
        ("items: [{type: square, side: [0,5, 1]}]", "DOC022", 2, "write [0.5, 1]"),
        ("items: [{type: square, side: }]", "DOC022", 2, "the value is missing"),
        (
            "items: [{type: round, kind: round, radius: -1}]",
            "DOC022",
            2,
            "-1 is not above 0",
        ),
        ("named: [1]", "DOC022", 2, "is not a mapping of keys"),
        ("items:\n- 5", "DOC022", 3, "5"),
        ("items:\n- {side: 1}", "DOC022", 3, "type"),
        ("items:\n- {type: squar, side: 1}", "DOC022", 3, "did you mean 'square'?"),
        ("items:\n- {type: square, side: x}", "DOC022", 3, "'x' is neither a number"),
        ("items:\n- {type: square, side: '1'}", "DOC022", 3, "neither a number"),
        ("items:\n- {type: square, side: [1]}", "DOC022", 3, "1 item where 2"),
        ("items:\n- {type: square}", "DOC021", 3, "'side' is missing"),
        ("items:\n- {type: square, sid: 1, side: 1}", "DOC020", 3, "'side'"),
        ("items:\n- {type: square, side: 1, count: 1.5}", "DOC022", 3, "1.5"),
        ("items:\n- {type: square, side: 1, shown: 1}", "DOC022", 3, "true or false"),
        ("items:\n- {type: square, side: 1, shown: no}", "DOC022", 3, "true or false"),
        ("named:\n  a: {type: square, sde: 1, side: 2}", "DOC020", 3, "'side'"),
    ],
)
def test_a_fault(tmp_path: Path, text: str, code: str, line: int, words: str) -> None:
    [fault] = faults(tmp_path, text)
    assert (fault.code, fault.lines[0]) == (code, line)
    assert words in str(fault)


def test_a_kind_of_its_own_has_keys_of_its_own(tmp_path: Path) -> None:
    [fault] = faults(tmp_path, "items:\n- {type: square, side: 1, radius: 2}")
    assert "radius" not in (fault.hint or "")


def test_all_that_is_missing(tmp_path: Path) -> None:
    found = faults(tmp_path, "items:\n- {type: round}\n- {type: square}")
    assert [(f.code, f.lines[0]) for f in found] == [
        ("DOC021", 3),
        ("DOC021", 3),
        ("DOC021", 4),
    ]


@pytest.mark.parametrize(
    ("text", "code", "words"),
    [
        ("clip: animtool/1", "DOC009", "looks like a clip file"),
        ("name: x", "DOC009", "the first line"),
        ("rig: 1", "DOC009", "write rig: animtool/1"),
        ("rig: [animtool/1]", "DOC009", "write rig: animtool/1"),
        ("rig: animtool/2", "DOC012", "up to"),
        ("rig: animtool/0", "DOC012", "allowed: animtool/1"),
        ("rig: animtool/x", "DOC012", "allowed: animtool/1"),
        ("clip: animtool/1\nrig: hero.rig.yaml", "DOC009", "looks like a clip file"),
    ],
)
def test_versions(tmp_path: Path, text: str, code: str, words: str) -> None:
    with pytest.raises(FormatError) as caught:
        check_version(document(tmp_path, text), "rig")
    assert caught.value.code == code
    assert words in str(caught.value)


def test_a_misspelt_key_is_not_missing_too(tmp_path: Path) -> None:
    read = document(tmp_path, "rig: x\nitems:\n- {type: round, kind: round, radus: 2}")
    (item,) = validate_document(read, Box).items
    assert isinstance(item, Round)
    assert item.radius == 2
    assert [fault.code for fault in read.faults] == ["DOC020"]
    assert read.position(("items", 0, "radius")) == (3, 37)
    read.add("X", ("items", 0, "radius"), "is odd")
    assert read.faults[-1].where == "items[0].radus"


@pytest.mark.parametrize("value", ["x", "{sde: 1}", "[1, x]"])
def test_a_value_of_a_misspelt_key_is_not_checked(tmp_path: Path, value: str) -> None:
    found = faults(tmp_path, f"items:\n- {{type: square, sid: {value}}}")
    assert [(f.code, f.where) for f in found] == [("DOC020", "items[0].sid")]


def test_a_misspelt_kind_decides_nothing(tmp_path: Path) -> None:
    """Neither that there is no kind, nor what that kind lacks, is a fault more."""
    found = faults(tmp_path, "items:\n- {typ: square}")
    assert [(f.code, f.where) for f in found] == [("DOC020", "items[0].typ")]


def test_of_an_unknown_kind_only_what_all_kinds_have_is_checked(tmp_path: Path) -> None:
    text = "items:\n- {type: squar, side: x, radius: [], shwn: 1}"
    found = faults(tmp_path, text)
    assert [(f.code, f.where) for f in found] == [
        ("DOC022", "items[0].type"),
        ("DOC020", "items[0].shwn"),
    ]


def test_the_variant_that_comes_farthest_is_meant(tmp_path: Path) -> None:
    (fault,) = faults(tmp_path, "items:\n- {type: square, side: [1, x]}")
    assert (fault.code, fault.where) == ("DOC022", "items[0].side[1]")


def test_no_fault_is_noted_of_a_stand_in(tmp_path: Path) -> None:
    read = document(tmp_path, "rig: x\nitems:\n- {type: square, side: x}\n- 5")
    box = validate_document(read, Box)
    assert len(box.items) == 2
    assert read.placeholders == {("items", 0, "side"), ("items", 1)}
    for place in (("items", 0, "side"), ("items", 1, "type"), ("items", 1)):
        read.add("X", place, "is odd")
    assert [fault.code for fault in read.faults] == ["DOC022", "DOC022"]
    read.add("X", ("items", 0, "count"), "is odd")
    assert read.faults[-1].code == "X"


def test_entries_without_a_name_that_is_known(tmp_path: Path) -> None:
    read = document(tmp_path, "rig: x\nitems:\n- {type: square, side: x}\nnamed: 7")
    validate_document(read, Box)
    assert not read.has_unknown_name("items")
    assert read.has_unknown_name("items", "name", "side")
    assert read.has_unknown_name("named")
    assert not read.has_unknown_name("rig")


def test_what_does_not_ascend(tmp_path: Path) -> None:
    read = document(tmp_path, "rig: x")
    read.placeholders.add(("items", 1, "at"))
    found = list(read.unordered_entries(("items",), [3, 9, 2, 4, 4], "at"))
    assert found == [(2, 0), (4, 3)]


def test_faults_are_mended_up_to_a_bound(tmp_path: Path) -> None:
    """Up to the bound later checks add theirs. Each of these faults is found twice."""

    def read(count: int) -> Document:
        rows = "".join("- {type: square, side: x}\n" for _ in range(count))
        return document(tmp_path, f"rig: x\nitems:\n{rows}")

    most = read(MAX_REPLACED_VALUES // 2)
    assert len(validate_document(most, Box).items) == MAX_REPLACED_VALUES // 2
    assert len(most.faults) == MAX_REPLACED_VALUES // 2
    with pytest.raises(FormatError):
        validate_document(read(MAX_REPLACED_VALUES // 2 + 1), Box)


@pytest.mark.parametrize(
    ("text", "form"),
    [
        ("items: {type: square, side: 1}", "items: [{type: square, side: 1}]"),
        ("crate: {box: [1, 1, 1]}", "crate: {box: {size: [1, 1, 1]}}"),
        ("crate: box", "crate: {box: {size: [1, 1, 1]}}"),
        ("crate: {size: [1, 2, 3]}", "crate: {box: {size: [1, 2, 3]}}"),
        ("crate: {ball: {}, radius: 2}", "crate: {ball: {radius: 2}}"),
        (
            "crate: {ball: {radius: 2}, span: 3}",
            "crate: {ball: {radius: 2}}, span: 3",
        ),
        ("crate: {radius: 2, span: 3}", "crate: {ball: {radius: 2}}, span: 3"),
        ("crate: {ball: 0.1}", "crate: {ball: {radius: 0.5}}"),
        ("crate: {cone: 0.1}", "crate: {box: {size: [2, 2, 2]}}"),
        ("take: walk.bvh", "take: {file: walk.bvh}"),
        ("takes: walk.bvh", "takes: [{file: walk.bvh}]"),
        ("takes: [walk.bvh]", "takes: [{file: walk.bvh}]"),
        ("span: 60", "span: [-60, 60]"),
    ],
)
def test_a_wrong_form_shows_the_right_one(tmp_path: Path, text: str, form: str) -> None:
    read = document(tmp_path, text)
    validate_document(read, Shown)
    (fault,) = read.faults
    assert fault.code == "DOC022"
    assert str(fault.hint).removeprefix("for example ").removeprefix("write ") == form


def test_a_name_without_the_key_of_its_options(tmp_path: Path) -> None:
    read = document(tmp_path, "items: []\nball: {radius: 2}")
    shown = validate_document(read, Shown)
    (fault,) = read.faults
    assert (fault.code, fault.hint) == ("DOC020", "write crate: {ball: {radius: 2}}")
    assert shown.crate == {"ball": {"radius": 2}}
