"""Writes pictures and films; films are encoded frame by frame."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np

from animtool.core.files.commit import output_error
from animtool.core.files.output import replacement_path
from animtool.preview.pictures.device import Array, import_package
from animtool.preview.pictures.kinds import PictureKind

# libav flags that keep machine and time out of the file.
_BITEXACT_FLAG = 1 << 23
# ITU-R BT.709 with limited range, which players assume for video of this size.
_BT709, _NARROW_RANGE = 1, 1
PALETTE_SIZE = 256


def write_picture(path: Path, pixels: Array) -> None:
    """Write a picture atomically; raise OUT002 if that fails."""
    image_module = import_package("PIL.Image")
    save_options: dict[str, Any] = {"format": "PNG", "optimize": True}
    if path.suffix.lower() == ".webp":
        save_options = {"format": "WEBP", "quality": 90, "method": 6}
    image = image_module.fromarray(np.ascontiguousarray(pixels))
    with replacement_path(path) as temporary_path:
        try:
            image.save(temporary_path, **save_options)
        except OSError as error:
            raise output_error(path, error) from error


@contextmanager
def film_writer(
    path: Path,
    kind: PictureKind,
    size: tuple[int, int],
    rate: Fraction,
    palette_frames: Sequence[Array],
) -> Iterator[Callable[[Array], None]]:
    """Return a context that encodes frames to a film file, written atomically.

    Args:
        path: Path of the film.
        kind: Format of the film.
        size: Size of frames [px].
        rate: Frames per second.
        palette_frames: Some frames, whose colours make the palette.
    """
    av = import_package("av")
    palette = _palette_image(palette_frames) if kind.pixels == "pal8" else None
    with replacement_path(path) as temporary_path:
        try:
            with av.open(
                str(temporary_path),
                "w",
                format=kind.container,
                options=dict(kind.file_settings),
            ) as container:
                stream = container.add_stream(
                    kind.codec, rate=rate, options=dict(kind.settings)
                )
                stream.width, stream.height = size
                stream.pix_fmt = kind.pixels
                context = stream.codec_context
                context.flags |= _BITEXACT_FLAG
                if palette is None:
                    context.colorspace = context.color_primaries = _BT709
                    context.color_trc = context.color_range = _NARROW_RANGE
                frame_count = 0

                def encode(pixels: Array) -> None:
                    """Encode one frame ``(H, W, 3)`` and write its packets."""
                    nonlocal frame_count
                    frame = _video_frame(av, pixels, palette)
                    frame.pts, frame.time_base = frame_count, 1 / rate
                    frame_count += 1
                    for packet in stream.encode(frame):
                        container.mux(packet)

                yield encode
                for packet in stream.encode():
                    container.mux(packet)
        except OSError as error:
            raise output_error(path, error) from error


def _video_frame(av: Any, pixels: Array, palette: Any) -> Any:
    """Return pixels as a libav frame: YUV, or palette indices for a GIF."""
    pixels = np.ascontiguousarray(pixels)
    if palette is None:
        frame = av.VideoFrame.from_ndarray(pixels, format="rgb24")
        return frame.reformat(format="yuv420p", dst_colorspace=_BT709)
    image_module = import_package("PIL.Image")
    image = image_module.fromarray(pixels)
    indexed_pixels = image.quantize(palette=palette, dither=image_module.Dither.NONE)
    colors = np.zeros((PALETTE_SIZE, 4), np.uint8)
    palette_colors = np.array(palette.getpalette(), np.uint8).reshape(-1, 3)
    # libav palettes have alpha first.
    colors[:, 0], colors[: len(palette_colors), 1:] = 255, palette_colors
    return av.VideoFrame.from_ndarray(
        (np.asarray(indexed_pixels), colors), format="pal8"
    )


def _palette_image(frames: Sequence[Array]) -> Any:
    """Return a palette image with the most important colors of some sample frames."""
    image_module = import_package("PIL.Image")
    all_pixels = image_module.fromarray(np.ascontiguousarray(np.concatenate(frames)))
    method = image_module.Quantize.MEDIANCUT
    return all_pixels.quantize(
        PALETTE_SIZE, method=method, dither=image_module.Dither.NONE
    )
