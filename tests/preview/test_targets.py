from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from preview.pages import ReadPage

from animtool.preview.build import make_page
from animtool.preview.options import PreviewOptions

PLAIN = PreviewOptions(findings=False)
RIG = """\
rig: animtool/1
name: arm
units: {length: cm}
up: Z
joints:
- {name: root, type: free}
- {name: hand, parent: root, type: ball, translate: [0, 0, 50]}
"""
TARGETS = """\
targets: animtool/1
fps: 24
range: [1, 5]
goals:
- effector: hand
  during: [[2, 5]]
  ease: 0
  position: {interp: linear, keys: [{t: 1, v: [0, 0, 40]}, {t: 5, v: [20, 10, 40]}]}
"""


@pytest.fixture
def files(tmp_path: Path) -> list[Path]:
    pairs = (("arm.rig.yaml", RIG), ("reach.targets.yaml", TARGETS))
    paths = []
    for name, text in pairs:
        paths.append(tmp_path / name)
        paths[-1].write_text(text)
    return paths


def test_targets_are_markers_in_the_axes_and_the_unit_of_the_rig(
    files: list[Path],
) -> None:
    page = ReadPage(make_page(files, PLAIN).html())
    assert page.manifest["time"]["count"] == 5
    markers = page.manifest["points"][0]
    assert markers["names"] == ["hand"]
    values = page.values(markers["positions"])
    assert np.isnan(values[0]).all()
    # Z up in centimetres: (20, 10, 40) is x, z, -y in metres.
    np.testing.assert_allclose(values[-1], [0.2, 0.4, -0.1], atol=1e-4)


def test_targets_alone_are_shown_with_a_note(files: list[Path]) -> None:
    made = make_page(files[1:], PLAIN)
    assert [notice.code for notice in made.notices] == ["PRV107"]
    assert len(made.manifest["points"]) == 1
    assert made.manifest["takes"] == []
