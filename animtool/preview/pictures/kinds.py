"""Picture and film formats by file suffix."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

from animtool.core.arguments import argument
from animtool.core.errors import Fault, OptionError
from animtool.core.plugins import suffix_text
from animtool.core.record import dataclass

PAGE_SUFFIXES = (".html", ".htm")


@dataclass(frozen=True, slots=True)
class PictureKind:
    """A picture or film format.

    Attributes:
        description: Description of the format, with the licence of its encoder.
        is_image: Whether it can be a still, encoded by Pillow.
        codec: libav's name of the video codec; empty if it cannot be a film.
        container: libav's name of the container format.
        pixels: libav's name of the pixel format.
        max_rate: Highest frame rate that players support.
        size: Default size of films [px].
        settings: Options of the codec.
        file_settings: Options of the container.
    """

    description: str
    is_image: bool = False
    codec: str = ""
    container: str = ""
    pixels: str = "yuv420p"
    max_rate: int = 60
    size: tuple[int, int] = (960, 540)
    settings: tuple[tuple[str, str], ...] = ()
    file_settings: tuple[tuple[str, str], ...] = ()


_SMALL_FILM_SIZE = (640, 360)
_MP4 = PictureKind(
    "VP9 by libvpx (BSD) in MP4",
    codec="libvpx-vp9",
    container="mp4",
    settings=(
        *(("crf", "24"), ("b", "0"), ("deadline", "good"), ("cpu-used", "4")),
        ("row-mt", "1"),
    ),
    file_settings=(("fflags", "+bitexact"),),
)
PICTURE_KINDS: dict[str, PictureKind] = {
    ".png": PictureKind("PNG, lossless", is_image=True),
    ".gif": PictureKind(
        "GIF of 256 colours, LZW, free of patents",
        codec="gif",
        container="gif",
        pixels="pal8",
        max_rate=33,
        size=_SMALL_FILM_SIZE,
        file_settings=(("loop", "0"),),
    ),
    ".webp": PictureKind(
        "WebP by libwebp (BSD)",
        is_image=True,
        codec="libwebp_anim",
        container="webp",
        size=_SMALL_FILM_SIZE,
        settings=(("quality", "80"),),
        file_settings=(("loop", "0"),),
    ),
    ".mp4": _MP4,
    ".webm": replace(_MP4, description="VP9 by libvpx (BSD) in WebM", container="webm"),
}


# Numbers of frames in file names, as other tools write them.
_FRAME_PATTERN = re.compile(r"%\d*d|#{2,}|\$F\d?")


def picture_kind(path: Path) -> PictureKind | None:
    """Return the picture format of a path; None for a page.

    >>> picture_kind(Path("walk.WEBM")).codec
    'libvpx-vp9'
    """
    suffix = path.suffix.lower()
    if suffix in PAGE_SUFFIXES:
        return None
    if suffix not in PICTURE_KINDS:
        message = f"{suffix_text(path)} is neither a page nor a picture"
        hint = f"allowed: .html, {', '.join(PICTURE_KINDS)}"
        raise OptionError(Fault("PRV002", message, str(path), (), hint))
    if match := _FRAME_PATTERN.search(path.name):
        message = f"{match[0]!r} stands for no number: one picture shows all its frames"
        hint = (
            "write a film, such as walk.mp4, or name one frame with "
            f"{argument('frame_range', '12')}"
        )
        raise OptionError(Fault("PRV002", message, str(path), (), hint))
    return PICTURE_KINDS[suffix]
