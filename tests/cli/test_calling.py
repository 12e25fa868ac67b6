"""What commands call arguments."""

from __future__ import annotations

from pathlib import Path

import pytest
from support.cli import animtool

from animtool.cli.bake import bake
from animtool.cli.console import FlagNamer
from animtool.cli.convert import convert
from animtool.cli.info import info
from animtool.core.arguments import Argument


@pytest.mark.parametrize(
    ("name", "value", "flag"),
    [
        ("fps", None, "--fps"),
        ("source.fps", "24", "--source-fps 24"),
        ("source.unit", None, "--units"),
        ("source.prim_path", None, "--source-prim"),
        ("prim_path", None, "--prim-path"),
        ("form", "layer", "--as layer"),
        ("form", "split", "--split"),
        ("root_motion", "true", "--root-motion skelroot"),
        ("keep_samples", "true", "--keep-samples"),
        ("normals", "false", "--no-normals"),
        ("set", "a=…", "--set a=…"),
        ("output", None, "-o"),
        ("landmarks", None, None),
    ],
)
def test_bake_calls_arguments_by_its_flags(
    name: str, value: str | None, flag: str | None
) -> None:
    assert FlagNamer(bake)(Argument(name, value)) == flag


def test_commands_call_one_argument_by_their_own_flags() -> None:
    assert FlagNamer(info)(Argument("source.prim_path")) == "--source-prim"
    assert FlagNamer(convert)(Argument("to_units")) is None
    assert FlagNamer(convert).name_elsewhere(Argument("to_units")) == "bake --to-units"
    assert FlagNamer(convert).name_elsewhere(Argument("landmarks")) == "landmarks:"


def test_what_exists_is_refused_with_the_flags_of_the_command(
    walk: Path, tmp_path: Path
) -> None:
    output = tmp_path / "walk.usda"
    output.touch()
    refused = animtool("bake", walk, "-o", output)
    assert refused.code == 2
    assert "--overwrite replaces it, --skip-existing leaves it" in refused.stderr
