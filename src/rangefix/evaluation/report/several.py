"""One page on several folders of results of a study: verdicts side by side, what changed, and history.

The command line calls

    path = write_comparison(folders, out)      # rangefix report A B C [--out FILE]
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

from ..consistency.formatting import beams_in_words, format_interval
from ..consistency.row import Row
from ..consistency.verdict import decide, decide_overall
from ..results import write_bytes
from .changes import Change, change
from .embedding import Mark, marks_of
from .folders import Folder, load_folders
from .history import History, histories
from .page import environment
from .tables import Cell, Line, Table

COMPARISON = "comparison.html"  # unless another file is named


@dataclass(frozen=True)
class ComparisonData:
    """All that a page shows of several folders of one study.

    Attributes:
        title: Of the study.
        folders: In the order given.
        verdicts: Of each estimator in each folder, on the whole and by set of beams.
        changes: From each folder to the next.
        histories: By set of beams.
        marks: Of the estimators that are drawn.
        estimators: How many there are.
        moving: Whether a run has several measurements.
    """

    title: str
    folders: Sequence[Folder]
    verdicts: Table
    changes: Sequence[Change]
    histories: Sequence[History]
    marks: Sequence[Mark]
    estimators: int
    moving: bool


def write_comparison(folders: Sequence[Path | str], out: Path | str | None = None) -> Path:
    """Write one page on several folders of results of the same study, in the order given.

    The same results under the same names give the same bytes with the same version of matplotlib.

    Args:
        folders: Two or more, each as for `write_report`.
        out: The file to write; comparison.html in the current folder unless given.

    Returns:
        The file written.

    Raises:
        ResultsError: If a folder holds no study, damaged results, or those of another study; or the file
            cannot be written.
        ValueError: If a folder is given twice, or one alone.
    """
    path = Path(COMPARISON if out is None else out)
    template = environment().get_template("several.html.j2")
    write_bytes(path, template.render(study=_collect(load_folders(folders))).encode("utf-8"))
    return path


def _collect(folders: Sequence[Folder]) -> ComparisonData:
    """Work out what the page shows."""
    from ..figures.data import MAX_ESTIMATORS_DRAWN

    labels = list(dict.fromkeys(label for folder in folders for label in folder.results.estimators))
    sets = list(dict.fromkeys(beams for folder in folders for beams in folder.results.beam_sets))
    drawn, manifest = labels[:MAX_ESTIMATORS_DRAWN], folders[-1].results.manifest
    return ComparisonData(
        title=str(manifest.get("title") or manifest.get("name") or "study"),
        folders=folders,
        verdicts=_verdicts(folders, labels, sets),
        changes=[change(before, after) for before, after in pairwise(folders)],
        histories=histories(folders, labels, drawn, sets),
        marks=marks_of(drawn),
        estimators=len(labels),
        moving=any(row.step for folder in folders for row in folder.rows),
    )


def _verdicts(folders: Sequence[Folder], labels: Sequence[str], sets: Sequence[str]) -> Table:
    """The verdicts of each folder side by side: on the whole and, if there are several, by set of beams."""
    whole = [
        Line(label, [_overall([row for row in each.rows if row.estimator == label]) for each in folders])
        for label in labels
    ]
    groups = [("on the whole: all sets of beams and measurements", whole)]
    groups += [
        (
            beams_in_words(beams),
            [Line(label, [_last(folder.last_row(label, beams)) for folder in folders]) for label in labels],
        )
        for beams in (sets if len(sets) > 1 else ())
    ]
    return Table([folder.letter for folder in folders], groups, frozenset(range(len(folders))))


def _overall(rows: Sequence[Row]) -> Cell:
    return Cell("", verdict=decide_overall(rows)) if rows else Cell("-")


def _last(row: Row | None) -> Cell:
    if row is None:
        return Cell("-")
    return Cell(f"ANEES / n {format_interval(row.anees)}" if row.ok else "", verdict=decide(row))
