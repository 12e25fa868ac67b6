"""Labels of frames, which `animtool.core.timecode` reads."""

from __future__ import annotations

from fractions import Fraction

from animtool.core.timecode import frames_per_day, nominal_rate

__all__ = ["timecode_label"]

# Labels that a minute leaves out, of rates that drop any.
DROPPED = {Fraction(30000, 1001): 2, Fraction(60000, 1001): 4}
# Digits of a part of a frame that is shown.
SHOWN = 6


def timecode_label(
    frames: Fraction, rate: Fraction, *, is_drop_frame: bool = False
) -> str:
    """Return the label of frames from midnight, which come back at midnight.

    Parts of a frame are rounded to a millionth; all else is exact.
    """
    count, left_out = nominal_rate(rate), DROPPED[rate] if is_drop_frame else 0
    parts = round(frames * 10**SHOWN) % (
        frames_per_day(rate, is_drop_frame=is_drop_frame) * 10**SHOWN
    )
    whole, part = divmod(parts, 10**SHOWN)
    if left_out:
        # A minute that leaves labels out is shorter by these, ten minutes by nine such.
        minute, ten = 60 * count - left_out, 600 * count - 9 * left_out
        tens, rest = divmod(whole, ten)
        within = max(0, rest - left_out) // minute
        whole += left_out * (9 * tens + within)
    seconds, frame = divmod(whole, count)
    digits = len(str(count - 1))
    shown = f"{frame:0{max(2, digits)}d}" + f".{part:0{SHOWN}d}".rstrip("0").rstrip(".")
    hours, minutes = seconds // 3600, seconds // 60 % 60
    return f"{hours:02d}:{minutes:02d}:{seconds % 60:02d}{':;'[is_drop_frame]}{shown}"
