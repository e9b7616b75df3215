"""Folders of results of one study as a page names them, in the order in which they were given."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

from ..consistency.row import Row
from ..consistency.summarise import summarise
from ..results import Results, ResultsError, load

LETTERS = "ABCDEFGHIJKLMNOPQRSTUVWXYZ"
LONGEST_VERSION = 12  # letters of a version below a tick


class Folder(NamedTuple):
    """A folder of results.

    Attributes:
        letter: What it is called on the page; a number where there are more than letters.
        path: As it was given.
        results: What it holds.
        rows: Of its results.
    """

    letter: str
    path: str
    results: Results
    rows: Sequence[Row]

    @property
    def date(self) -> str:
        """When it was run, to the minute, UTC."""
        return str(self.results.manifest.get("date", ""))[:16].replace("T", " ")

    @property
    def version(self) -> str:
        """Of rangefix."""
        return str((self.results.manifest.get("versions") or {}).get("rangefix") or "")

    @property
    def commit(self) -> str:
        """Of the checkout, if it was one."""
        git = self.results.manifest.get("git") or {}
        return f"{git.get('commit', '')[:10]}{' with local changes' if git.get('dirty') else ''}"

    @property
    def tick(self) -> str:
        """Its label in a figure: letter, day and version."""
        return "\n".join(filter(None, (self.letter, self.date[:10], self.version[:LONGEST_VERSION])))

    def last_row(self, estimator: str, beams: str) -> Row | None:
        """The row after the last measurement, if there is one."""
        found = [row for row in self.rows if (row.estimator, row.beams) == (estimator, beams)]
        return found[-1] if found else None


def load_folders(paths: Sequence[Path | str]) -> list[Folder]:
    """Read folders of results.

    Raises:
        ResultsError: If one holds no study, damaged results, or those of another study than the first.
        ValueError: If there are fewer than two, or one is given twice.
    """
    if len(paths) < 2:
        raise ValueError("a comparison needs two folders of results at least")
    places = [Path(path).resolve() for path in paths]
    folders: list[Folder] = []
    for number, path in enumerate(paths):
        if places[number] in places[:number]:
            raise ValueError(f"{path} is given twice")
        results = load(path)
        if folders:
            _need_same_study(folders[0], path, results)
        letter = LETTERS[number] if len(paths) <= len(LETTERS) else str(number + 1)
        folders.append(Folder(letter, str(path), results, summarise(results)))
    return folders


def _need_same_study(first: Folder, path: Path | str, results: Results) -> None:
    """Refuse a folder of another study."""
    name, other = (each.manifest.get("name") for each in (first.results, results))
    if name != other:
        told = f"{other!r}, and {first.path} of {name!r}"
        raise ResultsError(f"{path} holds results of another study: they are of {told}")
    names, others = (", ".join(each.space.names) for each in (first.results, results))
    if names != others:
        told = f"its states are {others}, those of {first.path} {names}"
        raise ResultsError(f"{path} holds results of another study: {told}")
