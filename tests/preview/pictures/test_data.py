from __future__ import annotations

from pathlib import Path

import numpy as np
from preview.pages import ReadPage

from animtool.preview.build import make_page
from animtool.preview.options import PreviewOptions
from animtool.preview.pictures.data import StreamReader
from animtool.preview.pictures.pose import PosedTake
from animtool.rig.kinematics import forward_kinematics


def test_streams_are_read_as_a_second_reader_reads_them(root: Path, walk: Path) -> None:
    for path in (walk, root / "samples/speech/speech.clip.yaml"):
        page = make_page([path], PreviewOptions(findings=False))
        streams, second = StreamReader(page.manifest["streams"], page.blocks), None
        second = ReadPage(page.html())
        for entry in page.manifest["streams"]:
            expected = second.values(entry["id"])
            for sample in {0, len(expected) // 2, len(expected) - 1}:
                found = streams.sample_values(entry["id"], sample)
                np.testing.assert_allclose(found, expected[sample], rtol=1e-6)


def test_poses_are_where_kinematics_puts_them(walk: Path) -> None:
    import animtool

    page = make_page([walk], PreviewOptions(findings=False))
    streams = StreamReader(page.manifest["streams"], page.blocks)
    (record,) = page.manifest["takes"]
    pose = PosedTake(streams, record, 0)
    take = animtool.read_bvh(walk).collect()
    t, r = ReadPage(page.html()).locals()
    r /= np.linalg.norm(r, axis=-1, keepdims=True)
    expected = forward_kinematics(take.rig, t, r).positions
    for sample in (0, 31, 63):
        pose.update(sample)
        np.testing.assert_allclose(pose.positions, expected[sample], atol=2e-6)
    paths = pose.trail_positions(3, 9)
    np.testing.assert_allclose(paths, expected[3:10][:, pose.trail_joints], atol=2e-6)
