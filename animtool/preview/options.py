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
        help="What to show of a USD file.  [default: all]",
    )
    frame_range: FrameRange | None = option(
        None,
        "range",
        flag="frames",
        help="Frames to show, such as 1-240, 1-240x2 or 12.  [default: all]",
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
