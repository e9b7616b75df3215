"""The figures of a folder, whatever it holds."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..errors import suggestion
from .figures import FigureData, FigureKind, Layout
from .figures.beliefs import draw_posterior
from .figures.catalogue import alone, chosen, figure_kinds, why_lacking
from .figures.files import FORMATS, encoded
from .figures.style import styled
from .results import FIGURES, MANIFEST, ResultsError, load, remove, write_bytes

if TYPE_CHECKING:
    from .monte_carlo.one_run import OneRun

USUAL = ("png", "svg")  # formats, unless others are asked for


def draw(
    folder: Path,
    only: Sequence[str] = (),
    formats: Sequence[str] = USUAL,
    layout: Layout | None = None,
    dpi: float | None = None,
) -> list[Path]:
    """Draw figures of a results folder into its folder `figures`: all that are asked for, or none.

    The same results give the same bytes with the same version of matplotlib.

    Args:
        folder: What `rangefix paper --out` or `rangefix run --out` wrote.
        only: Names of figures; all that the results have unless given.
        formats: Of "png", "svg" and "pdf".
        layout: How wide they are, and how large their letters.
        dpi: Pixels per inch.

    Returns:
        The files written.

    Raises:
        ResultsError: If the folder holds no results, or damaged ones, or not what a figure that is asked for
            shows; if there is no such figure; if it would have too many pixels; if it cannot be written.
    """
    for suffix in formats:
        if suffix not in FORMATS:
            raise ResultsError(f"there is no format {suffix!r}; {suggestion(suffix, FORMATS)}")
    kinds: Sequence[FigureKind[Any]]
    data: Callable[[], Any]  # of the kinds of figures
    if (folder / "table1.json").exists():
        from .paper import table1  # brings maps, which figures of a study need not
        from .paper.figures import PAPER_FIGURES, PaperData

        kinds, data = PAPER_FIGURES, lambda: PaperData(table1.load(folder), layout or Layout())
    elif (folder / MANIFEST).exists():
        kinds, data = figure_kinds(), lambda: FigureData.of(load(folder), layout)
    else:
        raise ResultsError(
            f"{folder} holds no results: make some with rangefix paper or rangefix run, and --out"
        )
    if only:
        kinds = chosen(kinds, only)
    contents: dict[Path, bytes] = {}
    with styled(layout):
        shown: Any = data()
        if only and (absent := [kind for kind in kinds if not kind.needs(shown)]):
            raise ResultsError(f"{folder} has no figure {absent[0].name!r}: {why_lacking(absent[0], shown)}")
        for kind in kinds:
            if kind.needs(shown):
                made = encoded(kind.draw(shown), formats, dpi)
                contents |= _by_path(folder, kind.name, made)
    for older in {folder / FIGURES / f"{kind.name}.{suffix}" for kind in kinds for suffix in formats}:
        if older not in contents:
            remove(older)
    try:
        for path, content in contents.items():
            write_bytes(path, content)
    except BaseException:  # all or none
        for path in contents:
            remove(path)
        raise
    return list(contents)


def _by_path(folder: Path, name: str, made: Mapping[str, bytes]) -> dict[Path, bytes]:
    """Path -> content of the files of a figure."""
    return {folder / FIGURES / f"{name}.{suffix}": content for suffix, content in made.items()}


def draw_run(run: OneRun, folder: Path) -> list[Path]:
    """Draw what is believed in a run that was repeated, into the folder `figures` of a folder of results.

    Args:
        run: What `repeat_run` gave.
        folder: The folder of results, made if need be.

    Returns:
        The files written, PNG and SVG; none where the map does not tell its walls, or no estimator answered.

    Raises:
        ResultsError: If they cannot be written.
    """
    if not run.results.scene:
        return []
    with styled():
        data = FigureData(run.results, run.number, run.pictures)
        if not data.has_answers():
            return []
        contents = _by_path(folder, f"run-{run.number}", encoded(alone(draw_posterior)(data), USUAL))
    for path, content in contents.items():
        write_bytes(path, content)
    return list(contents)
