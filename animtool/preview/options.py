"""Options of pages, of pictures, and of where to show them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import field

from animtool.core.arguments import argument
from animtool.core.options import inherits_docs, option
from animtool.core.record import dataclass
from animtool.core.shot import FrameRange
from animtool.scene.sources.open import SourceOptions


@inherits_docs
@dataclass(frozen=True, slots=True)
class PreviewOptions:
    """What a page shows, and how files are read.

    Attributes:
        source: How to read sources whose files do not state units or axes.
        variables: Values of ``${name}`` in scenes.
    """

    source: SourceOptions = field(default_factory=SourceOptions)
    prim_path: str | None = option(
        None,
        "text",
        flag="source-prim",
        metavar="PATH",
        help="What to show of a USD file, or the character of a glTF or FBX with "
        "several.  [default: all of a USD file, the first character of others]",
    )
    over: tuple[str, ...] = option(
        (),
        "texts",
        metavar="LAYER",
        help="A USD layer over a USD file, or over the output of a scene, such as a "
        "look or props; the first is the strongest.",
    )
    frame_range: FrameRange | None = option(
        None,
        "frames",
        flag="range",
        help="Frames to show, such as 1-240, 1-240x2 or 12; for a picture also "
        "1,20,40.  [default: all]",
    )
    findings: bool = option(
        True,
        "answer",
        help="Whether the page lists findings of validate.  [default: "
        f"{argument('findings')}]",
    )
    variables: Mapping[str, str] = field(default_factory=dict)


@inherits_docs
@dataclass(frozen=True, slots=True)
class PictureOptions:
    """Appearance of pictures and films."""

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
        help="Columns and rows of frames, such as 4x3, spread over the motion or "
        "listed.",
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
        help="Direction of the key light, relative to the camera [degrees]; positive "
        "is right and up.  [default: -27,40]",
    )
    caption: tuple[str, ...] = option(
        (),
        "texts",
        metavar="TEXT",
        help="Text at the top; one, or one for each picture of a sheet.",
    )
    numbers: bool | None = option(
        None,
        "answer",
        help="Show the frame number.  [default: where several frames are shown]",
    )
    show: tuple[str, ...] = option(
        (),
        "names",
        help="What to draw: bones, axes, meshes, trails, contacts, cameras, grid, "
        "shadows.  [default: all but axes]",
    )
    turntable: bool = option(
        False, "switch", help="Turn the camera around once, in 4 s if nothing moves."
    )


@inherits_docs
@dataclass(frozen=True, slots=True)
class ShowOptions:
    """Where to show or write a page, and whether to rebuild it."""

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
        help="Serve the page on this machine only, and reload it when a file changes.",
    )
    plan: bool = option(
        False,
        "switch",
        help="Write nothing; print what the page would show and its path.",
    )
