"""The reference of the files that people write: complete, and its examples load."""

from __future__ import annotations

import copy
import math
import re
from dataclasses import asdict, replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import pytest
import yaml
from pydantic import Field, TypeAdapter
from support.key_tables import PAGES, field_of, filled, keys_of, marked, models_of
from support.people import named, person
from support.suite import some_quick

from animtool import Clip, Rig, bake
from animtool.batch.discover import find_batch
from animtool.batch.file import load_batch
from animtool.batch.item import INPUT_NAMES
from animtool.capture.templates import load_template
from animtool.cli.schema import MODELS
from animtool.ik.file import load_targets
from animtool.ik.on_take import solve_take
from animtool.retarget import map_joints
from animtool.retarget.roles import DIGITS, ROLES, base_role
from animtool.rig.expressions import FUNCTIONS
from animtool.rig.joints import DRIVEN_PARTS, KEYED_PARTS
from animtool.rig.parts import AttachKind
from animtool.rig.skeleton import Joint
from animtool.scene.file.read import load_scene
from animtool.scene.solves.ik import rest_take
from animtool.systems.particles.forces.table import FORCES, find_force
from animtool.systems.particles.velocity_field import VARIABLES

TEXT = "\n".join(page.read_text("utf-8") for page in PAGES)
BLOCKS = re.findall(r"^```yaml\n(.*?)^```", TEXT, re.M | re.S)
WHOLE = {kind: [b for b in BLOCKS if b.startswith(f"{kind}: ")] for kind in MODELS}
PARTS = [b for b in BLOCKS if not any(b in whole for whole in WHOLE.values())]


@pytest.mark.slow
def test_the_tables_are_those_of_the_schemas() -> None:
    assert filled(TEXT) == TEXT, "run tests/support/key_tables.py"


def test_every_model_has_one_table() -> None:
    wanted = [(kind, model) for kind in MODELS for model in models_of(kind)]
    assert sorted(marked(TEXT)) == sorted(wanted)


@pytest.mark.parametrize("kind", MODELS)
def test_every_key_is_described_and_its_example_is_right(kind: str) -> None:
    for key in (key for m in models_of(kind) for key in keys_of(kind, [m])):
        field, name = field_of(key.models[0], key.name), f"{key.models[0]}.{key.name}"
        assert (field.description or "").endswith("."), name
        assert field.examples, name
        facts = (Field(), *field.metadata)
        adapter: TypeAdapter[Any] = TypeAdapter(Annotated[(field.annotation, *facts)])
        for example in field.examples:
            adapter.validate_python(example)
            assert example != field.get_default() or field.is_required(), name


def test_examples_stand_between_braces_too() -> None:
    rows = re.findall(r"^\| `(\w+)` \|.*\| `(.*)` \|$", filled(TEXT), re.M)
    examples = [(key, text) for key, text in rows if text.startswith(f"{key}: ")]
    assert examples
    for key, text in examples:
        assert list(yaml.safe_load(f"{{{text}}}")) == [key]


def test_the_functions_are_those_of_expressions() -> None:
    table = TEXT.split("| function | |")[1].split("\n\n")[0]
    listed = re.findall(r"`(\w+)\(([^)]*)\)`", table)
    assert {name: len(args.split(",")) for name, args in listed} == {
        name: count for name, (_, count) in FUNCTIONS.items()
    }


def test_the_forces_are_those_that_there_are() -> None:
    table = TEXT.split("| force | options, and what they are usually | |")[1]
    rows = table.split("\n\n")[0].splitlines()[2:]
    assert sorted(row.split("`")[1] for row in rows) == sorted(FORCES)
    for row in rows:
        options = re.findall(r"`([^`]*)`", row.split("|")[2])
        listed = yaml.safe_load("\n".join(o if ": " in o else f"{o}:" for o in options))
        made = asdict(find_force(row.split("`")[1])())
        usual = {
            name: None if value == math.inf else value for name, value in made.items()
        }
        spelled = {k: tuple(v) if isinstance(v, list) else v for k, v in listed.items()}
        assert spelled == usual


