"""Renders pictures of files: single frames, contact sheets, turntables and films."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from contextlib import closing
from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from typing import ClassVar

import numpy as np

from animtool.core.arguments import argument
from animtool.core.clock import frame_label
from animtool.core.errors import Fault, OptionError, counted
from animtool.core.files.output import check_outputs, protect_inputs
from animtool.core.loaded import check_loaded, path_list
from animtool.core.record import dataclass
from animtool.core.shot import FrameList
from animtool.preview.build import PreviewPage, make_page
from animtool.preview.options import PictureOptions, PreviewOptions
from animtool.preview.pictures.camera import CameraView
from animtool.preview.pictures.captions import (
    Caption,
    evenly_spaced,
    picture_sheet,
    with_caption,
    wrap_caption,
)
from animtool.preview.pictures.device import Array, Device, Framebuffer, import_package
from animtool.preview.pictures.film import film_writer, write_picture
from animtool.preview.pictures.kinds import PictureKind, picture_kind
from animtool.preview.pictures.request import (
    CameraChoice,
    camera_choice,
    drawn_layers,
    light_direction,
    option_error,
    picture_size,
    sheet_layout,
)
from animtool.preview.pictures.scene import SceneRenderer
from animtool.preview.pictures.sources import theme_colors
from animtool.preview.timing import MAX_FRAME_DISTANCE

# Gap between the pictures of a sheet [px].
SHEET_GAP = 4
# Pictures per row of a sheet without a stated number of columns.
DEFAULT_COLUMNS = 6
# Duration [s] and frame rate of a turntable around a static subject.
TURNTABLE_SECONDS, TURNTABLE_RATE = 4, 24
# Number of frames whose colours make the palette of a film.
PALETTE_FRAMES = 6

Progress = Callable[[float], None]


@dataclass(frozen=True, slots=True)
class PictureReport:
    """Path, size, frames and format of a written picture or film.

    Attributes:
        path: Path of the file.
        size: Size of the file [byte].
        pixels: Width and height.
        frames: Time codes of the frames shown, in order for a film.
        rate: Frames per second of a film; 0 for a still.
        about: Format of the file, with the licence of its encoder.
        page: The page that it shows.
    """

    path: Path
    size: int
    pixels: tuple[int, int]
    frames: tuple[float, ...]
    rate: Fraction
    about: str
    page: PreviewPage

    json_keys: ClassVar[str] = (
        "'preview' output=path bytes=size format=about width height frames=count "
        "first last fps=rate not_shown=page.manifest.notices notices=page.notices"
    )

    @property
    def width(self) -> int:
        """Width [pixels]."""
        return self.pixels[0]

    @property
    def height(self) -> int:
        """Height [pixels]."""
        return self.pixels[1]

    @property
    def count(self) -> int:
        """Number of frames shown."""
        return len(self.frames)

    @property
    def first(self) -> float:
        """Time code of the first frame shown."""
        return self.frames[0]

    @property
    def last(self) -> float:
        """Time code of the last frame shown."""
        return self.frames[-1]

    @property
    def every(self) -> int | None:
        """Frame step of a film; None if all frames are shown."""
        if not self.rate or len(set(self.frames)) < 2:
            return None
        step = self.page.manifest["time"]["step"]
        every = round((self.frames[1] - self.frames[0]) / step)
        return every if every > 1 else None


def write_pictures(
    files: Path | str | Sequence[Path | str],
    output: Path | str,
    options: PreviewOptions | None = None,
    pictures: PictureOptions | None = None,
    *,
    overwrite: bool = False,
    progress: Progress | None = None,
) -> PictureReport:
    """Render a picture, sheet or film of files, as their page shows them.

    It needs the extra ``pictures``, and OpenGL 3.3, which Mesa provides without a
    graphics card. A film is encoded frame by frame, so its length takes no memory.

    Args:
        files: Files of any supported kind: takes, rigs, scenes, stages, markers.
        output: ``.png`` or ``.webp`` for a still or sheet; ``.gif``, ``.webp``,
            ``.mp4`` or ``.webm`` for a film.
        options: How the files are read, and which frames are shown.
        pictures: Appearance of the picture.
        overwrite: Replace an existing file.
        progress: Called with the completed fraction, from 0 to 1.

    Raises:
        FormatError: A file cannot be read, or is malformed.
        OptionError: A file shows nothing (PRV001), the output is not a picture (PRV002)
            or exists (OUT001), a package is missing (IO005), OpenGL does not start
            (PRV005), an option is invalid (PRV006), or frames are not in the files
            (CLI005).
        OutputError: It cannot be written.
    """
    paths, output = path_list(files, "files"), Path(output)
    if options is not None:
        check_loaded(options, PreviewOptions, "options")
    if pictures is not None:
        check_loaded(pictures, PictureOptions, "pictures")
    kind = picture_kind(output)
    if kind is None:
        message, hint = "a page is not a picture", "use write_page for it"
        raise OptionError(Fault("PRV002", message, str(output), (), hint))
    check_outputs([output], paths, overwrite=overwrite)
    options = replace(options or PreviewOptions(), findings=False)
    pictures = pictures or PictureOptions()
    frame_range = options.frame_range
    frames = frame_range.frames if isinstance(frame_range, FrameList) else ()
    _check_options(pictures, kind, frames)
    # Missing packages are reported before scenes are baked.
    with closing(Device()) as device:
        with protect_inputs([output]):
            page = make_page(paths, options)
        renderer = PictureRenderer(device, page, pictures, kind, frames, progress)
        return renderer.write(output)


def save_pictures(
    page: PreviewPage, output: Path, pictures: PictureOptions | None = None
) -> PictureReport:
    """Render a picture, sheet or film of a page; see `write_pictures`."""
    kind = picture_kind(output)
    assert kind is not None
    pictures = pictures or PictureOptions()
    _check_options(pictures, kind, ())
    with closing(Device()) as device:
        return PictureRenderer(device, page, pictures, kind, (), None).write(output)


def _check_options(
    pictures: PictureOptions, kind: PictureKind, frames: tuple[int, ...]
) -> None:
    """Raise an error for invalid picture options, before anything is read."""
    import_package("PIL.Image")
    if kind.codec:
        import_package("av")
    drawn_layers(pictures)
    light_direction(pictures)
    sheet = sheet_layout(pictures)
    picture_size(pictures, kind, is_sheet=bool(sheet or frames))
    requested_options = {
        "sheet": sheet,
        "frame_range": frames,
        "camera": pictures.camera[1:],
    }
    multi_picture_options = [name for name, value in requested_options.items() if value]
    if multi_picture_options and not kind.is_image:
        message = "a film shows frames one after another, from one camera"
        hint = "a sheet, or listed frames, need .png or .webp; 1-240x2 plays a range"
        raise option_error(multi_picture_options[0], message, hint)
    if sheet and len(frames) > sheet[0] * sheet[1]:
        message = f"{len(frames)} frames do not fit on a sheet of {pictures.sheet}"
        raise option_error(
            "frame_range", message, "list fewer frames, or enlarge the sheet"
        )
    if pictures.turntable and (multi_picture_options or not kind.codec):
        hint = "name it .gif, .webp, .mp4 or .webm"
        raise option_error("turntable", "a still has no turntable", hint)


class PictureRenderer:
    """Renders the frames of one page as a picture, contact sheet or film."""

    def __init__(
        self,
        device: Device,
        page: PreviewPage,
        options: PictureOptions,
        kind: PictureKind,
        frames: tuple[int, ...],
        progress: Progress | None,
    ) -> None:
        self._device, self._page = device, page
        self._options, self._kind = options, kind
        self._progress = progress or (lambda _: None)
        camera_names = [camera["name"] for camera in page.manifest["cameras"]]
        camera_texts = options.camera or ("home",)
        self._cameras = [camera_choice(text, camera_names) for text in camera_texts]
        self._frames = frames
        layers = drawn_layers(options)
        self._scene = SceneRenderer(device, page.manifest, page.blocks, layers)
        self._colors = theme_colors()

    def write(self, output: Path) -> PictureReport:
        """Write the picture, sheet or film to a file; return its report."""
        is_single_image = not self._kind.codec or self._is_sheet
        if not is_single_image:
            return self._write_film(output)
        pixels, samples = self._render_pictures()
        write_picture(output, pixels)
        return self._report(output, pixels.shape, samples, Fraction(0))

    @property
    def _is_sheet(self) -> bool:
        """Whether the picture is a contact sheet of several pictures."""
        has_several_cameras = len(self._cameras) > 1
        return bool(self._options.sheet or self._frames) or has_several_cameras

    def _report(
        self,
        output: Path,
        image_shape: tuple[int, ...],
        samples: Sequence[int],
        rate: Fraction,
    ) -> PictureReport:
        """Return the report of a written picture or film."""
        codes = tuple(float(self._scene.codes[i]) for i in samples)
        size = output.stat().st_size
        pixels = image_shape[1], image_shape[0]
        format_text = self._kind.description
        return PictureReport(output, size, pixels, codes, rate, format_text, self._page)

    def _picture_samples(self) -> list[int]:
        """Return the timeline samples that a picture or sheet shows."""
        codes = self._scene.codes
        if self._frames:
            samples = []
            for frame in self._frames:
                sample = int(np.argmin(np.abs(codes - frame)))
                if abs(codes[sample] - frame) > MAX_FRAME_DISTANCE:
                    end_labels = frame_label(codes[0]), frame_label(codes[-1])
                    message = (
                        f"{argument('frame_range')}: frame {frame} is not in the "
                        f"file, which has frames {end_labels[0]}-{end_labels[1]}"
                    )
                    raise OptionError(Fault("CLI005", message))
                samples.append(sample)
            return samples
        sheet = sheet_layout(self._options)
        if sheet is None:
            return [0]
        sample_count = sheet[0] * sheet[1] // len(self._cameras)
        return [int(i) for i in evenly_spaced(len(codes), max(sample_count, 1))]

    def _render_pictures(self) -> tuple[Array, list[int]]:
        """Return the pixels of a picture or sheet, and the samples that it shows."""
        samples = self._picture_samples()
        camera_samples = [(camera, i) for camera in self._cameras for i in samples]
        has_several_pictures = len(camera_samples) > 1
        size = picture_size(self._options, self._kind, is_sheet=has_several_pictures)
        captions = self._wrap_captions(len(camera_samples), size)
        picture = Framebuffer(self._device, *size)
        shows_numbers = self._shows_numbers(len(samples))
        pictures: list[Array] = []
        view: CameraView | None = None
        for k, ((camera, sample), caption) in enumerate(
            zip(camera_samples, captions, strict=True)
        ):
            if view is None or k % len(samples) == 0:
                view = self._framing_view(camera, size, caption, sample)
            view.top_inset = caption.height
            pixels = self._scene.draw(view, sample, picture, camera.shot)
            pictures.append(
                self._add_text(pixels, caption, sample if shows_numbers else None)
            )
            self._progress((k + 1) / len(camera_samples))
        if not has_several_pictures:
            return pictures[0], samples
        columns = self._sheet_columns(len(samples), len(camera_samples))
        rows = [pictures[k : k + columns] for k in range(0, len(pictures), columns)]
        width = columns * (size[0] + SHEET_GAP) - SHEET_GAP
        title = self._sheet_title(len(camera_samples), width, size[1])
        ink = self._colors["ink"]
        pixels = picture_sheet(rows, SHEET_GAP, self._colors["page"], title, ink)
        return pixels, samples

    def _sheet_columns(self, sample_count: int, picture_count: int) -> int:
        """Return the columns of a sheet: as requested, one per frame, or at most 6."""
        sheet = sheet_layout(self._options)
        if sheet is not None:
            return min(sheet[0], picture_count)
        if sample_count < picture_count and sample_count > 1:
            return sample_count
        return math.ceil(picture_count / math.ceil(picture_count / DEFAULT_COLUMNS))

    def _wrap_captions(
        self, picture_count: int, size: tuple[int, int]
    ) -> list[Caption]:
        """Return the wrapped caption of each picture."""
        caption_texts = self._options.caption
        if len(caption_texts) not in {0, 1, picture_count}:
            message = f"{counted(len(caption_texts), 'caption')} for "
            message += counted(picture_count, "picture")
            raise option_error("caption", message, "write one, or one for each")
        if len(caption_texts) == picture_count:
            return [wrap_caption(text, *size) for text in caption_texts]
        return [Caption((), 0)] * picture_count

    def _sheet_title(self, picture_count: int, width: int, height: int) -> Caption:
        """Return the title above a sheet: its caption, if it has only one."""
        texts = self._options.caption
        title = texts[0] if len(texts) == 1 < picture_count else ""
        return wrap_caption(title, width, height)

    def _framing_view(
        self, camera: CameraChoice, size: tuple[int, int], caption: Caption, sample: int
    ) -> CameraView:
        """Return a camera view that frames the complete motion."""
        view = CameraView(*size, caption.height, light=light_direction(self._options))
        camera.aim(view)
        self._scene.frame_motion(view, sample)
        camera.position(view)
        return view

    def _shows_numbers(self, frame_count: int) -> bool:
        """Return whether to show frame numbers: as requested, else for many frames."""
        numbers = self._options.numbers
        return frame_count > 1 if numbers is None else numbers

    def _add_text(self, pixels: Array, caption: Caption, sample: int | None) -> Array:
        """Return pixels with the caption drawn and, if requested, the frame number."""
        frame_text = ""
        if sample is not None:
            frame_text = f"frame {frame_label(self._scene.codes[sample])}"
        ink, background = self._colors["ink"], self._colors["view"]
        return with_caption(pixels, caption, frame_text, ink, background)

    def _write_film(self, output: Path) -> PictureReport:
        """Write a film frame by frame; return its report."""
        samples, rate = self._film_samples()
        size = picture_size(self._options, self._kind, is_sheet=False)
        (caption,) = self._wrap_captions(1, size)
        (camera,) = self._cameras
        picture = Framebuffer(self._device, *size)
        view = self._framing_view(camera, size, caption, samples[0])
        yaw = view.yaw
        shows_numbers = self._shows_numbers(len(set(samples)))

        def render(frame_index: int) -> Array:
            """Return the pixels of a film frame by its number, from 0."""
            if self._options.turntable:
                view.yaw = yaw + 2 * math.pi * frame_index / len(samples)
            pixels = self._scene.draw(view, samples[frame_index], picture, camera.shot)
            return self._add_text(
                pixels, caption, samples[frame_index] if shows_numbers else None
            )

        palette_frames: list[Array] = []
        if self._kind.pixels == "pal8":
            palette_frames = [
                render(k)
                for k in sorted({*evenly_spaced(len(samples), PALETTE_FRAMES)})
            ]
        with film_writer(output, self._kind, size, rate, palette_frames) as add_frame:
            for k in range(len(samples)):
                add_frame(render(k))
                self._progress((k + 1) / len(samples))
        return self._report(output, (size[1], size[0]), samples, rate)

    def _film_samples(self) -> tuple[list[int], Fraction]:
        """Return the timeline samples of a film, and its frame rate [1/s]."""
        time_entry = self._page.manifest["time"]
        rate = Fraction(*time_entry["rate"]) / Fraction(time_entry["step"])
        if time_entry["count"] == 1:
            frame_count = (
                TURNTABLE_SECONDS * TURNTABLE_RATE if self._options.turntable else 1
            )
            return [0] * frame_count, Fraction(TURNTABLE_RATE)
        sample_interval = max(1, math.ceil(rate / self._kind.max_rate))
        return list(
            range(0, time_entry["count"], sample_interval)
        ), rate / sample_interval
