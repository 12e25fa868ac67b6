"""The options of ``animtool bake``: what is read and how it is written."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from animtool.cli.options import (
    INPUT,
    LENGTH,
    RATE,
    Command,
    Parsed,
    reduce_at_option,
    rig_layer_options,
    set_option,
    source_options,
    source_options_record,
    source_prim_option,
    take_option,
)
from animtool.cli.shot_options import SHOT_OPTIONS
from animtool.documents.names import is_named

if TYPE_CHECKING:
    from animtool.scene.options import BakeOptions
    from animtool.scene.scene import Scene


def opened_sources(
    sources: Sequence[Path], variables: dict[str, str]
) -> list[Path | Scene]:
    """Return sources, those loaded that are scenes."""
    opened: list[Path | Scene] = []
    used: set[str] = set()
    for source in sources:
        if not is_named(source, "scene"):
            opened.append(source)
            continue
        from animtool.scene.file import load_scene

        scene = load_scene(source, variables)
        used |= scene.variables
        opened.append(scene)
    if variables:
        from animtool.documents.names import check_given

        check_given(variables, used)
    return opened


def until_pass(opened: list[Path | Scene], stop: str | None) -> list[Path | Scene]:
    """Return sources, the one scene among them without the passes behind one."""
    if stop is None:
        return opened
    scene = only_scene(opened)
    if scene is None:
        raise click.UsageError("--until is for a SOURCE that is one scene.")
    return [scene.until(stop)]


def only_scene(opened: Sequence[Path | Scene]) -> Scene | None:
    """Return the one source where it is a scene."""
    if len(opened) > 1 or isinstance(opened[0], Path):
        return None
    return opened[0]


def default_bake_output(source: Path | Scene) -> Path:
    """Return the file that a scene names, else the source's own name as usdc."""
    from animtool.scene.option_checks import default_output

    if isinstance(source, Path):
        return default_output(source)
    return source.output or default_output(source.path)


def _parsed(name: str) -> Parsed:
    def parse(text: str) -> Any:
        from animtool.scene import options

        return getattr(options, f"parse_{name}")(text)

    return Parsed(name, parse)


# As ``--help`` lists them.
_OPTIONS = (
    click.option(
        "--as",
        "form",
        type=click.Choice(["stage", "layer"]),
        help="One file with skeleton and animation, or only the animation, over a rig "
        "layer.  [default: layer where there is --rig-layer, else stage]",
    ),
    click.option(
        "--split",
        is_flag=True,
        help="A stage in three files: X.rig.usda, X.anim.usdc, X.",
    ),
    rig_layer_options,
    click.option(
        "--bones", is_flag=True, help="Add light geometry that shows the joints."
    ),
    click.option(
        "--strip-namespace",
        type=click.IntRange(0),
        default=0,
        metavar="N",
        show_default=True,
        help="Drop the first N 'ns:' parts of joint names.",
    ),
    click.option(
        "--rest",
        "rest_frame",
        type=_parsed("rest"),
        metavar="offsets|frame:N",
        help="Where the rest pose comes from.  [default: offsets]",
    ),
    click.option(
        "--rig",
        type=INPUT,
        metavar="FILE",
        help="Rig of a clip, in place of the one that it names.",
    ),
    click.option(
        "--clamp",
        is_flag=True,
        help="Bring a clip's controls into their ranges and joints into their limits.",
    ),
    set_option,
    source_options,
    source_prim_option,
    take_option,
    click.option(
        "--to-units",
        type=click.Choice(["m", "cm", "mm", "in"]),
        help="Unit of the output.",
    ),
    click.option(
        "--to-up",
        type=click.Choice(["Y", "Z"], case_sensitive=False),
        help="Up axis of the output.",
    ),
    click.option(
        "--fps", type=RATE, metavar="RATE", help="Frames a second of the output."
    ),
    click.option(
        "--range",
        "frame_range",
        type=_parsed("frame_range"),
        metavar="A-B[xN]",
        help="Frames to write, such as 1-240, 1-240x2 or 12, as the output numbers "
        "them.",
    ),
    click.option(
        "--start",
        type=_parsed("frame"),
        metavar="FRAME",
        help="Time code of the first frame.  [default: the rig layer's, the "
        "project's, 1; of a shot the timeline's, the project's, 1001]",
    ),
    *SHOT_OPTIONS,
    click.option(
        "--samples",
        type=_parsed("offsets"),
        metavar="OFFSETS",
        default=(),
        help="Samples around each frame, such as -.25,0,.25.",
    ),
    click.option("--keep-samples", is_flag=True, help="Keep the source's own samples."),
    click.option(
        "--root-motion",
        type=click.Choice(["joint", "skelroot"]),
        default="joint",
        show_default=True,
        help="What carries the root's motion.",
    ),
    click.option(
        "--sparse", is_flag=True, help="Write only the joints that leave their rest."
    ),
    click.option(
        "--keep-curves",
        is_flag=True,
        help="Write the curves of a clip's controls too, as splines that stay "
        "editable.",
    ),
    click.option(
        "--reduce",
        type=LENGTH,
        metavar="LENGTH",
        help="Leave out samples that the others give back within so much, such as "
        "0.5mm.",
    ),
    reduce_at_option,
    click.option(
        "--deform",
        is_flag=True,
        help="Write the meshes and strands of the rig deformed, as point caches, in "
        "place "
        "of a skinned character: points, extent, and normals of meshes that have them.",
    ),
    click.option(
        "--velocities",
        is_flag=True,
        help="With --deform, how fast points move too, per second, for motion blur.",
    ),
    click.option(
        "--normals/--no-normals",
        default=None,
        help="With --deform, whether meshes keep normals, which are half of the file.  "
        "[default: normals]",
    ),
    click.option(
        "--chunk",
        type=click.IntRange(1),
        metavar="N",
        help="Of --deform and of a scene's systems, for long takes, a file for every N "
        "samples, joined as value clips; memory holds two or three of them.",
    ),
)


def bake_options(command: Command) -> Command:
    """Add them."""
    for option in reversed(_OPTIONS):
        command = option(command)
    return command


def bake_options_record(given: Mapping[str, Any]) -> BakeOptions:
    """Return the record of `bake_options`, and of what is strict and overwritten."""
    from animtool.options import options_of
    from animtool.scene.options import BakeOptions
    from animtool.units import LengthUnit, UpAxis

    units, up = given["to_units"], given["to_up"]
    source = source_options_record(
        given,
        given["source_prim"],
        given["rig"],
        clamp=given["clamp"],
        take=given["take"],
    )
    # --take names one of the source, not the one that is written.
    names = options_of(BakeOptions).keys() & given.keys() - {"take"}
    return BakeOptions(
        source=source,
        shot=given["shot"],
        **{name: given[name] for name in names}
        | {
            "form": "split" if given["split"] else given["form"],
            "to_units": None if units is None else LengthUnit(units),
            "to_up": None if up is None else UpAxis(up.upper()),
            "root_motion": given["root_motion"] == "skelroot",
        },
    )
