from __future__ import annotations

import numpy as np
import pytest
from preview.pages import ReadPage

from animtool.preview.draft import round_up_error
from animtool.preview.page import page_parts
from animtool.preview.streams import (
    BLOCK_SAMPLES,
    QuantizedValues,
    StreamPacker,
    quantize_range,
    quantize_units,
)


def read(packer: StreamPacker) -> ReadPage:
    streams, blocks = packer.finish()
    manifest = {"title": "t", "streams": streams}
    return ReadPage(b"".join(page_parts(manifest, blocks)).decode())


@pytest.mark.parametrize("frames", [1, 2, BLOCK_SAMPLES, 3 * BLOCK_SAMPLES + 1])
def test_values_come_back_within_their_error(frames: int) -> None:
    rng = np.random.default_rng(3)
    units = rng.uniform(-1, 1, (frames, 8))
    places = rng.normal(0, 1, (frames, 6))
    far = places * 1000
    packer = StreamPacker()
    stored = [quantize_units(units), quantize_range(places), quantize_range(far)]
    numbers = [packer.add(data) for data in stored]
    faces = packer.add_static([[0, 1, 2], [70000, 3, 1]], "u32")
    page = read(packer)
    for number, data, values in zip(numbers, stored, (units, places, far), strict=True):
        found = page.values(number)
        assert found.shape == values.shape
        assert np.abs(found - values).max() <= data.error + 1e-12
    assert [data.kind for data in stored[:2]] == ["i16", "i16"]
    assert stored[1].error < 1e-4
    if frames > 1:
        assert stored[2].kind == "f32"
    assert page.values(faces)[0].tolist() == [0, 1, 2, 70000, 3, 1]


@pytest.mark.slow
def test_large_streams_have_blocks_of_their_own() -> None:
    rng = np.random.default_rng(4)
    values = rng.normal(0, 1, (40, 60_000)).astype(np.float32)
    packer = StreamPacker()
    small = packer.add(quantize_range(values[:, :3]))
    large = packer.add(quantize_range(values, column_period=3))
    page = read(packer)
    streams = page.manifest["streams"]
    assert len(streams[large]["block"]) > 1
    assert len(streams[small]["block"]) == 1
    assert len(streams[large]["scale"]) == 3
    assert np.abs(page.values(large) - values).max() < 1e-4


def test_gaps_are_nan() -> None:
    values = np.array([[0.0, 1, 2, np.nan, np.nan, np.nan], [3.0, 4, 5, 6, 7, 8]])
    packer = StreamPacker()
    number = packer.add(quantize_range(values, column_period=3))
    np.testing.assert_allclose(read(packer).values(number), values, atol=1e-4)


def test_equal_static_arrays_are_stored_once() -> None:
    packer = StreamPacker()
    points = np.arange(30.0).reshape(10, 3)
    first = packer.add_static_range(points)
    assert packer.add_static_range(points.copy()) == first
    assert packer.add_static_range(points + 1) != first
    moving = QuantizedValues(np.zeros((2, 1), "<u1"), "u8")
    assert packer.add(moving) != packer.add(moving)


@pytest.mark.parametrize("error", [0.0123, 9.99e-5, 1.0, 0.0999, 123.4])
def test_errors_are_never_rounded_down(error: float) -> None:
    assert error <= round_up_error(error) <= error * 1.1
