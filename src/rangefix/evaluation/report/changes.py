"""What changed from one folder of results to the next, run by run."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from ..comparison.compare import Comparison, Difference, compare
from ..consistency.formatting import beams_in_words, format_number
from .folders import Folder
from .tables import Cell, Line, Table, format_p_value

LONGEST_SETTING = 80  # letters of a setting that differs


class Change(NamedTuple):
    """What changed from one folder to the next.

    Attributes:
        before, after: Their letters.
        comparison: What differs.
        settings: What differs in seed, runs, versions, machine, code, a line each.
        significant: The figures that differ by more than chance, after any measurement.
        last: All figures after the last measurement.
    """

    before: str
    after: str
    comparison: Comparison
    settings: Sequence[str]
    significant: Table
    last: Table


def change(before: Folder, after: Folder) -> Change:
    """Compare run m of one folder with run m of the next."""
    comparison = compare(before.results, after.results)
    end = max((difference.step for difference in comparison.differences), default=0)
    settings = [
        f"{name}: {_brief(old)} \u2192 {_brief(new)}" for name, (old, new) in comparison.settings.items()
    ]
    for letter, pairs in ((before.letter, comparison.only_a), (after.letter, comparison.only_b)):
        settings += [f"only in {letter}: {estimator}, {beams_in_words(beams)}" for estimator, beams in pairs]
    significant = [difference for difference in comparison.differences if difference.significant]
    last = [difference for difference in comparison.differences if difference.step in (-1, end)]
    tables = (_table(before, after, differences, end > 0) for differences in (significant, last))
    return Change(before.letter, after.letter, comparison, settings, *tables)


def _table(before: Folder, after: Folder, differences: Sequence[Difference], moving: bool) -> Table:
    """A line for each figure, in groups by estimator and beams."""
    groups: dict[str, list[Line]] = {}
    for difference in differences:
        heading = f"{difference.estimator}, {beams_in_words(difference.beams)}"
        groups.setdefault(heading, []).append(_line(difference, moving))
    old, new = before.letter, after.letter
    columns = ["runs of both", old, new, f"{new} / {old}", "p", "in words"]
    return Table(columns, list(groups.items()), frozenset([len(columns) - 1]), head="figure")


def _line(difference: Difference, moving: bool) -> Line:
    """A figure in both folders; of variances the roots, headings in degrees."""
    name = difference.label_with_unit
    if moving and difference.step >= 0:
        name += f" after measurement {difference.step + 1}"
    numbers = [Cell(str(difference.runs)), *(Cell(format_number(end)) for end in difference.shown)]
    p = Cell(format_p_value(difference.adjusted))
    return Line(name, [*numbers, Cell.of(difference.ratio), p, Cell(difference.words)])


def _brief(value: object) -> str:
    text = str(value)
    return text if len(text) <= LONGEST_SETTING else f"{text[: LONGEST_SETTING - 1]}\u2026"
