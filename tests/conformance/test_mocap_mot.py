"""Motion files of OpenSim, as others wrote them: all are read, written, read again."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from support.data import data_files

from animtool import open_source
from animtool.formats.mot.coordinates import list_coordinates
from animtool.formats.mot.write import build_mot_text
from animtool.maths.so3 import angle_between


@pytest.mark.parametrize("path", data_files("mocap/real", "*.mot"))
def test_real_files(
    path: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    stream = open_source(path)
    take = stream.collect()
    assert len(take) > 1
    count = len(list_coordinates(take.rig))
    assert count == stream.details["coordinates"]
    text = build_mot_text(take)
    (tmp_path / path.name).write_bytes(b"".join(text.parts))
    assert text.notices == []
    again = open_source(tmp_path / path.name).collect()
    assert again.clock == take.clock
    turned = again.motion.rotations.dense(), take.motion.rotations.dense()
    off = float(angle_between(*turned).max())
    slid = again.motion.translations.dense() - take.motion.translations.dense()
    with capsys.disabled():
        print(  # noqa: T201 - the score table
            f"\n{path.name}: {len(take)} frames at {float(take.fps):g} fps, {count} "
            f"coordinates; written and read again {off:.1e} rad, "
            f"{np.abs(slid).max():.1e} m"
        )
    assert off < 1e-9
    assert np.abs(slid).max() < 1e-8
