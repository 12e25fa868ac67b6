"""The items of a batch: which, in which order, and where they go."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import pytest
from support.batch import take_files
from support.faults import raises

from animtool.batch.discover import find_batch
from animtool.batch.plan import check_output_files
from animtool.batch.spec import BatchSpec
from animtool.core.errors import (
    FormatError,
    NoMatchError,
    OptionError,
    Severity,
    StrictError,
)
from animtool.scene.bake.options import BakeOptions
from animtool.validation.run import validate

SCENE = "scene: animtool/1\nsource:\n  file: ${input}\n"


def made(folder: Path, *inputs: str, **given: object) -> list[tuple[str, str]]:
    """Return inputs and outputs of a batch, seen from its folder."""
    batch = find_batch(BatchSpec(inputs, folder, **given))  # type: ignore[arg-type]
    assert [item.number for item in batch.items] == list(range(1, len(batch.items) + 1))
    return [
        (
            item.file.path.relative_to(folder).as_posix(),
            item.output.relative_to(folder).as_posix(),
        )
        for item in batch.items
    ]


@pytest.fixture
def takes(tmp_path: Path) -> Path:
    take_files(tmp_path / "takes", 2)
    take_files(tmp_path / "takes/a/b", 1)
    return tmp_path


def test_outputs_stand_props_inputs(takes: Path) -> None:
    assert made(takes, "takes") == [
        ("takes/a/b/take000.bvh", "takes/a/b/take000.usdc"),
        ("takes/take000.bvh", "takes/take000.usdc"),
        ("takes/take001.bvh", "takes/take001.usdc"),
    ]


def test_names_of_inputs_and_variables(takes: Path) -> None:
    pattern = "out/{shot}/{parent}/{stem}_{name}.usda"
    found = made(takes, "takes/**/*0.bvh", output=pattern, variables={"shot": "s1"})
    assert [output for _, output in found] == [
        "out/s1/a/b/take000_take000.bvh.usda",
        "out/s1/take000_take000.bvh.usda",
    ]


def test_a_folder_gets_the_folders_of_inputs(takes: Path) -> None:
    assert [output for _, output in made(takes, "takes", output="out/")] == [
        "out/a/b/take000.usdc",
        "out/take000.usdc",
        "out/take001.usdc",
    ]


@pytest.mark.parametrize("pattern", ["out", "out/{stem}", "{stem}.txt"])
def test_outputs_of_no_kind_are_refused_before_the_work(
    takes: Path, pattern: str
) -> None:
    with pytest.raises(OptionError) as error:
        made(takes, "takes", output=pattern)
    (fault,) = error.value.faults
    assert fault.code == "OUT004"
    names_folder = f"{pattern}/ is a folder" in (fault.hint or "")
    assert names_folder == (pattern != "{stem}.txt")


def test_each_input_once_less_what_is_excluded(takes: Path) -> None:
    found = made(takes, "takes/take*.bvh", "takes", exclude=("takes/a", "takes/*1.bvh"))
    assert [path for path, _ in found] == ["takes/take000.bvh"]


def test_an_input_that_is_named_twice_is_what_it_is_called_first(takes: Path) -> None:
    given = ("takes/a", "takes/a/b/take000.bvh")
    assert [o for _, o in made(takes, *given, output="out/")] == ["out/b/take000.usdc"]
    found = made(takes, *reversed(given), output="out/")
    assert [output for _, output in found] == ["out/take000.usdc"]


def test_order_is_that_of_names(takes: Path) -> None:
    one = made(takes, "takes/take001.bvh", "takes/a", "takes/take000.bvh")
    assert one == made(takes, "takes")


def test_there_must_be_an_input(takes: Path) -> None:
    with pytest.raises(NoMatchError) as error:
        made(takes, "takes", exclude=("takes",))
    assert error.value.code == "BAT005"


@pytest.mark.parametrize(
    ("text", "hint"),
    [
        ("takez/*.bvh", "did you mean the folder 'takes'?"),
        ("takes/run_*.bvh", None),
        ("empty", "folders are searched for .bvh"),
    ],
)
def test_an_input_that_matches_no_file_is_named(
    takes: Path, text: str, hint: str | None
) -> None:
    (takes / "empty").mkdir()
    batch = find_batch(BatchSpec(("takes", text), folder=takes))
    assert len(batch.items) == len(made(takes, "takes"))
    (notice,) = batch.notices
    assert (notice.code, notice.severity) == ("BAT067", Severity.WARNING)
    assert notice.message == f"no file matches {text!r}"
    assert notice.hint == hint or (hint and str(notice.hint).startswith(hint))


def test_an_excluded_file_that_does_not_exist_is_named(takes: Path) -> None:
    exclude = ("wlak.bvh", "takes/old/*.bvh")
    batch = find_batch(BatchSpec(("takes",), folder=takes, exclude=exclude))
    (notice,) = batch.notices
    assert (notice.code, notice.severity) == ("BAT067", Severity.WARNING)
    assert "'wlak.bvh'" in notice.message


def test_strict_counts_inputs_that_match_no_file(takes: Path) -> None:
    spec = BatchSpec(("takes", "nope/*.bvh"), folder=takes)
    with pytest.raises(StrictError) as caught:
        find_batch(replace(spec, options=replace(spec.options, strict=True)))
    assert [fault.code for fault in caught.value.faults] == ["BAT067"]


def test_validate_names_inputs_that_match_no_file(takes: Path) -> None:
    path = takes / "all.batch.yaml"
    path.write_text("batch: animtool/1\ninputs: [takes, 'nope/*.bvh']\n")
    (finding,) = validate(path)
    assert (finding.code, finding.where) == ("BAT067", "inputs[1]")


def test_a_folder_is_searched_for_no_usd(takes: Path) -> None:
    (takes / "takes/take000.usdc").touch()
    (takes / "takes/shot.scene.yaml").write_text(
        "scene: animtool/1\nsource: {file: take000.bvh}\noutput: {file: s.usda}\n"
    )
    assert ("takes/shot.scene.yaml", "takes/s.usda") in made(takes, "takes")
    (takes / "t.scene.yaml").write_text(SCENE)
    with_scene = made(takes, "takes", scene=takes / "t.scene.yaml")
    assert [path.rpartition(".")[2] for path, _ in with_scene] == ["bvh"] * 3
    assert made(takes, "takes/*.usdc", output="out/{stem}.usdc")


def test_a_scene_names_several_outputs_of_each_item(takes: Path) -> None:
    scene = takes / "t.scene.yaml"
    scene.write_text(
        f'{SCENE}output: [{{file: "a/${{stem}}.usda"}}, {{file: b.bvh}}]\n'
    )
    spec = BatchSpec(("takes/take000.bvh",), takes, scene=scene)
    (item,) = find_batch(spec).items
    names = [takes / "a/take000.usda", takes / "b.bvh"]
    assert (item.output, [*item.files]) == (names[0], names)
    assert item.folders == [takes / "a", takes]
    # The second would be one file of all items.
    with pytest.raises(OptionError) as caught:
        check_output_files(find_batch(replace(spec, inputs=("takes",))))
    assert caught.value.code == "OUT007"
    scene.write_text(f"{SCENE}output: [{{file: a.usda}}, {{file: A.usda}}]\n")
    with raises(OptionError, "OUT007"):
        check_output_files(find_batch(spec))


def test_an_output_props_those_of_a_scene_is_refused(takes: Path) -> None:
    scene = takes / "t.scene.yaml"
    for output in ("[{file: a.usda}, {file: b.bvh}]", "{file: b.clip.yaml}"):
        scene.write_text(f"{SCENE}output: {output}\n")
        with pytest.raises(OptionError) as caught:
            made(takes, "takes", scene=scene, output="out/{stem}.usdc")
        assert (caught.value.code, caught.value.faults[0].path) == (
            "SCN044",
            str(scene),
        )


def test_the_scene_is_checked_before_the_work(takes: Path) -> None:
    (takes / "t.scene.yaml").write_text(SCENE + "passes: [{trimm: {}}]\n")
    with pytest.raises(FormatError) as error:
        made(takes, "takes", scene=takes / "t.scene.yaml")
    assert error.value.code == "SCN010"


@pytest.mark.parametrize("name", ["shott", "stem"])
def test_variables_that_nothing_uses(takes: Path, name: str) -> None:
    (takes / "t.scene.yaml").write_text(
        "scene: animtool/1\nvariables: {shot: a}\nsource:\n  file: ${input}\n"
    )
    scene = takes / "t.scene.yaml"
    made(takes, "takes", scene=scene, variables={"shot": "b"})
    with pytest.raises(OptionError) as error:
        made(takes, "takes", scene=scene, variables={name: "b"})
    assert error.value.code == "SCN031"


@pytest.mark.parametrize("name", ["stm", "basename", "filename"])
def test_a_name_in_the_output_that_there_is_none_of(takes: Path, name: str) -> None:
    with pytest.raises(OptionError) as error:
        made(takes, "takes", output=f"{{{name}}}.usdc")
    assert error.value.code == "BAT004"
    assert re.search("write {stem}|'stem'", str(error.value))


@pytest.mark.parametrize(
    ("output", "root"), [("out/x/{parent}/{stem}.usdc", "out/x"), (None, ".")]
)
def test_records_stand_below_the_folder_of_all_outputs(
    takes: Path, output: str | None, root: str
) -> None:
    batch = find_batch(BatchSpec(("takes",), takes, output=output))
    assert batch.records_folder == takes / root / ".animtool"


def test_every_file_of_an_output_is_known(takes: Path) -> None:
    split = BakeOptions(form="split")
    batch = find_batch(BatchSpec(("takes/take000.bvh",), takes, options=split))
    names = [path.name for path in batch.outputs(batch.items[0])]
    assert names == ["take000.rig.usda", "take000.anim.usdc", "take000.usdc"]


def test_outputs_that_the_scene_names(takes: Path) -> None:
    text = SCENE + "output:\n  file: made/${stem}_x.usda\n"
    (takes / "t.scene.yaml").write_text(text)
    found = made(takes, "takes/*.bvh", scene=takes / "t.scene.yaml")
    assert [path for _, path in found] == [
        "made/take000_x.usda",
        "made/take001_x.usda",
    ]
    given = made(
        takes, "takes/*0.bvh", scene=takes / "t.scene.yaml", output="{stem}.usdc"
    )
    assert given == [("takes/take000.bvh", "take000.usdc")]


def test_outputs_are_in_one_of_several_roots(takes: Path) -> None:
    roots = (takes / "renders", takes / "out")
    given = {"output": "out/{stem}.usdc", "roots": roots}
    assert len(made(takes, "takes/take*.bvh", **given)) == 2
    with pytest.raises(OptionError) as error:
        made(takes, "takes/take*.bvh", output="else/{stem}.usdc", roots=roots)
    (fault,) = error.value.faults
    assert fault.code == "DOC014"
    assert str(takes / "else") in fault.message


def test_files_among_the_options_count_as_seen_from_the_root(takes: Path) -> None:
    def described(folder: Path, name: str) -> object:
        options = BakeOptions(rig_layer=folder / name)
        spec = BatchSpec(("takes/take000.bvh",), takes, options=options)
        batch = find_batch(spec)
        return batch.item_task.settings(batch.items[0], folder)["options"]

    one, other = takes / "one", takes / "two"
    assert described(one, "a.usda") == described(other, "a.usda")
    assert described(one, "a.usda") != described(one, "b.usda")
