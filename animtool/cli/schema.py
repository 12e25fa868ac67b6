"""``animtool schema`` and ``completion``: text for editors and shells."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import click
from click.shell_completion import get_completion_class

from animtool.cli.console import Console
from animtool.cli.help import command
from animtool.cli.options import common_options
from animtool.core.plugins import load_object
from animtool.documents.versions import FILE_MODELS

if TYPE_CHECKING:
    from pydantic import BaseModel


@command(
    epilog="""\b
Examples:
  animtool completion bash >> ~/.bashrc
  animtool completion fish > ~/.config/fish/completions/animtool.fish"""
)
@click.argument("shell", metavar="SHELL", type=click.Choice(["bash", "zsh", "fish"]))
@common_options
@click.pass_obj
def completion(console: Console, shell: str) -> None:
    """Print the script that completes animtool's commands and options in SHELL."""
    root = click.get_current_context().find_root().command
    completion_class = get_completion_class(shell)
    assert completion_class is not None
    completer = completion_class(root, {}, "animtool", "_ANIMTOOL_COMPLETE")
    console.document(completer.source())


MODELS = FILE_MODELS
# Models of JSON reports, or functions that return one.
REPORT_MODELS = {"report": "animtool.report.tradeoffs_schema:TradeoffsModel"}


def model_of(kind: str) -> type[BaseModel]:
    """Return the schema class that validates a kind of file."""
    model: Any = load_object({**MODELS, **REPORT_MODELS}[kind])
    return model if isinstance(model, type) else model()


@command(
    epilog="""\b
Examples:
  animtool schema rig > rig.schema.json
  animtool schema clip"""
)
@click.argument(
    "kind", metavar="KIND", type=click.Choice(sorted({*MODELS, *REPORT_MODELS}))
)
@common_options
@click.pass_obj
def schema(console: Console, /, kind: str) -> None:
    """Print the JSON Schema of a KIND of file, for editors, or of a JSON report.

    Editors use it to complete keys and mark errors while you type. In VS Code, with
    the YAML extension, add it under "yaml.schemas".
    """
    json_schema = model_of(kind).model_json_schema(by_alias=True)
    if kind == "scene":
        from animtool.documents.variables import with_variables

        json_schema = with_variables(json_schema)
    dialect = "https://json-schema.org/draft/2020-12/schema"
    console.result_json({"$schema": dialect, **json_schema})
