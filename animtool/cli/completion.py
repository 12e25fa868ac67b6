"""``animtool completion``."""

from __future__ import annotations

import click
from click.shell_completion import get_completion_class

from animtool.cli.console import Console
from animtool.cli.options import common_options


@click.command(
    epilog="""\b
Examples:
  animtool completion bash >> ~/.bashrc
  animtool completion fish > ~/.config/fish/completions/animtool.fish"""
)
@click.argument("shell", type=click.Choice(["bash", "zsh", "fish"]))
@common_options
@click.pass_obj
def completion(console: Console, shell: str) -> None:
    """Print the script that completes animtool's commands and options in SHELL."""
    root = click.get_current_context().find_root().command
    kind = get_completion_class(shell)
    assert kind is not None
    console.document(kind(root, {}, "animtool", "_ANIMTOOL_COMPLETE").source())