def test_the_variables_of_fields_are_listed() -> None:
    row = next(row for row in TEXT.splitlines() if row.startswith("| `field` |"))
    named = row.partition("[expressions]")[2]
    found = {name for part in re.findall(r"`([^`]*)`", named) for name in part.split()}
    assert found == set(VARIABLES)


def test_the_parts_are_those_of_joints() -> None:
    table = TEXT.split("| `type` | moves by |")[1].split("\n\n")[0]
    for row in table.splitlines()[2:]:
        kind, _, driven, keyed = (cell.strip() for cell in row.split("|")[1:5])
        own = {p for p, types in KEYED_PARTS.items() if kind.strip("`") in types}
        others = {"local_translation", "local_rotation", "scale"}
        assert set(re.findall(r"`(\w+)`", keyed)) == own - others
        assert _spelled(driven) == {
            p for p, types in DRIVEN_PARTS.items() if kind.strip("`") in types
        }


def test_the_targets_are_those_of_clips() -> None:
    table = TEXT.split("| target | `v` |")[1].split("\n\n")[0]
    assert set(re.findall(r"`joint/NAME\.(\w+)`", table)) == set(KEYED_PARTS)


def test_the_kinds_of_attachments_are_listed() -> None:
    table = TEXT.split("| `kind` | must have |")[1].split("\n\n")[0]
    assert re.findall(r"^\| `(\w+)`", table, re.M) == list(AttachKind)


def _spelled(cell: str) -> set[str]:
    """Return the parts of a cell in which ``.y`` stands for another of its kind."""
    found: list[str] = []
    for part in re.findall(r"`([\w.]+)`", cell):
        stem = found[-1].partition(".")[0] if part.startswith(".") else ""
        found.append(stem + part)
    return set(found)


@pytest.fixture
def project(workplace: Path) -> Path:
    """Return a folder with the files that the examples name."""
    points = np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0, 2, 0]])
    surface = {"points": points, "faces": np.array([[0, 1, 2, 3], [3, 2, 4, -1]])}
    names = ("blink", "blink_half", "smile_blink")
    np.savez(
        workplace / "body.npz",
        **surface,
        indices=np.array([[0, 1], [0, 2], [1, 2], [1, 0], [2, 0]]),
        weights=np.array([[0.5, 0.5], [1, 0], [1, 0], [0.2, 0.8], [1, 0]]),
        smile=points[:2],
        smile_vertices=np.array([1, 3]),
        **dict.fromkeys(names, points),
    )
    np.savez(workplace / "cape.npz", **surface, pins=np.array([0, 1]))
    strand = np.array([[[0.0, 0, 0], [0, 1, 0], [0, 2, 0]]])
    np.savez(workplace / "hair.npz", points=strand)
    walk = (workplace / "samples/walk/walk.bvh").read_bytes()
    for name in ("walk.bvh", "hands.bvh"):
        (workplace / name).write_bytes(walk)
    (workplace / "hero.rig.yaml").write_text(WHOLE["rig"][0], "utf-8")
    return workplace


@pytest.mark.parametrize("text", WHOLE["rig"])
def test_rigs_load(project: Path, text: str) -> None:
    (project / "one.rig.yaml").write_text(text, "utf-8")
    rig = Rig.load(project / "one.rig.yaml")
    assert len(rig.joints) > 10
    assert not rig.notices


@pytest.mark.parametrize("count", range(1, len(PARTS) + 1))
def test_parts_of_rigs_load(project: Path, count: int) -> None:
    whole = yaml.safe_load(WHOLE["rig"][0])
    for text in PARTS[:count]:
        whole = with_part(whole, yaml.safe_load(text))
    path = project / "one.rig.yaml"
    path.write_text(yaml.safe_dump(whole, sort_keys=False), "utf-8")
    notices = Rig.load(path).notices
    odd = sum("lamp_l" in text for text in PARTS[:count])
    assert [note.code for note in notices] == ["RIG101"] * odd


@pytest.mark.parametrize("text", WHOLE["clip"])
def test_clips_load(project: Path, text: str) -> None:
    (project / "one.clip.yaml").write_text(text, "utf-8")
    clip = Clip.load(project / "one.clip.yaml")
    take = clip.sample(Rig.load(project / "hero.rig.yaml"))
    assert take.clock.count == 24


