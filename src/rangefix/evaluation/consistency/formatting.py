"""Numbers, units and beams in words: headings in degrees, all else as computed."""

from __future__ import annotations

import math
import unicodedata

from .intervals import Interval

HARMLESS = "\n\t\u200d"  # of the characters that cannot be seen


def unit(name: str) -> str:
    """The unit in which a component is shown."""
    return {"heading": "deg", "v1": "m/s", "v2": "m/s"}.get(name, "m")


def factor(name: str) -> float:
    """By how much a figure of a component, in m, m/s or rad, is multiplied to be shown."""
    return math.degrees(1.0) if name == "heading" else 1.0


def format_percent(share: float) -> str:
    """A share in per cent, to two digits."""
    return f"{format_factor(100 * share)} %"


def format_factor(value: float) -> str:
    """A factor to two digits, or to three from 100."""
    return f"{value:.0f}" if value >= 9.5 else f"{value:.2g}"


def beams_in_words(label: str) -> str:
    """The label of a set of beams in words: "1" -> "beam 1", "1+2" -> "beams 1 + 2"."""
    if label == "all":
        return "all beams"
    several = "+" in label or "-" in label
    return f"beam{'s' * several} {label.replace('+', ' + ')}"


def format_number(value: float) -> str:
    """Three digits, and no powers of ten below a million; "-" for what is not a number."""
    if math.isnan(value):
        return "-"
    return f"{value:.0f}" if 100 <= abs(value) < 1e6 else f"{value:.3g}"


def visible(value: object) -> str:
    """Anything as text; what could turn, hide or end other text is shown as a replacement character."""
    text = str(value)
    if text.isprintable():  # as nearly all is
        return text
    return "".join(
        "\ufffd" if unicodedata.category(each) in ("Cc", "Cf", "Cs") and each not in HARMLESS else each
        for each in text
    )


def format_interval(interval: Interval) -> str:
    """A figure with its interval."""
    if not math.isfinite(interval.value):
        return "\u221e" if interval.value == math.inf else "-"
    if not math.isfinite(interval.low + interval.high):
        return format_number(interval.value)
    return f"{format_number(interval.value)} [{format_number(interval.low)}, {format_number(interval.high)}]"


def scaled(interval: Interval, by: float) -> Interval:
    """The interval in another unit."""
    return Interval(*(by * end for end in interval))


def capital(sentence: str) -> str:
    """The sentence with a capital, and a full stop."""
    return sentence[:1].upper() + sentence[1:] + ("" if sentence.endswith((".", ":")) else ".")
