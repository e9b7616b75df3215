"""The figures of a folder, whatever it holds."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from .figures import FigureData, FigureKind
from .figures.beliefs import beliefs_figure
from .figures.catalogue import drawn, figure_kinds
from .figures.style import styled, to_png, to_svg
from .monte_carlo.one_run import OneRun
from .paper import table1
from .paper.figures import PAPER_FIGURES
from .results import FIGURES, MANIFEST, ResultsError, load, remove, write_bytes


def draw(folder: Path) -> list[Path]:
    """Draw all figures of a results folder into its folder `figures`, as PNG and SVG: all, or none.

    The same results give the same bytes with the same version of matplotlib.

    Args:
        folder: What `rangefix paper --out` or `rangefix run --out` wrote.

    Returns:
        The files written.

    Raises:
        ResultsError: If the folder holds no results, or damaged ones.
    """
    kinds: Sequence[FigureKind[Any]]
    if (folder / "table1.json").exists():
        kinds, figures = PAPER_FIGURES, drawn(PAPER_FIGURES, table1.load(folder))
    elif (folder / MANIFEST).exists():
        kinds = figure_kinds()
        figures = drawn(kinds, FigureData.of(load(folder)))
    else:
        raise ResultsError(
            f"{folder} holds no results: make some with rangefix paper or rangefix run, and --out"
        )
    with styled():
        contents = {
            folder / FIGURES / f"{kind.name}.{suffix}": to_bytes(figure)
            for kind, figure in figures
            for suffix, to_bytes in (("png", to_png), ("svg", to_svg))
        }
    known = {folder / FIGURES / f"{kind.name}.{suffix}" for kind in kinds for suffix in ("png", "svg")}
    for older in known - contents.keys():
        remove(older)
    try:
        for path, content in contents.items():
            write_bytes(path, content)
    except BaseException:  # all or none
        for path in contents:
            remove(path)
        raise
    return list(contents)


def draw_run(run: OneRun, folder: Path) -> list[Path]:
    """Draw what is believed in a run that was repeated, into the folder `figures` of a folder of results.

    Args:
        run: What `repeat_run` gave.
        folder: The folder of results, made if need be.

    Returns:
        The files written, PNG and SVG; none where the map does not tell its walls.

    Raises:
        ResultsError: If they cannot be written.
    """
    if not run.results.scene:
        return []
    with styled():
        figure = beliefs_figure(FigureData(run.results, run.number, run.pictures))
        contents = {
            folder / FIGURES / f"run-{run.number}.{suffix}": to_bytes(figure)
            for suffix, to_bytes in (("png", to_png), ("svg", to_svg))
        }
    for path, content in contents.items():
        write_bytes(path, content)
    return list(contents)
