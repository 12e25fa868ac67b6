from __future__ import annotations

import json
import math
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st
from support.values import VALUES

from animtool.core.errors import FormatError, Severity
from animtool.documents.document import MAX_FAULTS, Document, read_document


def written(folder: Path, content: str | bytes, name: str = "a.yaml") -> Path:
    path = folder / name
    data = content.encode() if isinstance(content, str) else content
    path.write_bytes(data)
    return path


def value(folder: Path, text: str | bytes) -> Any:
    return read_document(written(folder, text)).value


def refused(folder: Path, text: str | bytes) -> list[tuple[str, int | None]]:
    """Return code and line of every fault."""
    with pytest.raises(FormatError) as caught:
        read_document(written(folder, text))
    return [(f.code, f.lines[0] if f.lines else None) for f in caught.value.faults]


@pytest.mark.parametrize(
    ("text", "wanted"),
    [
        ("1e-3", 1e-3),
        ("1E5", 1e5),
        (".5", 0.5),
        ("5.", 5.0),
        ("+.5e+1", 5.0),
        ("-0.0", -0.0),
        ("12", 12),
        ("-7", -7),
        ("010", 10),
        ("0x10", 16),
        ("0o17", 15),
        (".inf", math.inf),
        ("-.inf", -math.inf),
        ("~", None),
        ("", None),
        ("null", None),
        ("true", True),
        ("FALSE", False),
        ("no", "no"),
        ("yes", "yes"),
        ("on", "on"),
        ("y", "y"),
        ("12:30", "12:30"),
        ("2026-01-02", "2026-01-02"),
        ("1_000", "1_000"),
        ("0b11", "0b11"),
        ("1.2.3", "1.2.3"),
        ("1e", "1e"),
        (".", "."),
        ("-", [None]),
        ("+", "+"),
        ("=", "="),
        ("inf", "inf"),
        ("nan", "nan"),
        ("²", "²"),
        ("'12'", "12"),
        ('"~"', "~"),
        ("''", ""),
        ("'true'", "true"),
        ("|\n  12\n", "12\n"),
        ("24000/1001", "24000/1001"),
    ],
)
def test_scalars_of_the_core_schema(tmp_path: Path, text: str, wanted: object) -> None:
    if wanted == [None]:
        text = f"\n  {text}"
    found = value(tmp_path, f"a: {text}")["a"]
    assert found == wanted
    assert type(found) is type(wanted)


@pytest.mark.parametrize(
    "text", ["{e: f(x, y: 2}", "{e: f(x, y): 2}", "{e: 'f(x', y)}", "{e: (, y}"]
)
def test_brackets_that_are_not_of_one_text(tmp_path: Path, text: str) -> None:
    assert set(value(tmp_path, f"a: {text}")["a"]) > {"e"}


def test_a_text_that_a_comma_cuts_is_put_together(tmp_path: Path) -> None:
    with pytest.raises(FormatError) as caught:
        value(tmp_path, "a: {expr: clamp(x, 0, 1)}")
    (fault,) = caught.value.faults
    assert (fault.column, fault.hint) == (11, 'quote all of it: "clamp(x, 0, 1)"')


def test_not_a_number(tmp_path: Path) -> None:
    assert math.isnan(value(tmp_path, "a: .nan")["a"])


