"""How verdicts and figures stand in a report."""

from __future__ import annotations

from ..consistency import CERTAIN, LARGE_FACTOR, Interval, Kind, Verdict, format_factor, format_interval
from .html import Html, tag

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
        if 1 / LARGE_FACTOR <= value <= LARGE_FACTOR:
            word = f"a little {word.removeprefix('too ')}"
        if factor:
            word += f" \u00d7 {format_factor(max(value, 1 / value))}"
    mark = tag("span", sign, class_="sign", aria_hidden="true")
    return tag("span", mark, word, class_=f"badge {colour(verdict)}")


def stacked(interval: Interval) -> Html:
    """The same, with the interval small beneath."""
    value, _, ends = format_interval(interval).partition(" ")
    return tag("span", value, tag("small", ends) if ends else None, class_="stacked")
