"""What is said of a rig."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
from support.cli import animtool
from support.surfaces import shaped_rig

from animtool.report.describe_rig import describe_rig
from animtool.rig.surfaces import with_array_file
from animtool.rig.write import rig_text


def test_a_rig_in_numbers() -> None:
    found = describe_rig("x", shaped_rig(), [])
    assert found.joints == {"free": 1, "ball": 1, "pin": 1}
    assert found.limited == 2
    assert (found.shapes, found.combined, found.arkit) == (4, 1, 0)
    body, cap = found.meshes
    assert (body.points, body.faces, body.shapes) == (40, 28, 3)
    assert (body.method, body.joints, body.influences) == ("linear", 3, 2)
    assert cap.method is None


def test_info_of_rig_files(tmp_path: Path) -> None:
    rig, arrays = with_array_file(shaped_rig(), tmp_path / "hero.npz")
    np.savez(tmp_path / "hero.npz", allow_pickle=False, **arrays)
    path = tmp_path / "hero.rig.yaml"
    path.write_text(rig_text(rig).replace("name: smile", "name: jaw_open"))
    path.write_text(path.read_text().replace("[smile,", "[jaw_open,"))
    done = animtool("info", path)
    assert done.code == 0, done.stderr
    assert "mesh      body: 40 points, 28 faces, linear skin on 3 joints" in done.stdout
    assert "4, 1 combined, 1 of ARKit's 52" in done.stdout
    done = animtool("info", path, "--format", "json")
    (described,) = json.loads(done.stdout)["files"]
    assert described["meshes"][0]["points"] == 40
    (tmp_path / "hero.npz").unlink()
    done = animtool("info", path)
    assert done.code == 3
    assert "RIG018" in done.stderr