TRAPS = {
    "an anchor": ("a: &x 1", [("DOC002", 1)]),
    "an alias": ("a: &x 1\nb: *x", [("DOC002", 1), ("DOC002", 2)]),
    "an alias of nothing": ("a: 1\nb: *x", [("DOC002", 2)]),
    "an alias as a key": ("a: 1\n*x : 2", [("DOC002", 2), ("DOC010", 2)]),
    "an object": ("a: !!python/object:os.system {}", [("DOC003", 1)]),
    "a call": ("a: !!python/object/apply:os.system [ls]", [("DOC003", 1)]),
    "binary": ("b: 1\na: !!binary aGk=", [("DOC003", 2)]),
    "a tag of text": ("a: !!str 1", [("DOC003", 1)]),
    "a tag of its own": ("a: !vector [1, 2]", [("DOC003", 1)]),
    "a tagged key": ("!!str a: 1", [("DOC003", 1)]),
    "a key twice": ("a: 1\nb: 2\na: 3", [("DOC004", 3)]),
    "a key twice within": ("a: [{b: 1, b: 2}]", [("DOC004", 1)]),
    "quoted twice": ("a: 1\n'a': 3", [("DOC004", 2)]),
    "a merge of an alias": (
        "a: &x {b: 1}\nc:\n  <<: *x",
        [("DOC002", 1), ("DOC002", 3)],
    ),
    "a number as key": ("a: 1\n1: 2", [("DOC010", 2)]),
    "times as keys": ("keys: {1: 0, 24.5: [1, 2]}", [("DOC010", 1)]),
    "times in lines": ("keys:\n  1: {v: 0}\n  a: 2\n  8: 3", [("DOC010", 2)]),
    "yes as key": ("a: 1\ntrue: 2", [("DOC010", 2)]),
    "nothing as key": ("~: 1", [("DOC010", 1)]),
    "a list as key": ("? [1, 2]\n: 3", [("DOC010", 1)]),
    "a mapping as key": ("{a: 1}: 3", [("DOC010", 1)]),
    "a text that a comma cuts": ("a: {e: f(x, y), b: 1}", [("DOC010", 1)]),
    "one that commas cut": ("a:\n- {e: f(x, 0, 1)}", [("DOC010", 2)]),
    "one of several lines": (
        "a: {e: max(min(x, 1),\n  0, 0), 2: 1}",
        [("DOC010", 1), ("DOC010", 2)],
    ),
    "flow depth": ("a: " + "[" * 10_000 + "]" * 10_000, [("DOC005", 1)]),
    "flow depth of keys": ("a: " + "{b: " * 10_000, [("DOC005", 1)]),
    "block depth": ("a:\n  " + "- " * 10_000 + "1", [("DOC005", 2)]),
    "a second document": ("a: 1\n---\nb: 2", [("DOC007", 2)]),
    "empty": ("", [("DOC007", 1)]),
    "comments only": ("# nothing\n", [("DOC007", 1)]),
    "an empty document": ("---\n", [("DOC007", 1)]),
    "a list": ("- 1", [("DOC007", 1)]),
    "text": ("hello", [("DOC007", 1)]),
    "latin 1": (b"a: 1\nb: caf\xe9", [("DOC008", 2)]),
    "no text": (b"\x01\xe9\0\0", [("DOC008", None)]),
    "utf 16": ("a: 1".encode("utf-16"), [("DOC008", 1)]),
    "a tab": ("a:\n\tb: 1", [("DOC001", 2)]),
    "NUL": ("a: 1\nb: \0", [("DOC001", 1)]),
    "a control character": ("a: 1\nb: \x07", [("DOC001", 1)]),
    "5000 digits": ("a: 1\nb: " + "9" * 5000, [("DOC001", 2)]),
    "5000 hexadecimal digits": ("b: 0x" + "9" * 5000, [("DOC001", 1)]),
    "an open bracket": ("a: [1, 2\nb: 3", [("DOC001", 1)]),
    "an open quote": ("a: 'x", [("DOC001", 1)]),
    "bad indent": ("a:\n    b: 1\n  c: 2", [("DOC001", 3)]),
    "a later YAML": ("%YAML 3.0\n---\na: 1", [("DOC001", 1)]),
    "a lone surrogate": ('a: "\\ud800"', [("DOC001", 1)]),
}


@pytest.mark.parametrize("trap", TRAPS)
def test_what_is_refused(tmp_path: Path, trap: str) -> None:
    text, wanted = TRAPS[trap]
    assert refused(tmp_path, text) == wanted


@pytest.mark.parametrize(
    ("given", "form"),
    [
        ("{1: 0}", "keys: [{t: 1, v: 0}]"),
        ("{1: [0, 2], 24.5: a}", "keys: [{t: 1, v: [0, 2]}, {t: 24.5, v: a}]"),
        ("{1: {v: 0, interp: linear}}", "keys: [{t: 1, v: 0, interp: linear}]"),
        (f"{{{', '.join(f'{i}: 0' for i in range(1, 500))}}}", "{t: 1, v: 0}, …]"),
    ],
)
def test_times_that_are_keys_are_told_as_a_list(
    tmp_path: Path, given: str, form: str
) -> None:
    path = tmp_path / "a.yaml"
    path.write_text(f"channels:\n- keys: {given}", "utf-8")
    with pytest.raises(FormatError) as caught:
        read_document(path)
    (fault,) = caught.value.faults
    assert fault.code == "DOC010"
    assert (fault.hint or "").endswith(form)


