"""``animtool schema``."""

from __future__ import annotations

import importlib

import click

from animtool.cli.console import Console
from animtool.cli.options import common_options

MODELS = {
    "batch": "animtool.batch.schema:BatchModel",
    "clip": "animtool.clip.schema:ClipModel",
    "rig": "animtool.rig.schema:RigModel",
    "scene": "animtool.scene.schema:SceneModel",
    "targets": "animtool.ik.schema:TargetsModel",
}


@click.command(
    epilog="""\b
Examples:
  animtool schema rig > rig.schema.json
  animtool schema clip"""
)
@click.argument("kind", type=click.Choice(sorted(MODELS)))
@common_options
@click.pass_obj
def schema(console: Console, /, kind: str) -> None:
    """Print the JSON Schema of a KIND of file, for editors.

    An editor that knows it completes keys and marks faults while one writes. In VS
    Code, with the YAML extension, it goes under "yaml.schemas".
    """
    module, _, name = MODELS[kind].partition(":")
    model = getattr(importlib.import_module(module), name)
    described = model.model_json_schema(by_alias=True)
    if kind == "scene":
        from animtool.documents.variables import with_variables

        described = with_variables(described)
    head = {"$schema": "https://json-schema.org/draft/2020-12/schema"}
    console.result_json({**head, **described})
