"""Option values: choices, weights, and key curves as lists of pairs."""

from __future__ import annotations

import math
from collections.abc import Sequence
from enum import StrEnum
from typing import TypeAlias, TypeVar

import numpy as np

from animtool.core.array_types import FloatArray
from animtool.core.errors import Fault, OptionError, excerpt, refuse
from animtool.core.names import most_similar
from animtool.core.quantities import percent_hint
from animtool.maths.curves import cubic_curves, evaluate
from animtool.maths.tangents import auto_clamped

Choice = TypeVar("Choice", bound=StrEnum)


def parse_choice(choices: type[Choice], word: str, option: str) -> Choice:
    """Return the member of an enum that an option names (unknown name: SCN025).

    >>> class Side(StrEnum):
    ...     LEFT = "left"
    >>> parse_choice(Side, "left", "side")
    <Side.LEFT: 'left'>
    """
    try:
        return choices(word)
    except ValueError as error:
        allowed_names = [str(choice) for choice in choices]
        message = f"{option} is {excerpt(str(word))}; it is one of "
        message += ", ".join(allowed_names)
        suggestion = most_similar(str(word), allowed_names)
        hint = f"did you mean {suggestion}?" if suggestion else None
        raise OptionError(Fault("SCN025", message, hint=hint)) from error


KeyPairs: TypeAlias = Sequence[Sequence[float]]
WeightOption: TypeAlias = float | KeyPairs


class KeyInterpolation(StrEnum):
    """Interpolation between the pairs of a key curve.

    ``smooth`` has a continuous slope that is 0 at local extrema, so that the curve
    stays between the values of adjacent keys.
    """

    LINEAR = "linear"
    SMOOTH = "smooth"


def key_arrays(keys: KeyPairs, option_name: str) -> tuple[FloatArray, FloatArray]:
    """Return times and values of pairs ``[time, value]``, each ``(K,)``.

    Malformed pairs raise SCN015.
    """
    pairs = list(keys)
    try:
        key_table = np.array(pairs, np.float64)
    except (TypeError, ValueError):
        key_table = np.zeros(0)
    if key_table.ndim != 2 or key_table.shape[1] != 2:
        message = f"{option_name} must be a list of pairs such as [[1, 0], [10, 1]]"
        raise OptionError(Fault("SCN015", f"{message}, not {pairs!r:.80}"))
    if not np.isfinite(key_table).all():
        raise OptionError(
            Fault("SCN015", f"{option_name} holds a number that is not finite")
        )
    descending_rows = np.flatnonzero(np.diff(key_table[:, 0]) <= 0)
    if len(descending_rows):
        time = key_table[descending_rows[0], 0]
        next_time = key_table[descending_rows[0] + 1, 0]
        message = (
            f"times of {option_name} must ascend, and {next_time:g} follows {time:g}"
        )
        raise OptionError(Fault("SCN015", message))
    return key_table[:, 0], key_table[:, 1]


def interpolate_keys(
    times: FloatArray,
    values: FloatArray,
    evaluation_times: FloatArray,
    interpolation: KeyInterpolation | str = KeyInterpolation.LINEAR,
) -> FloatArray:
    """Evaluate a key curve at times ``(F,)``, constant outside the keys.

    The slopes of ``smooth`` are those of `animtool.maths.tangents.auto_clamped`.

    >>> ramp = np.array([0.0, 2.0]), np.array([0.0, 1.0])
    >>> interpolate_keys(*ramp, np.array([-1.0, 1.0])).tolist()
    [0.0, 0.5]
    """
    key_interpolation = parse_choice(KeyInterpolation, interpolation, "interpolation")
    if key_interpolation is KeyInterpolation.LINEAR or len(times) < 2:
        return np.asarray(np.interp(evaluation_times, times, values))
    # Handles are at thirds of the segments around a key.
    slopes = auto_clamped(times, values[:, None])
    thirds = np.diff(times)[:, None] / 3
    in_handles, out_handles = np.zeros(slopes.shape), np.zeros(slopes.shape)
    in_handles[1:], out_handles[:-1] = -slopes[1:] * thirds, slopes[:-1] * thirds
    curve = cubic_curves(times, values[:, None], in_handles, out_handles)
    return np.asarray(evaluate(curve, evaluation_times)[0])


def weights_at(
    weight: WeightOption,
    codes: FloatArray,
    interpolation: KeyInterpolation | str = KeyInterpolation.LINEAR,
    *,
    is_bounded: bool = True,
) -> FloatArray:
    """Evaluate a weight or weight curve at time codes ``(F,)`` [1].

    ``weight`` is a number or a list of pairs ``[time code, weight]``. Weights outside
    0 to 1 are refused if ``is_bounded`` (SCN014).

    >>> weights_at(0.5, np.arange(2.0)).tolist()
    [0.5, 0.5]
    """
    parse_choice(KeyInterpolation, interpolation, "interpolation")
    if isinstance(weight, (int, float)):
        _check_weight(float(weight), is_bounded)
        return np.full(len(codes), float(weight))
    times, values = key_arrays(weight, "weight")
    for value in values.tolist():
        _check_weight(value, is_bounded)
    return interpolate_keys(times, values, codes, interpolation)


def _check_weight(weight: float, is_bounded: bool) -> None:
    """Raise if a weight is not finite, or outside 0 to 1 if bounded."""
    if not math.isfinite(weight):
        raise OptionError(Fault("SCN014", f"a weight is {weight}, which is not finite"))
    if is_bounded and not 0 <= weight <= 1:
        hint = percent_hint(weight) if 1 < weight <= 100 else None
        refuse("SCN014", f"weight {weight:g} is not between 0 and 1", hint=hint)
