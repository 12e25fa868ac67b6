"""Texts that name arguments, told by every interface."""

from __future__ import annotations

import pickle
from dataclasses import replace

import pytest

from animtool.core.arguments import (
    FILE_KEYS,
    Argument,
    TextWithArguments,
    argument,
    as_text,
    clause,
    file_key,
    name_arguments,
    python_name,
)
from animtool.core.errors import Fault, FormatError
from animtool.core.options import keys_of
from animtool.scene.bake.options import BakeOptions
from animtool.scene.sources.open import SourceOptions


@pytest.mark.parametrize(
    ("name", "value", "python", "file"),
    [
        ("source.fps", None, "fps", "fps:"),
        ("fps", "24", "fps=24", "fps: 24"),
        ("form", "layer", 'form="layer"', "as: layer"),
        ("keep_samples", True, "keep_samples=True", "keep_samples: true"),
        ("normals", False, "normals=False", "normals: false"),
    ],
)
def test_an_argument_is_called_as_the_interface_calls_it(
    name: str, value: object, python: str, file: str
) -> None:
    text = as_text(f"{argument(name, value)} says it")
    assert text == f"{python} says it"
    assert name_arguments(text, file_key) == f"{file} says it"


def test_keys_are_those_that_scenes_have() -> None:
    for prefix, record in (("", BakeOptions), ("source.", SourceOptions)):
        for name, key in keys_of(record, "scene").items():
            alias = FILE_KEYS.get(f"{prefix}{name}", name)
            assert key.alias in {None, alias}, name


def test_text_that_looks_like_a_flag_stays() -> None:
    fault = Fault("BVH001", "cannot be read", "a--fps.bvh", hint=argument("fps"))
    assert str(FormatError(fault)) == "a--fps.bvh: BVH001 cannot be read; fps"


def test_a_clause_goes_where_its_argument_is_none() -> None:
    text = "a" + clause(f", not {argument('command.quiet')}")
    assert as_text(text) == "a"
    assert name_arguments(text, lambda found: f"-{found.field}") == "a, not -quiet"
    assert name_arguments(text, lambda _: None) == "a"


def test_an_argument_that_an_interface_lacks_is_a_key() -> None:
    assert name_arguments(argument("source.up", "Z"), lambda _: None) == "up: Z"


def test_a_fault_keeps_what_it_names() -> None:
    fault = Fault("MKR010", "no rate", hint=f"{argument('source.fps')} gives it")
    for kept in (fault, pickle.loads(pickle.dumps(fault)), replace(fault, path="a")):
        assert kept.hint == "fps gives it"
        assert kept.with_argument_names(lambda found: f"--{found.name}").hint == (
            "--source.fps gives it"
        )


def test_joined_texts_keep_what_they_name() -> None:
    text = as_text(argument("up"))
    assert isinstance("a " + text + " b", TextWithArguments)
    assert name_arguments("a " + text + " b", file_key) == "a up: b"


def test_values_of_texts_may_hold_braces() -> None:
    assert as_text(argument("set", "a={b}")) == 'set="a={b}"'
    assert python_name(Argument("command.quiet")) is None
