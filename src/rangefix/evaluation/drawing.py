"""The figures of a folder, whatever it holds."""

from __future__ import annotations

from pathlib import Path

from .figures import drawn, study_figures, styled, write
from .paper import table1
from .paper.figures import PAPER_FIGURES
from .results import ResultsError, load


def draw(folder: Path) -> list[Path]:
    """Draw all figures of a results folder into its folder `figures`, as PNG and SVG.

    The same results give the same bytes with the same version of matplotlib.

    Args:
        folder: What `rangefix paper --out` or `rangefix run --out` wrote.

    Returns:
        The files written.

    Raises:
        ResultsError: If the folder holds no results, or damaged ones.
    """
    if (folder / "table1.json").is_file():
        figures = drawn(PAPER_FIGURES, table1.load(folder))
    elif (folder / "manifest.json").is_file():
        figures = study_figures(load(folder))
    else:
        raise ResultsError(
            f"{folder} holds no results: make some with rangefix paper or rangefix run, and --out"
        )
    with styled():
        return [path for kind, figure in figures for path in write(figure, folder / "figures", kind.name)]
