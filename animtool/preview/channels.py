"""Animation curves of a page: clip channels, controls and shape weights."""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction

import numpy as np

from animtool.clip.channels import evaluate_channels
from animtool.clip.clip import Clip
from animtool.core.array_types import FloatArray
from animtool.core.record import dataclass
from animtool.preview.draft import PageDraft, json_number
from animtool.preview.streams import QuantizedValues, json_numbers
from animtool.preview.takes import PageTake
from animtool.rig.kinematics import rest_size

# Maximum number of keys on a page; with more, only the curves are drawn.
MAX_KEYS = 50_000
_AXIS_NAMES = "xyzw"


@dataclass(frozen=True, slots=True)
class ChannelCurve:
    """Values of one channel over the frames of a take, in an animator's units."""

    name: str
    unit: str  # ``m``, ``deg`` or empty
    values: FloatArray  # ``(F,)``
    # Time and value of each key ``(K, 2)``; None if it has no keys.
    keys: FloatArray | None = None
    interp: str | None = None  # interpolation of its first key


def add_channels(
    draft: PageDraft, page_take: PageTake, clip: Clip | None, origin: Fraction
) -> None:
    """Add the animation curves of a take to a page, in one stream.

    Args:
        draft: The page.
        page_take: The take.
        clip: Clip that the take was sampled from; None for other takes.
        origin: Page frame of the clip's first frame.
    """
    curves = [
        *_clip_curves(draft, page_take, clip, float(origin)),
        *_control_curves(page_take, clip),
    ]
    if not curves or not page_take.frames:
        return
    key_count = sum(0 if curve.keys is None else len(curve.keys) for curve in curves)
    if key_count > MAX_KEYS:
        draft.add_notice(f"{key_count} keys: curves are drawn without them")
    stacked_values = np.stack([curve.values for curve in curves], axis=1)
    stream_index = draft.packer.add(
        QuantizedValues(stacked_values.astype("<f4"), "f32")
    )
    rig_size = rest_size(page_take.rig) or 1.0
    for column, curve in enumerate(curves):
        drawn_keys = curve.keys if key_count <= MAX_KEYS else None
        draft.channels.append(
            {
                "name": curve.name,
                "unit": curve.unit,
                "values": stream_index,
                "column": column,
                "keys": None if drawn_keys is None else json_numbers(drawn_keys),
                "interp": curve.interp,
                "moves": json_number(round(_curve_range(curve, rig_size), 4)),
                "take": page_take.index,
            }
        )


def _curve_range(curve: ChannelCurve, rig_size: float) -> float:
    """Return how far the values of a curve vary, in comparable units [1].

    Angles are in radians, lengths relative to the size of the rig.
    """
    unit_factor = {"deg": float(np.degrees(1.0)), "m": rig_size}.get(curve.unit, 1.0)
    values = curve.values[np.isfinite(curve.values)]
    return float(np.ptp(values)) / unit_factor if len(values) else 0.0


def _clip_curves(
    draft: PageDraft, page_take: PageTake, clip: Clip | None, origin: float
) -> list[ChannelCurve]:
    """Return the channels of a clip, sampled at the frames of the page."""
    if clip is None:
        return []
    timeline = draft.timeline
    codes = timeline.codes[0] + (
        np.arange(page_take.frames) + page_take.first_sample
    ) * float(timeline.step)
    frame_ratio, first_frame = float(clip.fps / timeline.fps), float(clip.first)
    times = first_frame + (codes - origin) * frame_ratio
    # Show keyed angles, not the rotations computed from them.
    channels = [replace(channel, euler="") for channel in clip.channels]
    values = evaluate_channels(channels, times)
    curves = []
    for channel in clip.channels:
        width = channel.values.shape[1]
        component_values = np.broadcast_to(
            values[channel.target], (page_take.frames, width)
        )
        unit, factor = _display_unit(channel.target, width)
        key_times = origin + (channel.times - first_frame) / frame_ratio
        axes = channel.euler.lower() or _AXIS_NAMES
        curves += [
            ChannelCurve(
                channel.target + (f".{axes[i]}" if width > 1 else ""),
                unit,
                component_values[:, i] * factor,
                np.stack([key_times, channel.values[:, i] * factor], axis=1),
                str(channel.interps[0]) if channel.interps else None,
            )
            for i in range(width)
        ]
    return curves


def _display_unit(target: str, width: int) -> tuple[str, float]:
    """Return the unit in which a channel is shown, and the factor to that unit."""
    if target.startswith(("control/", "shape/")) or width == 4:
        return "", 1.0
    if target.endswith(("translation", ".slide")):
        return "m", 1.0
    return ("", 1.0) if target.endswith("scale") else ("deg", float(np.degrees(1.0)))


def _control_curves(page_take: PageTake, clip: Clip | None) -> list[ChannelCurve]:
    """Return the curves of controls and shape weights that the clip does not key."""
    keyed_targets = (
        set() if clip is None else {channel.target for channel in clip.channels}
    )
    rig = page_take.rig
    curves = []
    for kind, names, values in (
        ("control", [control.name for control in rig.controls], page_take.controls),
        ("shape", [shape.name for shape in rig.shapes], page_take.weights),
    ):
        for i, name in enumerate(names if values is not None else ()):
            assert values is not None
            target = f"{kind}/{name}"
            if target not in keyed_targets and (values[:, i] != 0).any():
                curves.append(ChannelCurve(target, "", values[:, i]))
    return curves
