"""One self-contained HTML page on a study: verdict, table, figures, details, failures, provenance.

The page loads nothing and runs nothing; it follows the reader's light or dark setting, fits a telephone and
prints. docs/report.md tells how to read it. The command line calls

    path = write_report(folder, out)      # rangefix report DIR [--out FILE]
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from ..consistency import Gate
from ..results import Results, load, write_bytes
from .data import collect
from .details import charts, details
from .html import page, tag
from .pictures import pictures
from .scores import scores
from .sections import failures, heading, provenance, table, verdicts

SECTIONS = ("verdict", "table", "scores", "charts", "pictures", "estimators", "failures", "provenance")


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
    path = Path(folder) / "report.html" if out is None else Path(out)
    write_bytes(path, render(load(folder), gates).encode("utf-8"))
    return path


def render(results: Results, gates: Sequence[Gate] = ()) -> str:
    """The page."""
    found = collect(results, gates)
    manifest = results.manifest
    version = (manifest.get("versions") or {}).get("rangefix", "")
    body = [
        heading(found),
        tag("nav", (tag("a", name, href=f"#{name}") for name in SECTIONS), aria_label="Sections"),
        tag(
            "main",
            verdicts(found),
            table(found),
            scores(found),
            charts(found),
            pictures(results),
            details(found),
            failures(found),
            provenance(found),
        ),
        tag("footer", f"Written by rangefix {version}"),
    ]
    style = Path(__file__).with_name("style.css").read_text(encoding="utf-8")
    return page(f"{manifest.get('title') or manifest.get('name') or 'study'} - rangefix", style, body)
