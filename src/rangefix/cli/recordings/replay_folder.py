"""The folder that a replay writes into: nothing there is lost but what an earlier replay wrote."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from os import getpid
from os.path import lexists
from pathlib import Path
from shutil import rmtree
from typing import Any

from ...evaluation.recordings.log import RecordingError
from ...evaluation.results.files import ResultsError, read_json

TABLE = "replay.json"  # of a folder: it names the files beside it


@dataclass(frozen=True)
class ReplayFolder:
    """A folder, and what is written into it besides poses, figures and the table.

    Attributes:
        path: The folder.
        bag: Kind of bag, if any.
        animation: Suffix of the animations, if there are any.
    """

    path: Path
    bag: str | None = None
    animation: str | None = None

    def refuse_losses(self, names: Sequence[str], read: Iterable[object]) -> None:
        """Refuse what a replay would remove or write over and is read, or no replay wrote: before it begins.

        Args:
            names: How the files of each estimator are called, without suffix.
            read: Files, folders and other names that the command reads.

        Raises:
            RecordingError: If something that would be lost is there.
        """
        if not self.path.is_dir():
            return
        ends = ["_errors.png", "_errors.svg", "_beliefs.png", "_beliefs.svg", ".tum", ".csv"]
        ends += [".bag" if self.bag == "bag" else f"_{self.bag}"] if self.bag else []
        ends += [f".{self.animation}"] if self.animation else []
        ours = [f"{figure}.{suffix}" for figure in ("paths", "fit") for suffix in ("png", "svg")]
        ours += [name + end for name in names for end in ends]
        table = self._table()
        before = self._named_by(table)
        places = [Path(str(each)).resolve() for each in read]
        for path in (*before, *(self.path / name for name in (*ours, TABLE))):
            if any(path.resolve() in (place, *place.parents) for place in places if place.exists()):
                raise RecordingError(f"{path} is what is read: choose another --out")
        lost = [path for name in ours if lexists(path := self.path / name) and path not in before]
        if lexists(self.path / TABLE) and not _is_table(table):
            lost.append(self.path / TABLE)
        if lost:
            text = f"{lost[0]} is there and no replay wrote it: choose another --out, or remove it"
            raise RecordingError(text)

    @contextmanager
    def written(self) -> Iterator[Path]:
        """A folder to write into, whose files come to this one as they are whole; nothing comes if it fails.

        The files that an earlier replay wrote here, by its table, go; all others stay.
        """
        part = self.path.with_name(f".{self.path.name}.{getpid()}.part")
        with ExitStack() as stack:
            try:
                part.mkdir(parents=True)
                stack.callback(rmtree, part, ignore_errors=True)
                yield part
                self.path.mkdir(parents=True, exist_ok=True)
                for older in self._named_by(self._table()):
                    if older.is_symlink() or not older.is_dir():
                        older.unlink()
                    elif (older / "metadata.yaml").is_file():  # a bag
                        rmtree(older)
                files = list(part.iterdir())
                files.sort(key=lambda path: path.name != TABLE)  # first the table, which names the others
                for path in files:
                    goal = self.path / path.name
                    if goal.is_dir():
                        rmtree(goal)
                    path.replace(goal)
            except OSError as error:
                raise RecordingError(f"cannot write {self.path}: {error.strerror or error}") from None

    def _table(self) -> Any:
        """What stands in the table of an earlier replay; None if there is none that can be read."""
        try:
            return read_json(self.path / TABLE)
        except ResultsError:
            return None

    def _named_by(self, table: Any) -> list[Path]:
        """What lies in the folder and is named by such a table."""
        names = table.get("files") if isinstance(table, dict) else None
        return [path for path in self.path.iterdir() if path.name in names] if isinstance(names, list) else []


def _is_table(document: Any) -> bool:
    """Whether a document is the table of a replay."""
    return isinstance(document, dict) and {"rangefix", "estimators", "files"} <= document.keys()
