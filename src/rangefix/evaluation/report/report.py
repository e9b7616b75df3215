"""One self-contained HTML page on a study: verdict, where it fails, table, figures, details, provenance.

The page loads nothing. One script of ours, which the page's policy knows by its hash, sorts tables and says
what the pointer is at; the page is whole without it. It follows the reader's light or dark setting, fits a
telephone and prints. docs/report.md tells how to read it; `page.html.j2` is its text, `style.css` its looks.
The command line calls

    path = write_report(folder, out)      # rangefix report DIR [--out FILE]
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from ..consistency.gates import Gate
from ..results import REPORT, Results, load, write_bytes
from .data import collect
from .embedding import figures
from .page import environment


def write_report(folder: Path | str, out: Path | str | None = None, gates: Sequence[Gate] = ()) -> Path:
    """Write the report of a folder of results.

    The same results give the same bytes with the same version of matplotlib.

    Args:
        folder: What `rangefix run --out` wrote; an interrupted study is reported as far as it came.
        out: The file to write; FOLDER/report.html unless given.
        gates: Conditions whose outcome is to stand in it: see `gates.parse_gates`.

    Returns:
        The file written.

    Raises:
        ResultsError: If the folder holds no study, or damaged results, or the file cannot be written.
        ValueError: If a gate names what is not there.
    """
    path = Path(folder) / REPORT if out is None else Path(out)
    write_bytes(path, render(load(folder), gates).encode("utf-8"))
    return path


def render(results: Results, gates: Sequence[Gate] = ()) -> str:
    """The page."""
    template = environment().get_template("page.html.j2")
    return template.render(study=collect(results, gates), figures=list(figures(results)))
