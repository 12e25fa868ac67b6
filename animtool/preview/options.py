"""Options of pages."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import field

from animtool.core.arguments import argument
from animtool.core.options import described, option
from animtool.core.record import dataclass
from animtool.core.shot import FrameRange
from animtool.scene.sources.open import SourceOptions


@described
@dataclass(frozen=True, slots=True)
class PreviewOptions:
    """What a page shows, and how its files are read.

    Attributes:
        source: What the sources are, where their files do not say.
        variables: What ``${name}`` stands for in scenes.
    """

    source: SourceOptions = field(default_factory=SourceOptions)
    prim_path: str | None = option(
        None,
        "text",
        metavar="PATH",
        help="What to show of a USD file, or the character of a glTF or FBX with "
        "several.  [default: all of a USD file, the first character of others]",
    )
    over: tuple[str, ...] = option(
        (),
        "texts",
        metavar="LAYER",
        help="A USD layer laid over a USD file, or over what a scene bakes, such as a "
        "look or props; of several the first is the strongest.",
    )
    frame_range: FrameRange | None = option(
        None,
        "frames",
        flag="frames",
        help="Frames to show, such as 1-240, 1-240x2 or 12; of a picture 1,20,40 too.  "
        "[default: all]",
    )
    findings: bool = option(
        True,
        "answer",
        help="Whether findings of validate are on the page.  [default: "
        f"{argument('findings')}]",
    )
    variables: Mapping[str, str] = field(default_factory=dict)


@described
@dataclass(frozen=True, slots=True)
class PictureOptions:
    """How pictures and films look."""

    size: str | None = option(
        None,
        "text",
        metavar="WxH",
        help="Size of a film, or of each picture of a sheet [px].  [default: 960x540, "
        "or 480x360 on a sheet, or 640x360 of .gif and .webp]",
    )
    sheet: str | None = option(
        None,
        "text",
        metavar="CxR",
        help="Frames side by side, such as 4x3, spread over the motion or listed.",
    )
    camera: tuple[str, ...] = option(
        (),
        "texts",
        metavar="CAMERA",
        help="home, front, side, back, top, YAW,PITCH in degrees, a camera of the "
        "file, or the `cam` of a page's address; several are rows of a sheet.  "
        "[default: home]",
    )
    light: str | None = option(
        None,
        "text",
        metavar="YAW,PITCH",
        help="From where the key light comes, seen from the camera [degrees]; positive "
        "is right, and up.  [default: -27,40]",
    )
    caption: tuple[str, ...] = option(
        (),
        "texts",
        metavar="TEXT",
        help="Text at the top; as many as a sheet has pictures, one for each.",
    )
    numbers: bool | None = option(
        None,
        "answer",
        help="Write the frame's number.  [default: where several frames are shown]",
    )
    show: tuple[str, ...] = option(
        (),
        "names",
        help="What is drawn, of bones, axes, meshes, trails, contacts, cameras, grid "
        "and shadows.  [default: all but axes]",
    )
    turntable: bool = option(
        False,
        "switch",
        help="Let the camera go round once, in 4 s where nothing moves.",
    )


@described
@dataclass(frozen=True, slots=True)
class ShowOptions:
    """What becomes of a page."""

    opened: bool | None = option(
        None,
        "answer",
        flag="open",
        help="Open the page in the browser, or print its path.  [default: open it, "
        "but not over ssh, without a display, or with -o]",
    )
    watch: bool = option(
        False,
        "switch",
        help="Serve the page on this machine alone, and reload it when a file changes.",
    )
    plan: bool = option(
        False,
        "switch",
        help="Write nothing; print what the page would show, and where it would be.",
    )
