"""Options that are declared on the fields of a record."""

from __future__ import annotations

import inspect
import pickle
import re
from dataclasses import dataclass, fields
from fractions import Fraction
from importlib import import_module
from operator import attrgetter
from pathlib import Path
from typing import Any, get_type_hints

import click
import pytest
from click.testing import CliRunner
from support.faults import raises

import animtool
from animtool.batch.run import RunOptions
from animtool.cli.bake import bake
from animtool.cli.options import declare_option, read_values, record_options
from animtool.core.arguments import as_text
from animtool.core.errors import OptionError, Severity
from animtool.core.options import (
    Key,
    clash_messages,
    keys_of,
    option,
    options_of,
    refused_options,
    with_text_values,
)
from animtool.core.units import LengthUnit, UpAxis
from animtool.ik.options import TakeOptions
from animtool.scene.bake.options import BakeOptions
from animtool.scene.sources.open import SourceOptions
from animtool.systems.particles import Emitter
from animtool.validation.options import ValidateOptions


@dataclass(frozen=True)
class Cut:
    """Cut."""

    sharp: bool = option(False, "switch", not_for=("soup",), common_key=Key("", 1))
    width: float | None = option(None, "length", not_for=("soup", "bread"))
    plain: int = 0


@with_text_values(TakeOptions, "joints")
@dataclass(frozen=True)
class Reach:
    """Reach."""

    far: bool = False


@pytest.mark.parametrize(
    ("given", "use", "names"),
    [
        (Cut(), "soup", []),
        (Cut(sharp=True, width=1.0), "soup", ["sharp=True", "width"]),
        (Cut(sharp=True, width=0.0), "bread", ["width"]),
        (Cut(sharp=True), "cheese", []),
    ],
)
def test_a_use_refuses_what_is_not_the_default(
    given: Cut, use: str, names: list[str]
) -> None:
    assert [as_text(name) for name in refused_options(given, use)] == names


@dataclass(frozen=True)
class Bread:
    """Bread."""

    whole: bool = option(False, "switch", excludes={"width": ""})
    width: float | None = option(None, "length", required_option="sliced")
    sliced: bool = option(False, "switch", excludes={"whole": "sliced: no whole"})
    crust: bool | None = option(None, "answer", required_option="sliced")


@pytest.mark.parametrize(
    ("bread", "messages"),
    [
        (Bread(), []),
        (Bread(width=1.0, sliced=True, crust=False), []),
        (Bread(crust=True), []),
        (Bread(crust=False), ["crust=False needs sliced=True"]),
        (Bread(whole=True, sliced=True), ["sliced: no whole"]),
        (
            Bread(whole=True, width=1.0),
            [
                "whole=True and width exclude each other: use one of them",
                "width needs sliced=True",
            ],
        ),
    ],
)
def test_what_options_exclude_and_want(bread: Bread, messages: list[str]) -> None:
    assert [as_text(message) for message in clash_messages(bread)] == messages


def test_what_options_exclude_and_want_is_an_option() -> None:
    for described in options_of(BakeOptions).values():
        assert {*described.excludes, described.required_option or "fps"} <= {
            *options_of(BakeOptions)
        }


def test_errors_in_python_name_arguments(walk: Path, tmp_path: Path) -> None:
    output = tmp_path / "walk.usda"
    output.touch()
    with raises(OptionError, "OUT001") as caught:
        animtool.bake(walk, output)
    assert caught.value.faults[0].hint == "overwrite=True replaces it"
    fps = SourceOptions(fps=24)
    with raises(OptionError, "CLI004", match="to_units.*to_up"):
        animtool.open_source(output, fps)


def test_files_have_the_keys_that_options_declare() -> None:
    assert [*options_of(Cut)] == ["sharp", "width"]
    assert [*keys_of(Cut, "scene")] == [*keys_of(Cut, "batch")] == ["sharp"]


def test_every_option_of_a_bake_is_documented() -> None:
    documented = re.findall(r"^        (\w+): ", BakeOptions.__doc__ or "", re.M)
    assert [*options_of(BakeOptions)] == [
        name for name in documented if name not in {"source", "shot", "OptionError"}
    ]


def test_the_command_has_every_option_that_is_declared() -> None:
    parameters = {parameter.name: parameter for parameter in bake.params}
    for name, described in options_of(BakeOptions).items():
        # Of a take that is written, scenes alone say the name.
        if name != "take":
            flag = f"--{described.flag or name.replace('_', '-')}"
            found = parameters[name]
            assert flag in {*found.opts, *found.secondary_opts}, name
            assert described.help or name in {"strict", "overwrite"}, name