@pytest.mark.parametrize("text", WHOLE["targets"])
def test_targets_load(project: Path, text: str) -> None:
    (project / "one.targets.yaml").write_text(text, "utf-8")
    rig = Rig.load(project / "hero.rig.yaml")
    tracks = load_targets(project / "one.targets.yaml", rig)
    assert tracks.clock.count == 24
    still = rest_take(rig, tracks.clock)
    found = solve_take(still, tracks, static=True)
    assert len(found.statuses) == 24


@pytest.mark.parametrize("text", WHOLE["map"])
def test_maps_load(project: Path, text: str) -> None:
    (project / "one.map.yaml").write_text(text, "utf-8")
    source, _ = person(named("mixamo"))
    source = replace(source, joints=(*source.joints, Joint("mixamorig:HeadTop_End", 5)))
    target = Rig.load(project / "hero.rig.yaml")
    found = map_joints(source, target, map_file=project / "one.map.yaml")
    stated = [pair for pair in found.pairs if pair.evidence == "file"]
    assert [target.names[pair.target] for pair in stated] == [
        *("hips", "spine", "elbow_l"),
    ]


@pytest.mark.parametrize("text", WHOLE["markers"])
def test_marker_templates_load(project: Path, text: str) -> None:
    (project / "one.markers.yaml").write_text(text, "utf-8")
    template = load_template(project / "one.markers.yaml")
    joints = template.joints(Rig.load(project / "hero.rig.yaml"))
    assert len(joints) == len(template.markers) > 2


def test_the_roles_of_maps_are_listed() -> None:
    listed = TEXT.split("A `role` is one of")[1].split("\n\n")[0]
    named = set(re.findall(r"`([a-z_0-9]+)`", listed))
    bare = {base_role(role) for role in ROLES}
    bare -= {f"{digit}_{i}" for digit in DIGITS[2:] for i in range(4)}
    bare -= {"thumb_2", "index_1", "index_2"}
    assert named == bare | {"_l", "_r"} | set(DIGITS[2:])


@pytest.mark.slow
@pytest.mark.parametrize("text", some_quick(WHOLE["scene"], 2))
def test_scenes_load(project: Path, text: str) -> None:
    (project / "one.scene.yaml").write_text(text, "utf-8")
    scene = load_scene(project / "one.scene.yaml")
    if scene.systems:
        assert bake(scene, None).result.samples == 16
        return
    assert scene.open().collect().clock.count == 16


@pytest.mark.parametrize("text", WHOLE["batch"])
def test_batches_load(project: Path, text: str) -> None:
    (project / "one.batch.yaml").write_text(text, "utf-8")
    (project / "steps.scene.yaml").write_text(
        "scene: animtool/1\nsource: {file: ${input}}\n"
        "passes: [{trim: {first: ${first}, last: ${last}}}]\n",
        "utf-8",
    )
    found = find_batch(load_batch(project / "one.batch.yaml"))
    ends = [""]
    if found.items[0].variant_values:
        ends = [f"_{first}_{last}" for first in (1, 5) for last in (20, 30)]
    wanted = {f"{stem}{end}.usdc" for stem in ("walk", "stride") for end in ends}
    assert {item.output.name for item in found.items} == wanted


def test_the_names_of_inputs_are_listed() -> None:
    table = TEXT.split("| name | is |")[1].split("\n\n")[0]
    assert set(re.findall(r"^\| `(\w+)` \|", table, re.M)) == set(INPUT_NAMES)


def test_there_is_an_example_of_each_kind() -> None:
    assert all(WHOLE.values())
    assert len(PARTS) >= 8


def test_every_page_with_tables_is_one_of_them(root: Path) -> None:
    pages = (root / "animtool/docs").rglob("*.md")
    assert {p for p in pages if marked(p.read_text("utf-8"))} == set(PAGES)


def with_part(whole: dict[str, Any], part: dict[str, Any]) -> dict[str, Any]:
    """Return a file with more entries in its lists and mappings."""
    made = copy.deepcopy(whole)
    for key, value in part.items():
        if isinstance(value, list):
            made[key] = [*made.get(key, []), *value]
        else:
            made[key] = {**made.get(key, {}), **value}
    return made
