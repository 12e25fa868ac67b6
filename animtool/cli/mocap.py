"""``animtool mocap``: the group of capture commands."""

from __future__ import annotations

import click

from animtool.cli.groups import LazyGroup

COMMANDS = {
    "clean": (
        "animtool.cli.mocap_clean:clean",
        "Remove spikes and noise from a take.",
    ),
    "label": (
        "animtool.cli.mocap_label:label",
        "Give unlabelled points the names of markers.",
    ),
    "fill": (
        "animtool.cli.mocap_fill:fill",
        "Repair swaps and spikes of markers, fill gaps.",
    ),
}


@click.group(
    cls=LazyGroup,
    table=COMMANDS,
    epilog="""\b
Examples:
  animtool mocap clean take.bvh -o clean.usdc""",
)
def mocap() -> None:
    """Turn captures into motion, and clean it."""
