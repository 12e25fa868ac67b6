"""``animtool mocap``: the group of capture commands."""

from __future__ import annotations

import click

from animtool.cli.help import LazyGroup

COMMANDS = {
    "clean": ("animtool.cli.mocap_clean:clean", "Remove spikes and noise from a take."),
    "solve": (
        "animtool.cli.mocap_solve:solve",
        "Solve the motion of a rig from markers.",
    ),
    "triangulate": (
        "animtool.cli.mocap_triangulate:triangulate",
        "Triangulate markers from camera images.",
    ),
    "face": (
        "animtool.cli.mocap_face:face",
        "Solve blend-shape weights from face landmarks.",
    ),
    "label": ("animtool.cli.mocap_label:label", "Label unlabelled marker points."),
    "fill": (
        "animtool.cli.mocap_fill:fill",
        "Repair swaps and spikes of markers, and fill gaps.",
    ),
}


@click.group(
    cls=LazyGroup,
    sections={"Commands": dict(sorted(COMMANDS.items()))},
    file_command="clean",
    epilog="""\b
Examples:
  animtool mocap clean take.bvh -o clean.usdc
  animtool mocap triangulate take.npz --cameras stage.cameras.yaml -o markers.npz
  animtool mocap face take.npz --rig hero.rig.yaml -o face.usdc
  animtool mocap solve take.c3d --template ann.markers.yaml -o take.usdc""",
)
def mocap() -> None:
    """Turn captures into motion, and clean it."""
