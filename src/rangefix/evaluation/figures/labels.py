"""Labels of estimators, and titles, as figures can hold them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

from ...arrays import Array
from ..consistency import visible
from ..results import Results, Source, Trials

LONGEST = 40  # letters of a label in a figure


def drawable(results: Results) -> tuple[Results, dict[str, str]]:
    """The same results under labels that a figure can hold, and label -> label in figures.

    In figures $ begins a formula, what cannot be seen has no glyph, and a long label leaves no room to draw.
    """
    labels: dict[str, str] = {}
    for label in results.estimators:
        labels[label] = _distinct(_plain(label, LONGEST), set(labels.values()))
    title = _plain(str(results.manifest.get("title") or results.manifest.get("name") or "study"), 2 * LONGEST)
    manifest = results.manifest | {"title": title}
    if all(label == plain for label, plain in labels.items()):
        return replace(results, manifest=manifest), labels
    shown = replace(
        results,
        manifest=manifest,
        estimators=tuple(labels.values()),
        source=Renamed(results.source, {plain: label for label, plain in labels.items()}),
        timing={(labels.get(name, name), beams): time for (name, beams), time in results.timing.items()},
    )
    return shown, labels


def _plain(label: str, longest: int) -> str:
    shown = " ".join(visible(label).split()) or "-"
    if len(shown) > longest:  # labels of one kind often differ at their ends
        end = longest // 3
        shown = f"{shown[: longest - end - 1]}\u2026{shown[-end:]}"
    return shown.replace("$", r"\$")


def _distinct(label: str, taken: set[str]) -> str:
    number, found = 1, label
    while found in taken:
        number += 1
        found = f"{label} ({number})"
    return found


@dataclass(frozen=True)
class Renamed:
    """A source whose estimators go by other labels: new label -> label in the source."""

    source: Source
    labels: Mapping[str, str]

    def world(self, first: int, end: int) -> tuple[Array, Array]:
        """True states and measurements, as they are."""
        return self.source.world(first, end)

    def trials(self, estimator: str, beams: str, first: int, end: int) -> Trials:
        """Trials under the new label."""
        return replace(self.source.trials(self.labels[estimator], beams, first, end), estimator=estimator)
