"""Text on pictures: captions at the top, frame numbers at the bottom."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from animtool.core.array_types import IntArray
from animtool.core.errors import Fault, OptionError
from animtool.core.record import dataclass
from animtool.preview.pictures.device import Array, import_package

# Text height relative to the picture's height, and its minimum [px].
TEXT_HEIGHT, MIN_TEXT_HEIGHT = 0.042, 10
# Margin beside text and line spacing, relative to the text height.
MARGIN, LINE_SPACING = 0.7, 1.3
# Largest fraction of a picture's height that a caption may cover.
MAX_CAPTION_FRACTION = 0.4
Color = tuple[int, int, int]


@dataclass(frozen=True, slots=True)
class Caption:
    """Text wrapped into lines.

    Attributes:
        lines: Lines of text.
        text_height: Text height [px].
    """

    lines: tuple[str, ...]
    text_height: int

    @property
    def height(self) -> int:
        """Height of the caption area [px]."""
        if not self.lines:
            return 0
        return round(self.text_height * (2 * MARGIN + LINE_SPACING * len(self.lines)))


def font_size(height: int) -> int:
    """Return the font size of a picture [px].

    >>> font_size(540), font_size(90)
    (23, 10)
    """
    return max(MIN_TEXT_HEIGHT, round(height * TEXT_HEIGHT))


def wrap_caption(text: str, width: int, height: int) -> Caption:
    """Return text wrapped for a picture, in a smaller font if it is long."""
    if not text.strip():
        return Caption((), MIN_TEXT_HEIGHT)
    for text_height in range(font_size(height), MIN_TEXT_HEIGHT - 1, -1):
        lines = tuple(
            _wrapped_lines(
                text, width - 2 * MARGIN * text_height, _load_font(text_height)
            )
        )
        caption = Caption(lines, text_height)
        if caption.height <= MAX_CAPTION_FRACTION * height:
            return caption
    message = f"the caption needs {len(lines)} lines on {width}x{height} pixels"
    hint = "shorten it, or enlarge the picture"
    raise OptionError(Fault("PRV006", message, hint=hint, where="caption"))


def _wrapped_lines(text: str, width: float, font: Any) -> Iterator[str]:
    """Yield lines that fit a width; words that are too long are split."""
    for paragraph in text.splitlines():
        line = ""
        for full_word in paragraph.split():
            word = full_word
            longer_line = f"{line} {word}".strip()
            if font.getlength(longer_line) <= width:
                line = longer_line
                continue
            if line:
                yield line
            while font.getlength(word) > width and len(word) > 1:
                lengths = (n for n in range(len(word), 1, -1))
                character_count = next(
                    (n for n in lengths if font.getlength(word[:n]) <= width), 1
                )
                yield word[:character_count]
                word = word[character_count:]
            line = word
        if line:
            yield line


def with_caption(
    pixels: Array, caption: Caption, frame_text: str, ink: Color, background: Color
) -> Array:
    """Return pixels with a caption at the top and a number at the bottom left."""
    if not (caption.lines or frame_text):
        return pixels
    image_module = import_package("PIL.Image")
    draw_module = import_package("PIL.ImageDraw")
    image = image_module.fromarray(np.ascontiguousarray(pixels))
    drawing = draw_module.Draw(image)
    text_height = caption.text_height
    for i, line in enumerate(caption.lines):
        position = (MARGIN * text_height, text_height * (MARGIN + LINE_SPACING * i))
        _draw_text(drawing, position, line, _load_font(text_height), ink, background)
    if frame_text:
        text_height = max(MIN_TEXT_HEIGHT, round(font_size(image.height) * 0.8))
        position = (
            MARGIN * text_height,
            image.height - text_height * (MARGIN + LINE_SPACING),
        )
        _draw_text(
            drawing, position, frame_text, _load_font(text_height), ink, background
        )
    return np.asarray(image)


def _draw_text(
    drawing: Any,
    position: tuple[float, float],
    text: str,
    font: Any,
    ink: Color,
    background: Color,
) -> None:
    """Draw text with an outline in the background color."""
    corner = tuple(map(round, position))
    drawing.text(
        corner, text, fill=ink, font=font, stroke_width=2, stroke_fill=background
    )


def _load_font(text_height: int) -> Any:
    """Return Pillow's built-in font, which is the same on all machines."""
    return import_package("PIL.ImageFont").load_default(text_height)


def picture_sheet(
    rows: list[list[Array]], gap: int, color: Color, caption: Caption, ink: Color
) -> Array:
    """Return pictures of equal size arranged in rows, with a title above.

    Args:
        rows: Pictures by row; rows may be short.
        gap: Gap between pictures [px].
        color: Color of the gaps.
        caption: Title of the sheet.
        ink: Color of the text.
    """
    height, width = rows[0][0].shape[:2]
    column_count = max(map(len, rows))
    size = _sheet_span(len(rows), height, gap), _sheet_span(column_count, width, gap)
    sheet = np.full((caption.height + size[0], size[1], 3), color, np.uint8)
    for i, row in enumerate(rows):
        for k, picture in enumerate(row):
            y, x = caption.height + i * (height + gap), k * (width + gap)
            sheet[y : y + height, x : x + width] = picture
    return with_caption(sheet, caption, "", ink, color)


def _sheet_span(count: int, size: int, gap: int) -> int:
    """Return the size of a row or column of pictures with gaps between [px]."""
    return count * size + (count - 1) * gap


def evenly_spaced(count: int, sample_count: int) -> IntArray:
    """Return evenly spaced sample indices, including the first and the last sample.

    >>> evenly_spaced(100, 4).tolist(), evenly_spaced(1, 4).tolist()
    ([0, 33, 66, 99], [0, 0, 0, 0])
    """
    return np.rint(np.linspace(0, count - 1, sample_count)).astype(np.int64)
