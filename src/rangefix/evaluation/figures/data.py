"""What the figures of a study are drawn from: its results, their rows, and labels that a figure can hold."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from ..consistency.formatting import beams_in_words, visible
from ..consistency.row import Row
from ..consistency.summarise import summarise
from ..results import Picture, Results, load_pictures
from .layout import Layout

LONGEST_LABEL = 40  # letters of an estimator's label in a figure
MOST_LEFT_OUT = 8  # labels of what is not drawn, of either reason; tables have them all
MAX_ESTIMATORS_DRAWN = 24  # of more, panels are too small to be read; tables have them all


@dataclass(frozen=True)
class FigureData:
    """A study as figures see it.

    Attributes:
        results: Its results, under the labels that users chose.
        run: The number of their first run.
        images: Pictures of beliefs in that run; those of the folder unless given.
        estimators: How many estimators the study has; 0 where all of them are in the results.
        layout: How wide the figures are, and how large their letters.
        chosen_beams: The set of beams of figures that show one alone; the last unless given.
    """

    results: Results
    run: int = 0
    images: tuple[Picture, ...] | None = None
    estimators: int = 0
    layout: Layout = field(default_factory=Layout)
    chosen_beams: str | None = None

    @classmethod
    def of(cls, results: Results, layout: Layout | None = None) -> FigureData:
        """The results of all estimators, or of the first where there are too many to be drawn."""
        count, layout = len(results.estimators), layout or Layout()
        if count <= MAX_ESTIMATORS_DRAWN:
            return cls(results, layout=layout)
        few = replace(results, estimators=results.estimators[:MAX_ESTIMATORS_DRAWN])
        return cls(few, estimators=count, layout=layout)

    @cached_property
    def labels(self) -> dict[str, str]:
        """Label of an estimator -> that label as a figure can hold it, without formulas, and not too long."""
        return drawable_labels(self.results.estimators)

    @cached_property
    def rows(self) -> list[Row]:
        """All rows, under labels that a figure can hold."""
        return [replace(row, estimator=self.labels[row.estimator]) for row in summarise(self.results)]

    @cached_property
    def last_rows(self) -> list[Row]:
        """The rows after the last measurement, all estimators of a beam set together."""
        end = max(row.step for row in self.rows)
        sets = self.results.beam_sets
        return sorted((row for row in self.rows if row.step == end), key=lambda row: sets.index(row.beams))

    @property
    def pictures(self) -> dict[str, Picture]:
        """Estimator -> picture of its belief in the first run, where there is one of these beams."""
        return self._pictures if self.beams == self.results.beam_sets[-1] else {}

    @cached_property
    def _pictures(self) -> dict[str, Picture]:
        """The same of the last set of beams, of which they are kept."""
        folder = self.results.folder
        saved = load_pictures(folder) if folder and self.images is None else self.images or ()
        return {picture.estimator: picture for picture in saved}

    @property
    def beams(self) -> str:
        """The set of beams of figures that show one alone."""
        return self.results.beam_sets[-1] if self.chosen_beams is None else self.chosen_beams

    @cached_property
    def answering(self) -> list[str]:
        """The estimators, as users call them, of which a run on that set of beams went well."""
        ok = {row.estimator for row in self.last_rows if row.ok and row.beams == self.beams}
        return [estimator for estimator in self.results.estimators if self.labels[estimator] in ok]

    def silence(self, estimator: str) -> tuple[str, ...]:
        """What a panel of the first run says of an estimator that gave no answer there; nothing if it did."""
        return () if self.results.get(estimator, self.beams).ok[0] else ("no answer in this run",)

    @property
    def silent(self) -> str:
        """Which estimators a figure of that set of beams leaves out, and why; "" if none."""
        return _left_out([row for row in self.last_rows if row.beams == self.beams and not row.ok], 1)

    @cached_property
    def drawn_rows(self) -> list[Row]:
        """The last rows of which a run went well."""
        return [row for row in self.last_rows if row.ok]

    @cached_property
    def bounded_rows(self) -> list[Row]:
        """The same of which it is known how good anybody could be."""
        return [row for row in self.drawn_rows if row.bound is not None]

    @cached_property
    def timed_rows(self) -> list[Row]:
        """The last rows on the set of beams that is shown, of estimators that were timed and answered."""
        return [row for row in self.drawn_rows if row.beams == self.beams and np.isfinite(row.seconds)]

    @property
    def untimed(self) -> str:
        """Which estimators answered and were not timed; "" if none."""
        timed = {row.estimator for row in self.timed_rows}
        told = ", ".join(label for each in self.answering if (label := self.labels[each]) not in timed)
        return f"Not timed: {told}." if told else ""

    @property
    def silent_rows(self) -> str:
        """Which rows a figure of all sets of beams leaves out, and why; "" if none."""
        return _left_out([row for row in self.last_rows if not row.ok], len(self.results.beam_sets))

    @property
    def study(self) -> str:
        """The title of the study and its runs, as they stand over every figure."""
        manifest = self.results.manifest
        name = str(manifest.get("title") or manifest.get("name") or "study")
        runs = f"{self.results.runs} runs" if self.results.runs > 1 else f"run {self.run}"
        if self.estimators:
            runs += f"; the first {len(self.results.estimators)} of {self.estimators} estimators"
        return f"{drawable_text(name, 2 * LONGEST_LABEL)} ({runs})"

    def heading(self, text: str, *, with_beams: bool = False) -> str:
        """The title over a figure: a text, the set of beams if asked for, and below it the study."""
        return f"{text}{f', {beams_in_words(self.beams)}' if with_beams else ''}\n{self.study}"

    def has_map(self) -> bool:
        """Whether the map was saved."""
        return bool(self.results.scene)

    def has_rows(self) -> bool:
        """Whether a run of any estimator went well."""
        return bool(self.drawn_rows)

    def has_bounds(self) -> bool:
        """Whether it is known of any row how good anybody could be."""
        return bool(self.bounded_rows)

    def has_answers(self) -> bool:
        """Whether a run of any estimator on the set of beams that is shown went well."""
        return bool(self.answering)

    def has_pictures(self) -> bool:
        """Whether there are pictures of beliefs, and a map to draw them in."""
        return self.has_map() and bool(self._pictures) and self.has_answers()

    def has_steps(self) -> bool:
        """Whether a run has several measurements, and went well."""
        return any(row.step for row in self.rows) and self.has_answers()

    def has_ways(self) -> bool:
        """Whether objects moved in a map, and an estimator has followed them."""
        return self.has_steps() and self.has_map()

    def has_samples(self) -> bool:
        """Whether the beliefs on the set of beams that is shown were sampled."""
        return any(row.beliefs for row in self.drawn_rows if row.beams == self.beams)

    @property
    def is_begun(self) -> bool:
        """Whether any run was made: none may be where the study was interrupted."""
        return any(self.results.made.values())

    def has_times(self) -> bool:
        """Whether an estimator that answered on the set of beams that is shown was timed."""
        return bool(self.timed_rows)


def _left_out(rows: Sequence[Row], sets: int) -> str:
    """Which rows a figure leaves out and why: they have not run yet, or no run went well; "" if none.

    Args:
        rows: The rows.
        sets: How many sets of beams it shows; an estimator that is left out of all of them is named once.
    """
    reasons = {
        "no run went well": [row for row in rows if row.made],
        "they have not run yet": [row for row in rows if not row.made],
    }
    told = []
    for why, left in reasons.items():
        count = Counter(row.estimator for row in left)
        names = list(
            dict.fromkeys(
                row.estimator
                if count[row.estimator] == sets
                else f"{row.estimator} ({beams_in_words(row.beams)})"
                for row in left
            )
        )
        more = f" and {len(names) - MOST_LEFT_OUT} more" if len(names) > MOST_LEFT_OUT else ""
        if names:
            told.append(f"Not drawn, as {why}: {', '.join(names[:MOST_LEFT_OUT])}{more}.")
    return " ".join(told)


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
