"""Shows pages in a browser, or inline in a notebook."""

from __future__ import annotations

import html
import os
import sys
import tempfile
import webbrowser
from collections.abc import Mapping, Sequence
from functools import cached_property
from pathlib import Path

from animtool.core.loaded import path_list
from animtool.motion.take import Take, TakeStream
from animtool.preview.build import PreviewPage, make_page, make_take_page
from animtool.preview.options import PictureOptions, PreviewOptions

DEFAULT_HEIGHT = 560


def has_browser(
    environment: Mapping[str, str] = os.environ, platform: str = sys.platform
) -> bool:
    """Return whether a browser can open: there is a display and no SSH session.

    >>> has_browser({"SSH_CONNECTION": "10.0.0.1"}, "darwin")
    False
    >>> has_browser({}, "linux"), has_browser({"DISPLAY": ":0"}, "linux")
    (False, True)
    """
    if environment.get("SSH_CONNECTION") or environment.get("SSH_TTY"):
        return False
    display = environment.get("DISPLAY") or environment.get("WAYLAND_DISPLAY")
    return bool(display) or not platform.startswith("linux")


def temporary_page() -> Path:
    """Return a path for a page in the system's temporary folder."""
    return Path(tempfile.mkdtemp(prefix="animtool-preview-")) / "preview.html"


def open_browser(address: str) -> bool:
    """Open a URL in the browser; return whether the browser started."""
    try:
        return webbrowser.open(address)
    except webbrowser.Error:
        return False


class Preview:
    """A page that notebooks show inline.

    The page is built on first use.

    Attributes:
        height: Height of its frame in a notebook [px].
    """

    def __init__(
        self,
        shown: Take | TakeStream | Sequence[Path],
        options: PreviewOptions | None = None,
        height: int = DEFAULT_HEIGHT,
    ) -> None:
        self._shown, self._options, self.height = shown, options, height

    @cached_property
    def page(self) -> PreviewPage:
        """The page, built on first use."""
        if isinstance(self._shown, Take | TakeStream):
            stream = self._shown
            if isinstance(stream, Take):
                stream = TakeStream.of(stream)
            return make_take_page(stream.rig.name, stream)
        return make_page(self._shown, self._options)

    def save(
        self,
        path: Path | str,
        *,
        overwrite: bool = False,
        pictures: PictureOptions | None = None,
    ) -> Path:
        """Write the page, or a picture or film of it, and return its path.

        Args:
            path: ``.html``, or any output of `animtool.write_pictures`.
            overwrite: Replace an existing file.
            pictures: Appearance of a picture or film.
        """
        from animtool.core.files.output import check_outputs, write_parts
        from animtool.preview.pictures.kinds import picture_kind

        output = Path(path)
        kind = picture_kind(output)
        check_outputs([output], [], overwrite=overwrite)
        if kind is None:
            write_parts(output, self.page.chunks())
        else:
            from animtool.preview.pictures.build import save_pictures

            save_pictures(self.page, output, pictures)
        return output

    def _repr_html_(self) -> str:
        """Return the page in a sandboxed iframe, as HTML for notebooks."""
        document = html.escape(self.page.html(), quote=True)
        title = html.escape(str(self.page.manifest["title"]), quote=True)
        return (
            f'<iframe sandbox="allow-scripts" title="{title}" '
            f'style="width:100%;height:{self.height}px;border:0" '
            f'srcdoc="{document}"></iframe>'
        )


def show(
    shown: Take | TakeStream | Path | str | Sequence[Path | str],
    options: PreviewOptions | None = None,
    *,
    height: int = DEFAULT_HEIGHT,
) -> Preview:
    """Return an object that notebooks show as an interactive page.

    Args:
        shown: A take, or one or more files of any format that animtool reads.
        options: How files are read, and what is shown.
        height: Height of the page in the notebook [px].

    >>> from animtool.rig.skeleton import Joint, Rig
    >>> from animtool.preview.open_file import rest_take
    >>> shown = show(rest_take(Rig("arm", (Joint("a", -1),))).collect())
    >>> shown._repr_html_().startswith('<iframe sandbox="allow-scripts" title="arm"')
    True
    """
    if isinstance(shown, Take | TakeStream):
        return Preview(shown, options, height)
    return Preview(path_list(shown, "shown"), options, height)
