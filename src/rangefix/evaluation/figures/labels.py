"""Labels of estimators, and titles, as figures can hold them."""

from __future__ import annotations

from collections.abc import Iterable

from ..consistency import visible

LONGEST_LABEL = 40  # letters of an estimator's label in a figure


def drawable_labels(labels: Iterable[str]) -> dict[str, str]:
    """Label -> the label as a figure shows it, distinct from the others."""
    shown: dict[str, str] = {}
    for label in labels:
        plain, number = drawable_text(label), 1
        distinct = plain
        while distinct in shown.values():
            number += 1
            distinct = f"{plain} ({number})"
        shown[label] = distinct
    return shown


def drawable_text(text: str, longest: int = LONGEST_LABEL) -> str:
    """A text as a figure can hold it.

    In figures $ begins a formula, what cannot be seen has no glyph, and a long label leaves no room to draw.
    """
    shown = " ".join(visible(text).split()) or "-"
    if len(shown) > longest:  # labels of one kind often differ at their ends
        end = longest // 3
        shown = f"{shown[: longest - end - 1]}\u2026{shown[-end:]}"
    return shown.replace("$", r"\$")
