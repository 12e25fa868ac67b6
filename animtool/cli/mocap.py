"""``animtool mocap``: the group of capture commands."""

from __future__ import annotations

import click

from animtool.cli.groups import LazyGroup

COMMANDS = {
    "clean": (
        "animtool.cli.mocap_clean:clean",
        "Remove spikes and noise from a take.",
    ),
    "face": (
        "animtool.cli.mocap_face:face",
        "Turn landmarks of a face into blend-shape weights.",
    ),
    "triangulate": (
        "animtool.cli.mocap_triangulate:triangulate",
        "Find markers in space from what cameras see.",
    ),
}


@click.group(
    cls=LazyGroup,
    table=COMMANDS,
    epilog="""\b
Examples:
  animtool mocap clean take.bvh -o clean.usdc
  animtool mocap face take.npz --rig hero.rig.yaml -o face.usdc
  animtool mocap triangulate take.npz --cameras stage.cameras.yaml -o markers.npz""",
)
def mocap() -> None:
    """Turn captures into motion, and clean it."""
