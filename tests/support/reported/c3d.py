"""Checks of C3D files and of arrays, read byte by byte and by numpy."""

from __future__ import annotations

import struct
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from support.c3d_bytes import SGI, read_floats
from support.reported.outcome import Outcome, close, require

Floats = npt.NDArray[np.float64]


@dataclass(frozen=True)
class C3d:
    """A C3D as its bytes have it.

    Attributes:
        parameters: By group and name.
        points: ``(F, M, 3)`` in metres, NaN where not seen.
        names: Of the markers.
        rate: Of the points [1/s].
        analog_a_frame: Word 10 of the header: analogue samples a frame of points.
        values: All numbers of the data section, as stored.
    """

    parameters: dict[str, dict[str, Any]]
    points: Floats
    names: list[str]
    rate: float
    analog_a_frame: int
    values: Floats


def read_c3d(data: bytes) -> C3d:
    """Read a file whose header and parameters are of one mind."""
    parameters, p = read_parameters(data)
    order = ">" if p == SGI else "<"
    used, analog = struct.unpack_from(f"{order}2H", data, 2)
    (start, a_frame) = struct.unpack_from(f"{order}2H", data, 16)
    scale = float(read_floats(data[12:16], p)[0])
    rate = float(read_floats(data[20:24], p)[0])
    point = parameters.get("POINT", {})
    width = 4 * used + analog
    body = data[512 * (start - 1) :]
    if scale < 0:
        values = read_floats(body[: len(body) // 4 * 4], p)
    else:
        values = np.frombuffer(body[: len(body) // 2 * 2], f"{order}i2").astype(float)
    require(used > 0, "the C3D has no points")
    frames = _frames(data, order, parameters, len(values) // width)
    require(frames > 0, "the C3D has no frames")
    values = values[: frames * width]
    rows = values.reshape(frames, width)[:, : 4 * used].reshape(frames, used, 4)
    unit = {"mm": 0.001, "cm": 0.01, "m": 1.0}[
        (point.get("UNITS") or ["mm"])[0].lower()
    ]
    points = rows[..., :3] * ((scale if scale > 0 else 1.0) * unit)
    points[rows[..., 3] < 0] = np.nan
    names = [*point.get("LABELS", ())][:used]
    names += [""] * (used - len(names))
    return C3d(parameters, points, names, rate, a_frame, values)


def _frames(
    data: bytes, order: str, parameters: dict[str, dict[str, Any]], most: int
) -> int:
    """Return how many frames there are, at most as many as the data holds."""
    first, last = struct.unpack_from(f"{order}2H", data, 6)
    stated = last - first + 1
    trial = parameters.get("TRIAL", {})
    if "ACTUAL_END_FIELD" in trial:
        low, high = (np.asarray(trial["ACTUAL_END_FIELD"], int) & 0xFFFF).tolist()
        stated = max(stated, low + 65536 * high - first + 1)
    return min(stated, most)


def read_parameters(data: bytes) -> tuple[dict[str, dict[str, Any]], int]:
    """Return the parameters by group and name, and the processor."""
    at = 512 * (data[0] - 1)
    processor = data[at + 3]
    order = ">" if processor == SGI else "<"
    at += 4
    groups: dict[int, str] = {}
    found: list[tuple[int, str, Any]] = []
    while at + 2 < len(data) and data[at]:
        length, group = (
            abs(struct.unpack_from("b", data, at)[0]),
            struct.unpack_from("b", data, at + 1)[0],
        )
        name = data[at + 2 : at + 2 + length].decode("latin-1").upper()
        at += 2 + length
        (offset,) = struct.unpack_from(f"{order}H", data, at)
        if group < 0:
            groups[-group] = name
        else:
            found.append((group, name, _parameter(data, at + 2, processor)))
        if not offset:
            break
        at += offset
    parameters: dict[str, dict[str, Any]] = {name: {} for name in groups.values()}
    for group, name, value in found:
        parameters[groups[group]][name] = value
    return parameters, processor


def _parameter(data: bytes, at: int, processor: int) -> Any:
    """Return the value of a parameter: texts, or numbers in the order of the file."""
    kind, count = struct.unpack_from("bB", data, at)
    sizes = list(data[at + 2 : at + 2 + count])
    at += 2 + count
    total = int(np.prod(sizes, dtype=int))
    raw = data[at : at + abs(kind) * total]
    if kind == -1:
        text, width = raw.decode("latin-1"), sizes[0] if sizes else 1
        return [text[i : i + width].strip() for i in range(0, total, max(width, 1))]
    if kind == 4:
        return read_floats(raw, processor)
    order = ">" if processor == SGI else "<"
    return np.frombuffer(raw, f"{order}i2" if kind == 2 else "u1").astype(float)


def c3d_analog_rate(outcome: Outcome, *, of: str | None = None) -> None:
    """Require that word 10 times POINT:RATE is ANALOG:RATE."""
    c3d = read_c3d(outcome.file(of).read_bytes())
    rates = [c3d.parameters.get(group, {}).get("RATE") for group in ("POINT", "ANALOG")]
    require(all(rate is not None and len(rate) for rate in rates), "a RATE is missing")
    point, analog = (float(rate[0]) for rate in rates)  # type: ignore[index]
    product = c3d.analog_a_frame * point
    text = f"{c3d.analog_a_frame} times {point} is not {analog}"
    require(point > 0, "POINT:RATE is 0")
    require(close(product, analog, 1e-4 * max(analog, 1.0)), text)


def c3d_finite(outcome: Outcome, *, of: str | None = None) -> None:
    """Require that all numbers in the data section are finite."""
    values = read_c3d(outcome.file(of).read_bytes()).values
    bad = int((~np.isfinite(values)).sum())
    require(not bad, f"{bad} of {len(values)} numbers are infinite or none")


def npz_within_m(
    outcome: Outcome, *, array: str, max: float, of: str | None = None
) -> None:
    """Require that all numbers of an array are within a distance of 0.

    NaN is what was not filled, and no number.
    """
    with np.load(outcome.file(of)) as arrays:
        require(array in arrays, f"no array {array!r} among {sorted(arrays)}")
        values = np.asarray(arrays[array], float)
    numbers = np.abs(values[~np.isnan(values)])
    require(len(numbers), f"{array} has no number")
    require(numbers.max() <= max, f"{array} goes to {numbers.max():.5g}, at most {max}")


CHECKS = {
    "c3d_analog_rate": c3d_analog_rate,
    "c3d_finite": c3d_finite,
    "npz_within_m": npz_within_m,
}