@pytest.mark.parametrize(
    ("text", "form"),
    [
        (
            "passes:\n- layer: {weight: {1: 0, 12: 1, 24: 0}}",
            "write weight: [[1, 0], [12, 1], [24, 0]]",
        ),
        ("passes:\n- time_warp:\n    curve:\n      1: 5\n", "write curve: [[1, 5]]"),
        ("systems:\n- a: {moves: {0.5: [1, 2, 3]}}", "write moves: [[0.5, 1, 2, 3]]"),
        # A goal's weight is a number.
        ("targets: a\ngoals:\n- weight: {1: 0}", "quote it"),
    ],
)
def test_times_that_are_keys_are_told_as_rows(
    tmp_path: Path, text: str, form: str
) -> None:
    path = tmp_path / "a.yaml"
    path.write_text(text, "utf-8")
    with pytest.raises(FormatError) as caught:
        read_document(path)
    (fault,) = caught.value.faults
    assert (fault.code, fault.hint) == ("DOC010", form)


@pytest.mark.parametrize(
    ("name", "hint"), [("walk.bvh", "ends in .yaml"), ("walk.yml", "spaces")]
)
def test_a_file_of_another_kind_is_told_what_is_wanted(
    tmp_path: Path, name: str, hint: str
) -> None:
    path = tmp_path / name
    path.write_text("a:\n\tb: 1", "utf-8")
    with pytest.raises(FormatError) as caught:
        read_document(path)
    assert hint in (caught.value.faults[0].hint or "")


@pytest.mark.parametrize(
    ("name", "kind"),
    [
        ("a.targets.yaml", "targets"),
        ("a.rig.v2.clip.yaml", "clip"),
        ("rig.json", "rig"),
        ("a.b.yaml", "rig"),
    ],
)
def test_an_empty_file_is_told_the_first_line_of_its_kind(
    tmp_path: Path, name: str, kind: str
) -> None:
    path = tmp_path / name
    path.write_text("", "utf-8")
    with pytest.raises(FormatError) as caught:
        read_document(path)
    hint = caught.value.faults[0].hint
    assert hint == f"start it with a line such as '{kind}: animtool/1'"


def test_block_depth_by_indents(tmp_path: Path) -> None:
    text = "".join(" " * i + "a:\n" for i in range(1000))
    assert refused(tmp_path, text) == [("DOC005", 51)]


def test_fifty_levels_are_read(tmp_path: Path) -> None:
    assert value(tmp_path, "a: " + "[" * 49 + "]" * 49)
    assert refused(tmp_path, "a: " + "[" * 50 + "]" * 50) == [("DOC005", 1)]


def test_a_billion_laughs_are_not_laughed(tmp_path: Path) -> None:
    lines = ["a0: &a0 [lol, lol]"]
    lines += [f"a{i}: &a{i} [{', '.join([f'*a{i - 1}'] * 9)}]" for i in range(1, 30)]
    codes = {code for code, _ in refused(tmp_path, "\n".join(lines))}
    assert codes == {"DOC002", "DOC011"}


def test_a_large_file_is_not_read_whole(tmp_path: Path) -> None:
    path = tmp_path / "a.yaml"
    with path.open("wb") as file:
        file.truncate(100_000_000_000)
    with pytest.raises(FormatError) as caught:
        read_document(path)
    assert caught.value.code == "DOC006"


def test_no_file(tmp_path: Path) -> None:
    for path in (tmp_path / "none.yaml", tmp_path):
        with pytest.raises(FormatError) as caught:
            read_document(path)
        assert caught.value.code == "IO001"


def test_all_faults_at_once(tmp_path: Path) -> None:
    text = "a: &x 1\nb: !!str 2\na: 3\n1: 4"
    wanted = [("DOC002", 1), ("DOC003", 2), ("DOC004", 3), ("DOC010", 4)]
    assert refused(tmp_path, text) == wanted


