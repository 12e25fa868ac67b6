"""Variants of a batch: tables of values, and the items that they make."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from support.cli import animtool

from animtool.batch.discover import find_batch
from animtool.batch.file import load_batch
from animtool.batch.plan import check_output_files
from animtool.batch.run import RunOptions, run_batch
from animtool.batch.spec import BatchSpec
from animtool.batch.variants import (
    file_name_part,
    range_values,
    read_variants,
    variants_of_columns,
    variants_of_texts,
)
from animtool.core.errors import AnimtoolError, FormatError, OptionError

SWING = (
    "scene: animtool/1\nfps: 24\nrange: [1, 2]\nvariables: {k: 50}\nsystems:\n"
    "- rope: {name: rope, from: [0, 0, 0], to: [0, -1, 0], count: 3, mass: 1,\n"
    "    springs: {structural: {stiffness: ${k}, ratio: 0.1}},"
    " pins: [{particles: [start]}]}\n"
)
USES = "scene: animtool/1\nsource: {file: ${input}}\n"


@pytest.fixture
def swing(tmp_path: Path) -> Path:
    path = tmp_path / "swing.scene.yaml"
    path.write_text(SWING, "utf-8")
    return path


def written(folder: Path, name: str, text: str) -> Path:
    path = folder / name
    path.write_text(text, "utf-8")
    return path


def places(error: AnimtoolError) -> list[tuple[str, int, int]]:
    return [(f.code, f.lines[0], f.column or 0) for f in error.faults]


def outputs(spec: BatchSpec) -> list[str]:
    return [item.output.name for item in find_batch(spec).items]


@pytest.mark.parametrize(
    ("text", "rows"),
    [
        ("{k: [1, 1e-3, x]}", [{"k": "1"}, {"k": "1e-3"}, {"k": "x"}]),
        ("{k: 1..2, s: '0..1/0.5'}", [
            {"k": k, "s": s} for k in "12" for s in ("0", "0.5", "1")
        ]),
        ("{k: {start: 3, stop: 2.5, step: -0.25}}", [
            {"k": "3"}, {"k": "2.75"}, {"k": "2.5"}
        ]),
        ("\n- {k: 1, s: on}\n- {s: off, k: true}", [
            {"k": "1", "s": "on"}, {"k": "true", "s": "off"}
        ]),
        ("table.csv", [{"k": "1", "s": "a, b"}, {"k": "2", "s": "c"}]),
    ],
)  # fmt: skip
def test_tables_of_batch_files(
    tmp_path: Path, text: str, rows: list[dict[str, str]]
) -> None:
    written(tmp_path, "table.csv", '\ufeffk, s\r\n1,"a, b"\r\n\r\n2,c\r\n')
    path = written(
        tmp_path,
        "a.batch.yaml",
        f"batch: animtool/1\ninputs: [a.scene.yaml]\nvariants: {text}\n",
    )
    assert list(load_batch(path).rows) == rows


@pytest.mark.parametrize(
    ("text", "faults"),
    [
        ("{k: [1, .nan, '']}", [("BAT064", 3, 25), ("DOC022", 3, 19)]),
        ("{k: 5..1, s: '1,,2', t: {start: 0, stop: 1, step: 0}}", [
            ("BAT064", 3, 15), ("BAT064", 3, 24), ("BAT064", 3, 35)
        ]),
        ("{2k: [1], stem: [2], shot: [3]}", [("BAT063", 3, 16), ("BAT063", 3, 27)]),
        ("[{k: 1, s: 2}, {k: 1}, {k: 1, s: 2, t: 3}]", [
            ("BAT062", 3, 26), ("BAT062", 3, 34)
        ]),
        ("{k: 1..200, s: 1..200}", [("BAT065", 3, 11)]),
        ("{k: []}", [("BAT065", 3, 11)]),
        ("none.csv", [("DOC015", 3, 11)]),
    ],
)  # fmt: skip
def test_faults_of_batch_files(
    tmp_path: Path, text: str, faults: list[tuple[str, int, int]]
) -> None:
    path = written(
        tmp_path,
        "a.batch.yaml",
        f"batch: animtool/1\ninputs: [a.scene.yaml]\nvariants: {text}\n",
    )
    with pytest.raises(FormatError) as caught:
        load_batch(path)
    assert sorted(places(caught.value)) == sorted(faults)


@pytest.mark.parametrize(
    ("text", "faults"),
    [
        ("", [("BAT061", 1, 0)]),
        ("k\n", [("BAT061", 1, 0)]),
        ('k\n"1\n', [("BAT061", 2, 1)]),
        ("k,s,t\n1,2,3\n4,5\n6,,8,9\n10,nan,\n", [
            ("BAT062", 3, 3), ("BAT062", 4, 6), ("BAT064", 5, 4), ("BAT064", 5, 8)
        ]),
        ("k,k,a b\n1,2,3\n", [("BAT063", 1, 3), ("BAT063", 1, 5)]),
        ("k\n" + "1\n" * 10_001, [("BAT065", 10_002, 0)]),
    ],
)  # fmt: skip
def test_faults_of_tables(
    tmp_path: Path, text: str, faults: list[tuple[str, int, int]]
) -> None:
    with pytest.raises(FormatError) as caught:
        read_variants(written(tmp_path, "a.csv", text))
    assert places(caught.value) == faults


def test_columns_of_tables_are_parted_by_tabs_in_tsv_files(tmp_path: Path) -> None:
    for name in ("a.tsv", "B.TSV"):
        found = read_variants(written(tmp_path, name, "k\ts\n1\t2, 3\n"))
        assert found.rows == ({"k": "1", "s": "2, 3"},)


def test_as_many_variants_as_are_allowed() -> None:
    hundred = [str(i) for i in range(100)]
    assert len(variants_of_columns({"k": hundred, "s": hundred}).rows) == 10_000
    assert len(range_values("1", "10000")) == 10_000


@pytest.mark.parametrize(
    ("value", "name"), [("v1.", "v1."), (".v1", "v1"), ("a+b/c", "a+b_c"), ("..", "_")]
)
def test_values_in_names_of_files(value: str, name: str) -> None:
    assert file_name_part(value) == name


@pytest.mark.parametrize(
    ("texts", "codes"),
    [
        (["k"], ["BAT064"]),
        (["k 1 2"], ["BAT064"]),
        (["=1"], ["BAT063"]),
        (["k=1..x", "1=2"], ["BAT064", "BAT063"]),
        (["k=1..1e9"], ["BAT064"]),
        (["k=1..101", "s=1..101"], ["BAT065"]),
    ],
)
def test_faults_of_the_command_line(texts: list[str], codes: list[str]) -> None:
    with pytest.raises(OptionError) as caught:
        variants_of_texts(texts)
    assert [fault.code for fault in caught.value.faults] == codes


def test_a_text_without_a_sign_is_written_as_it_should_be() -> None:
    with pytest.raises(OptionError) as caught:
        variants_of_texts(["wind 1 2"])
    assert caught.value.faults[0].hint == "write wind=1,2"


def test_each_variant_is_an_item_and_a_changed_row_is_made_again(swing: Path) -> None:
    table = written(swing.parent, "t.csv", "k,label\n50,a/b\n1e3,../c\n")

    def run() -> list[str]:
        spec = BatchSpec(
            (str(swing),),
            swing.parent,
            output="out/{stem}_{label}.usda",
            variants=read_variants(table),
        )
        report = run_batch(spec, RunOptions(executor="serial"))
        assert not report.failed
        return [f"{r.item.output.name} {r.reason}" for r in report.items]

    assert run() == ["swing_a_b.usda new", "swing__c.usda new"]
    texts = [path.read_text() for path in sorted((swing.parent / "out").glob("*a"))]
    assert texts[0] != texts[1]
    written(swing.parent, "t.csv", "k,label\n50,a/b\n2e3,../c\n")
    assert run() == ["swing_a_b.usda up to date", "swing__c.usda options changed"]


def test_outputs_of_variants_are_kept_apart(swing: Path) -> None:
    spec = BatchSpec((str(swing),), variants=variants_of_texts(["k=1,2"]))
    assert outputs(spec) == ["swing_1.usdc", "swing_2.usdc"]
    folder = BatchSpec((str(swing),), output="o/", variants=spec.variants)
    assert outputs(folder) == ["swing_1.usdc", "swing_2.usdc"]
    alone = BatchSpec((), scene=swing, output="o/", variants=spec.variants)
    assert outputs(alone) == outputs(folder)
    clash = BatchSpec((str(swing),), output="o/x.usdc", variants=spec.variants)
    with pytest.raises(OptionError) as caught:
        check_output_files(find_batch(clash))
    (fault,) = caught.value.faults
    assert fault.code == "OUT007"
    assert "(k=1)" in fault.message
    assert "(k=2)" in fault.message
    assert "{k}" in str(fault.hint)


def test_the_same_values_twice_are_named_as_such(swing: Path) -> None:
    table = variants_of_texts(["k=1,1"])
    with pytest.raises(OptionError) as caught:
        check_output_files(find_batch(BatchSpec((str(swing),), variants=table)))
    assert "these values appear twice: remove one" in str(caught.value.faults[0].hint)


def test_a_table_of_another_separator_is_told_which_to_write(tmp_path: Path) -> None:
    with pytest.raises(FormatError) as caught:
        read_variants(written(tmp_path, "t.csv", "k;s\n1;2\n"))
    assert "commas" in str(caught.value.faults[0].hint)


@pytest.mark.parametrize("empty", ["[]", "{}"])
def test_variants_without_values_are_refused(swing: Path, empty: str) -> None:
    text = f"batch: animtool/1\ninputs: [{swing.name}]\nvariants: {empty}\n"
    (swing.parent / "a.batch.yaml").write_text(text)
    with pytest.raises(FormatError) as caught:
        load_batch(swing.parent / "a.batch.yaml")
    assert caught.value.code == "BAT061"


def test_names_of_variants_mean_nothing_else(swing: Path) -> None:
    for name, more in (("stem", {}), ("k", {"variables": {"k": "1"}})):
        table = variants_of_texts([f"{name}=1,2"])
        with pytest.raises(OptionError) as caught:
            find_batch(BatchSpec((str(swing),), variants=table, **more))  # type: ignore[arg-type]
        assert caught.value.code == "BAT063"


@pytest.mark.parametrize(
    ("scene", "more", "line"),
    [
        ("source: {file: a.bvh}\noutput: {file: '${stem}.usdc'}\n", {}, 2),
        ("variables: {x: a.bvh}\nsource: {file: ${x}}\n", {}, 3),
        ("source: {file: ${input}}\noutput: {file: ${k}.usdc}\n", {"k": "1,2"}, 0),
    ],
)
def test_a_scene_that_makes_the_same_of_all_items_is_refused(
    tmp_path: Path, walk: Path, scene: str, more: dict[str, str], line: int
) -> None:
    for name in ("a", "b"):
        (tmp_path / f"{name}.bvh").write_bytes(walk.read_bytes())
    path = written(tmp_path, "s.scene.yaml", f"scene: animtool/1\n{scene}")
    table = variants_of_texts([f"{k}={v}" for k, v in more.items()]) if more else None
    spec = BatchSpec(("*.bvh",), tmp_path, scene=path, variants=table)
    with pytest.raises(OptionError) as caught:
        find_batch(spec)
    (fault,) = caught.value.faults
    assert fault.code == "BAT060"
    assert fault.lines[:1] == ((line,) if line else ())
    assert "${" in str(fault.hint)


def test_a_scene_uses_its_input_through_its_variables(
    tmp_path: Path, walk: Path
) -> None:
    (tmp_path / "a.bvh").write_bytes(walk.read_bytes())
    text = "scene: animtool/1\nvariables: {x: '${stem}.bvh'}\nsource: {file: ${x}}\n"
    path = written(tmp_path, "s.scene.yaml", text)
    assert outputs(BatchSpec(("*.bvh",), tmp_path, scene=path)) == ["a.usdc"]


def test_variants_of_no_scene_are_refused(walk: Path) -> None:
    spec = BatchSpec(
        (str(walk),), output="{k}.usdc", variants=variants_of_texts(["k=1,2"])
    )
    with pytest.raises(OptionError) as caught:
        find_batch(spec)
    assert caught.value.code == "BAT060"


def test_variants_on_the_command_line(swing: Path) -> None:
    folder = swing.parent
    given = ("--scene", swing.name, "--vary", "k=1..2", "-o", "out/{k}.usdc")
    done = animtool("batch", *given, "-n", cwd=folder)
    assert done.stdout.splitlines() == [
        "make out/1.usdc (k=1) (new)",
        "make out/2.usdc (k=2) (new)",
    ]
    done = animtool(
        "batch", *given, "--items", "2", "-n", "--format", "json", cwd=folder
    )
    (item,) = json.loads(done.stdout)["items"]
    assert (item["item"], item["values"]) == (2, {"k": "2"})
    both = animtool("batch", *given, "--variants", "t.csv", cwd=folder)
    assert both.code == 2
    assert "--vary" in both.stderr


def test_an_end_of_a_range_with_an_underscore_is_no_number() -> None:
    with pytest.raises(ValueError, match=r"'0\._5' is not a finite number"):
        range_values("0", "0._5", "0.1")


WAVES = (
    "scene: animtool/1\nvariables: {input: a.bvh, waves: 4}\nsource: {file: ${input}}\n"
    "passes:\n- loop: {repeats: '${waves}'}\n"
)


@pytest.mark.parametrize(
    ("variants", "code", "line", "column", "hint"),
    [
        ("{waves: 1-2}", "SCN002", 4, 19, "for the numbers 1 to 2 write 1..2"),
        ("{waves: few}", "SCN002", 4, 19, None),
        ("\n- {waves: few}", "SCN002", 5, 11, None),
        ("{wave: 1..2}", "BAT060", 4, 18, "did you mean 'waves'?"),
        ("{k: 1..2}", "BAT060", 4, 15, "write ${k} in w.scene.yaml"),
        ("{waves: 1..2}", None, 0, 0, None),
    ],
)
def test_values_that_the_scene_refuses_are_located_in_the_batch(
    tmp_path: Path,
    walk: Path,
    variants: str,
    code: str | None,
    line: int,
    column: int,
    hint: str | None,
) -> None:
    (tmp_path / "a.bvh").write_bytes(walk.read_bytes())
    written(tmp_path, "w.scene.yaml", WAVES)
    text = "batch: animtool/1\ninputs: [a.bvh]\nscene: w.scene.yaml\n"
    name = "{k}" if "k:" in variants else "{waves}" if "waves" in variants else "{wave}"
    text += f"variants: {variants}\noutput: 'o/{{stem}}_{name}.usdc'\n"
    spec = load_batch(written(tmp_path, "w.batch.yaml", text))
    if code is None:
        assert len(find_batch(spec).items) == 2
        return
    with pytest.raises(AnimtoolError) as caught:
        find_batch(spec)
    (fault,) = caught.value.faults
    assert (fault.code, Path(str(fault.path)).name) == (code, "w.batch.yaml")
    assert (fault.lines, fault.column) == ((line,), column)
    assert hint is None or hint in str(fault.hint)


@pytest.mark.parametrize(
    ("text", "hint"),
    [
        ("4..1", "write 1..4, or 4..1/-1 to count down"),
        ("4..1/2", "write 1..4/2, or 4..1/-2 to count down"),
        ("1..4/-1", "write 1..4, or 4..1/-1 to count down"),
        ("{start: 4, stop: 1}", "write step: -1, or exchange start and stop"),
        ("{start: 1, stop: 4, step: -2}", "write step: 2, or exchange start and stop"),
    ],
)
def test_a_range_that_counts_away_from_its_end(
    tmp_path: Path, text: str, hint: str
) -> None:
    """Its name is known all the same: the output has no fault."""
    path = written(
        tmp_path,
        "a.batch.yaml",
        "batch: animtool/1\ninputs: [a.scene.yaml]\n"
        f"variants: {{k: {text}}}\noutput: '{{stem}}_{{k}}.usdc'\n",
    )
    with pytest.raises(FormatError) as caught:
        load_batch(path)
    assert [(fault.code, fault.hint) for fault in caught.value.faults] == [
        ("BAT064", hint)
    ]
    if ".." in text:
        with pytest.raises(OptionError) as refused:
            variants_of_texts([f"k={text}"])
        assert refused.value.faults[0].hint == hint


@pytest.mark.parametrize(
    ("variants", "codes"),
    [
        ("none.csv", ["DOC015"]),
        ("[{k: .nan}]", ["DOC022"]),
        ("{j: 4..1}", ["BAT004", "BAT064"]),
    ],
)
def test_names_of_faulty_variants_are_known(
    tmp_path: Path, variants: str, codes: list[str]
) -> None:
    path = written(
        tmp_path,
        "a.batch.yaml",
        "batch: animtool/1\ninputs: [a.scene.yaml]\n"
        f"variants: {variants}\noutput: '{{stem}}_{{k}}.usdc'\n",
    )
    with pytest.raises(FormatError) as caught:
        load_batch(path)
    assert sorted(fault.code for fault in caught.value.faults) == codes
