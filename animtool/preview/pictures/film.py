"""Writes pictures and films; films are encoded frame by frame."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np

from animtool.core.files.output import replacing
from animtool.core.files.placing import output_error
from animtool.preview.pictures.device import Array, needed
from animtool.preview.pictures.kinds import PictureKind

# Bits of libav: nothing of the machine or the time in a file.
_BITEXACT = 1 << 23
# Of ITU-R BT.709, as players take pictures of this kind for.
_BT709, _NARROW = 1, 1
COLORS = 256


def write_picture(path: Path, pixels: Array) -> None:
    """Write a picture atomically (else OUT002)."""
    image_of = needed("PIL.Image")
    settings: dict[str, Any] = {"format": "PNG", "optimize": True}
    if path.suffix.lower() == ".webp":
        settings = {"format": "WEBP", "quality": 90, "method": 6}
    image = image_of.fromarray(np.ascontiguousarray(pixels))
    with replacing(path) as new:
        try:
            image.save(new, **settings)
        except OSError as error:
            raise output_error(path, error) from error


@contextmanager
def film(
    path: Path,
    kind: PictureKind,
    size: tuple[int, int],
    rate: Fraction,
    samples: Sequence[Array],
) -> Iterator[Callable[[Array], None]]:
    """Context that encodes frames to a film, written atomically (else OUT002).

    Args:
        path: The film.
        kind: What it is written as.
        size: Of frames [px].
        rate: Of frames a second.
        samples: Some frames, of whose colours those are chosen that it has.
    """
    av = needed("av")
    palette = _palette(samples) if kind.pixels == "pal8" else None
    with replacing(path) as new:
        try:
            with av.open(
                str(new), "w", format=kind.container, options=dict(kind.file_settings)
            ) as container:
                stream = container.add_stream(
                    kind.codec, rate=rate, options=dict(kind.settings)
                )
                stream.width, stream.height = size
                stream.pix_fmt = kind.pixels
                context = stream.codec_context
                context.flags |= _BITEXACT
                if palette is None:
                    context.colorspace = context.color_primaries = _BT709
                    context.color_trc = context.color_range = _NARROW
                count = 0

                def add(pixels: Array) -> None:
                    nonlocal count
                    frame = _frame(av, pixels, palette)
                    frame.pts, frame.time_base = count, 1 / rate
                    count += 1
                    for packet in stream.encode(frame):
                        container.mux(packet)

                yield add
                for packet in stream.encode():
                    container.mux(packet)
        except OSError as error:
            raise output_error(path, error) from error


def _frame(av: Any, pixels: Array, palette: Any) -> Any:
    """Return pixels as a libav frame."""
    pixels = np.ascontiguousarray(pixels)
    if palette is None:
        frame = av.VideoFrame.from_ndarray(pixels, format="rgb24")
        return frame.reformat(format="yuv420p", dst_colorspace=_BT709)
    image_of = needed("PIL.Image")
    image = image_of.fromarray(pixels)
    mapped = image.quantize(palette=palette, dither=image_of.Dither.NONE)
    colors = np.zeros((COLORS, 4), np.uint8)
    listed = np.array(palette.getpalette(), np.uint8).reshape(-1, 3)
    # Alpha comes first.
    colors[:, 0], colors[: len(listed), 1:] = 255, listed
    return av.VideoFrame.from_ndarray((np.asarray(mapped), colors), format="pal8")


def _palette(samples: Sequence[Array]) -> Any:
    """Return a palette image for some frames."""
    image_of = needed("PIL.Image")
    joined = image_of.fromarray(np.ascontiguousarray(np.concatenate(samples)))
    method = image_of.Quantize.MEDIANCUT
    return joined.quantize(COLORS, method=method, dither=image_of.Dither.NONE)