def test_many_faults_are_counted(tmp_path: Path) -> None:
    text = "".join("a: 1\n" for _ in range(MAX_FAULTS + 51))
    found = refused(tmp_path, text)
    assert len(found) == MAX_FAULTS + 1
    assert found[-1] == ("DOC011", None)


def test_byte_order_mark(tmp_path: Path) -> None:
    document = read_document(written(tmp_path, b"\xef\xbb\xbfa: 1"))
    assert document.value == {"a": 1}
    assert document.position(("a",)) == (1, 4)


def test_line_ends(tmp_path: Path) -> None:
    document = read_document(written(tmp_path, b"a: 1\r\nb:\r\n- 2\r\n"))
    assert document.value == {"a": 1, "b": [2]}
    assert document.position(("b", 0)) == (3, 3)


JSON = {
    "rig": "animtool/1",
    "joints": [{"name": "a/b", "translate": [0, 1e-3, -2.5e10], "tips": []}],
    "none": None,
    "flag": True,
    "text": 'quote " backslash \\ tab \t new\nline é 😀',
    "": "empty key",
}


@pytest.mark.parametrize("indent", [None, 2, "\t"])
@pytest.mark.parametrize("ascii_only", [True, False])
def test_json(tmp_path: Path, indent: int | str | None, ascii_only: bool) -> None:
    text = json.dumps(JSON, indent=indent, ensure_ascii=ascii_only)
    assert read_document(written(tmp_path, text, "a.json")).value == JSON


def test_json_without_blanks(tmp_path: Path) -> None:
    text = json.dumps(JSON, separators=(",", ":")).replace("/", "\\/")
    assert read_document(written(tmp_path, text, "a.json")).value == JSON


def test_places(tmp_path: Path) -> None:
    text = "a: 1\nlist:\n  - {x: 1, y: [5, 6]}\n  - 7\nend: {}\n"
    document = read_document(written(tmp_path, text))
    assert document.position(()) == (1, 1)
    assert document.position(("list",)) == (3, 3)
    assert document.position(("list", 0, "y")) == (3, 15)
    assert document.position(("list", 0, "y", 1)) == (3, 19)
    assert document.position(("list", 1)) == (4, 5)
    assert document.position(("end",)) == (5, 6)


def test_places_of_what_is_not_there(tmp_path: Path) -> None:
    document = read_document(written(tmp_path, "a: 1\nb:\n  c: [1]\n"))
    assert document.position(("b", "d")) == (3, 3)
    assert document.position(("b", "c", 5)) == (3, 6)
    assert document.position(("z",)) == (1, 1)


def test_what_is_odd_is_no_fault(tmp_path: Path) -> None:
    document = read_document(written(tmp_path, "a: 1\nb: 2\n"))
    document.placeholders.add(("b",))
    document.note("RIG101", ("a",), "is odd")
    document.note("RIG101", ("b",), "is odd")
    document.check()
    (note,) = document.notices
    assert (note.severity, note.lines, note.where) == (Severity.NOTE, (1,), "a")


