"""How verdicts and figures stand in a report."""

from __future__ import annotations

import math

from .intervals import Interval
from .report_html import Html, tag
from .verdict import CERTAIN, MUCH, Kind, Verdict, short, times

SIGNS: dict[Kind, tuple[str, str]] = {
    "honest": ("\u2713", "honest"),
    "overconfident": ("!", "overconfident"),
    "cautious": ("\u2193", "too cautious"),
    "uneven": ("!", "uneven"),
    "biased": ("\u2192", "biased"),
    "unsure": ("?", "cannot tell"),
    "failed": ("\u00d7", "no answer"),
}


def colour(verdict: Verdict) -> str:
    """The class that colours a verdict."""
    return "overconfident" if verdict.severe else "mild" if verdict.kind == "overconfident" else verdict.kind


def badge(verdict: Verdict, factor: bool = False) -> Html:
    """Sign and word of a verdict, with its factor if asked for."""
    sign, word = SIGNS[verdict.kind]
    value = verdict.factor.value
    if verdict.kind in ("overconfident", "cautious") and 0 < value <= CERTAIN:
        if 1 / MUCH <= value <= MUCH:
            word = f"a little {word.removeprefix('too ')}"
        if factor:
            word += f" \u00d7 {times(max(value, 1 / value))}"
    mark = tag("span", sign, class_="sign", aria_hidden="true")
    return tag("span", mark, word, class_=f"badge {colour(verdict)}")


def measured(interval: Interval) -> str:
    """A figure with its interval."""
    if not math.isfinite(interval.value):
        return "\u221e" if interval.value == math.inf else "-"
    if not math.isfinite(interval.low + interval.high):
        return short(interval.value)
    return f"{short(interval.value)} [{short(interval.low)}, {short(interval.high)}]"


def scaled(interval: Interval, by: float) -> Interval:
    """The interval in another unit."""
    return Interval(*(by * end for end in interval))


def stacked(interval: Interval) -> Html:
    """The same, with the interval small beneath."""
    value, _, ends = measured(interval).partition(" ")
    return tag("span", value, tag("small", ends) if ends else None, class_="stacked")


def capital(sentence: str) -> str:
    """The sentence with a capital, and a full stop."""
    return sentence[:1].upper() + sentence[1:] + ("" if sentence.endswith((".", ":")) else ".")


def percent(share: Interval) -> str:
    """A share with its interval, in per cent."""
    if math.isnan(share.value):
        return "-"
    return f"{100 * share.value:.3g} % [{100 * share.low:.3g}, {100 * share.high:.3g}]"
