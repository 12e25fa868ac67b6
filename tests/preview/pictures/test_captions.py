from __future__ import annotations

import numpy as np
import pytest
from support.drawing import need_drawing

from animtool.core.errors import AnimtoolError
from animtool.preview.pictures.captions import (
    Caption,
    evenly_spaced,
    picture_sheet,
    with_caption,
    wrap_caption,
)

INK, BACK = (0, 0, 0), (255, 255, 255)


@pytest.fixture(autouse=True)
def drawn() -> None:
    need_drawing()


@pytest.mark.parametrize("text", ["short", "many words " * 12, "x" * 100, "a\nb"])
@pytest.mark.parametrize("size", [(400, 300), (160, 240)])
def test_no_letter_is_cut_off(text: str, size: tuple[int, int]) -> None:
    caption = wrap_caption(text, *size)
    assert "".join(caption.lines).replace(" ", "") == "".join(text.split())
    blank = np.full((size[1], size[0], 3), 255, np.uint8)
    dark = with_caption(blank, caption, "frame 1001", INK, BACK).min(axis=-1) < 128
    assert not dark[:, :2].any()
    assert not dark[:, -2:].any()
    assert not dark[[0, -1]].any()
    rows = np.flatnonzero(dark.any(axis=1))
    # The caption is within what the camera leaves free, the number far below it.
    assert rows[rows < size[1] * 0.7].max() < caption.height
    assert rows.max() > size[1] * 0.85


def test_what_does_not_fit_is_refused() -> None:
    with pytest.raises(AnimtoolError) as error:
        wrap_caption("many words " * 99, 100, 100)
    assert error.value.code == "PRV006"
    assert wrap_caption("  ", 100, 100).height == 0


def test_a_sheet_has_its_pictures_in_rows() -> None:
    cells = [np.full((4, 6, 3), k, np.uint8) for k in range(3)]
    none = Caption((), 0)
    sheet = picture_sheet([cells[:2], cells[2:]], 1, (9, 9, 9), none, INK)
    assert sheet.shape == (9, 13, 3)
    assert (sheet[0, 0, 0], sheet[0, 7, 0], sheet[5, 0, 0]) == (0, 1, 2)
    assert (sheet[4, 0, 0], sheet[8, 8, 0]) == (9, 9)
    assert evenly_spaced(10, 3).tolist() == [0, 4, 9]