@pytest.mark.slow
def test_a_file_is_numbered_once_for_many_faults(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    text = "a:\n" + "".join(f"- {{n: {i}}}\n" for i in range(20_000))
    document = read_document(written(tmp_path, text))
    calls: list[int] = []
    number = Document._index_nodes

    def counted(self: Document, node: Any, index: int) -> int:
        calls.append(index)
        return number(self, node, index)

    monkeypatch.setattr(Document, "_index_nodes", counted)
    for i in range(20_000):
        document.warn("DOC022", ("a", i, "n"), "x")
    assert len(calls) == 2 + 2 * 20_000
    assert document.notices[19_999].lines == (20_001,)


def locations(node: Any, here: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    yield here
    steps = node.items() if isinstance(node, dict) else ()
    steps = enumerate(node) if isinstance(node, list) else steps
    for step, inner in steps:
        yield from locations(inner, (*here, step))


def composed(text: str) -> dict[tuple[Any, ...], tuple[int, int]]:
    """Return line and column of every value, by the nodes of another parser."""
    found: dict[tuple[Any, ...], tuple[int, int]] = {}

    def walk(node: yaml.Node, here: tuple[Any, ...]) -> None:
        found[here] = (node.start_mark.line + 1, node.start_mark.column + 1)
        if isinstance(node, yaml.MappingNode):
            for key, inner in node.value:
                walk(inner, (*here, key.value))
        elif isinstance(node, yaml.SequenceNode):
            for i, inner in enumerate(node.value):
                walk(inner, (*here, i))

    walk(yaml.compose(text, yaml.CSafeLoader), ())
    return found


def read_text(text: str, name: str) -> Document:
    with tempfile.TemporaryDirectory() as folder:
        return read_document(written(Path(folder), text, name))


@given(VALUES, st.booleans(), st.booleans())
def test_yaml_reads_back(values: dict[str, Any], flow: bool, wide: bool) -> None:
    text = yaml.dump(
        values,
        Dumper=NoAliases,
        default_flow_style=flow,
        allow_unicode=wide,
        width=10_000,
        sort_keys=False,
    )
    document = read_text(text, "a.yaml")
    assert document.value == values
    places = composed(text)
    assert {at: document.position(at) for at in locations(values)} == places


class NoAliases(yaml.SafeDumper):
    def ignore_aliases(self, data: Any) -> bool:  # noqa: ARG002
        return True


def quoted_text(dumper: NoAliases, value: str) -> yaml.ScalarNode:
    # YAML 1.1, which the dumper writes, takes 0E0 for text.
    style = '"' if value[:1] in "+-.0123456789" else None
    return dumper.represent_scalar("tag:yaml.org,2002:str", value, style=style)


NoAliases.add_representer(str, quoted_text)


@given(VALUES, st.sampled_from([None, 1]), st.booleans())
def test_json_reads_back(
    values: dict[str, Any], indent: int | None, ascii_only: bool
) -> None:
    values = json.loads(json.dumps(values).replace("Infinity", "0"))
    text = json.dumps(values, indent=indent, ensure_ascii=ascii_only)
    document = read_text(text, "a.json")
    assert document.value == values
    if indent:
        for at in locations(values):
            line = text.split("\n")[document.position(at)[0] - 1]
            name = [step for step in at if isinstance(step, str)][-1:]
            if at and isinstance(at[-1], str):
                assert json.dumps(name[0], ensure_ascii=ascii_only) in line


@given(st.text(max_size=60))
def test_any_text_is_read_or_refused(text: str) -> None:
    codes: list[str] = []
    value: Any = {}
    try:
        value = read_text(text.encode("utf-8", "replace").decode(), "a.yaml").value
    except FormatError as error:
        codes = [fault.code for fault in error.faults]
    assert isinstance(value, dict)
    assert all(code.startswith("DOC") for code in codes)


@pytest.mark.parametrize(
    "text", [r'a: "\e[2J"', r'"a\x9b": 1', r'"a\nb": 1', r'a: "\0"']
)
def test_control_characters_are_refused(tmp_path: Path, text: str) -> None:
    assert refused(tmp_path, text) == [("DOC023", 1)]


@pytest.mark.parametrize(
    ("text", "found"),
    [
        ("name: \u201carm\u201d", True),
        ("name: \u2018arm\u2019", True),
        ("names: [hips, \u201carm\u201d]", True),
        ("name: \u201earm\u201c", True),
        ("name: \xabarm\xbb", True),
        ("name: '\u201carm\u201d'", False),  # on purpose
        ("why: \u201cit falls on purpose\u201d", False),
        ("name: l\u2019arm", False),
        ("name: arm  # \u201cthe\u201d arm", False),
        ("name: arm", False),
    ],
)
def test_typographic_quotes(tmp_path: Path, text: str, found: bool) -> None:
    document = read_document(written(tmp_path, text))
    assert [notice.code for notice in document.notices] == ["DOC103"] * found
    if found:
        ((line,), column) = document.notices[0].lines, document.notices[0].column
        assert (line, text[column - 1] in "\u201c\u2018\u201e\xab") == (1, True)


def test_a_second_document_has_a_remedy(tmp_path: Path) -> None:
    path = tmp_path / "a.scene.yaml"
    path.write_text("a: 1\n---\nb: 2\n")
    with pytest.raises(FormatError) as caught:
        read_document(path)
    (fault,) = caught.value.faults
    assert (fault.code, fault.lines) == ("DOC007", (2,))
    assert "---" in (fault.hint or "")