def test_an_option_is_added_to_a_command_by_its_declaration() -> None:
    cuts = options_of(Cut)
    command = click.command()(lambda **given: click.echo(sorted(given.items())))
    for name in ("sharp", "width"):
        command = declare_option(cuts[name], name)(command)
    done = CliRunner().invoke(command, ["--sharp", "--width", "2mm"])
    assert done.output == "[('sharp', True), ('width', 0.002)]\n"


@pytest.mark.parametrize(
    ("words", "options"),
    [
        ([], ValidateOptions(jobs=None)),
        (
            ["--select", "RIG2,USD", "--select", "CLIP2", "-j", "2"],
            ValidateOptions(select=("RIG2", "USD", "CLIP2"), jobs=2),
        ),
        (
            ["--severity", "RIG2=note", "--profile", "shot", "--jobs", "1"],
            ValidateOptions(severity={"RIG2": Severity.NOTE}, profile="shot"),
        ),
    ],
)
def test_codes_and_severities_of_a_command_are_those_of_its_record(
    words: list[str], options: ValidateOptions
) -> None:
    taken: list[ValidateOptions] = []

    @record_options(ValidateOptions)
    def run(**given: object) -> None:
        taken.append(ValidateOptions(**read_values(ValidateOptions, given)))

    done = CliRunner().invoke(click.command()(run), words)
    assert (done.output, taken) == ("", [options])


def test_a_record_has_the_options_of_another_as_files_write_them() -> None:
    defaults = {entry.name: entry.default for entry in fields(Reach)}
    others = [name for name in options_of(TakeOptions) if name != "joints"]
    assert [*defaults] == ["far", "joints", *others]
    assert (defaults["tolerance"], defaults["angle_tolerance"]) == ("0.001mm", 1e-4)
    assert defaults["restarts"] == TakeOptions().restarts
    assert get_type_hints(Reach)["tolerance"] is str
    assert pickle.loads(pickle.dumps(Reach(far=True))) == Reach(far=True)


RECORDS = ["sim.colliders.Collider", "sim.colliders.Sheet"]
RECORDS += [f"systems.particles.{name}" for name in ("Emitter", "VelocityField")]
RECORDS += [
    f"systems.springs.{name}"
    for name in ("Air", "Family", "SelfContact", "SpringOptions")
]


@pytest.mark.parametrize("place", RECORDS)
def test_docstrings_tell_of_every_field_once(place: str) -> None:
    """Those with a key in files have their text there, and inherited ones theirs."""
    package, _, name = place.rpartition(".")
    record = getattr(import_module(f"animtool.{package}"), name)
    told = re.findall(r"^ {4}(\w+): \S", inspect.getdoc(record), re.M)
    assert sorted(told) == sorted(field.name for field in fields(record))


def test_a_docstring_has_units_of_python_where_a_file_has_others() -> None:
    told = inspect.getdoc(Emitter)
    assert told is not None
    assert "spread: Half the angle of the cone, here in radians" in told
    assert "[deg]" not in told


@pytest.mark.parametrize(
    ("values", "name", "converted"),
    [
        ({"source": SourceOptions(unit="cm")}, "source.unit", LengthUnit.CM),
        ({"source": SourceOptions(up="z")}, "source.up", UpAxis.Z),
        ({"to_units": "mm"}, "to_units", LengthUnit.MM),
        ({"reduce": "1mm"}, "reduce", 0.001),
        ({"samples": [0, 0.5]}, "samples", (Fraction(0), Fraction(1, 2))),
        ({"form": "split"}, "form", "split"),
    ],
)
def test_options_in_python_may_be_text(
    values: dict[str, Any], name: str, converted: object
) -> None:
    found = attrgetter(name)(BakeOptions(**values))
    assert found == converted
    assert type(found) is type(converted)


@pytest.mark.parametrize(
    ("record", "values"),
    [
        (SourceOptions, {"unit": "centimeters"}),
        (SourceOptions, {"up": "W"}),
        (SourceOptions, {"positions": "offset"}),
        (BakeOptions, {"form": "layr"}),
        (BakeOptions, {"placement": "kep"}),
        (BakeOptions, {"reduce": "1"}),
        (BakeOptions, {"samples": "often"}),
        (ValidateOptions, {"jobs": "two"}),
        (RunOptions, {"jobs": 0}),
    ],
)
def test_unknown_words_of_options_in_python_are_refused(
    record: Any, values: dict[str, Any]
) -> None:
    with pytest.raises(OptionError) as error:
        record(**values)
    assert error.value.code == "SCN025"
    assert next(iter(values)) in error.value.faults[0].message


def test_a_single_code_is_a_list_of_one() -> None:
    assert ValidateOptions(select="BVH").select == ("BVH",)
