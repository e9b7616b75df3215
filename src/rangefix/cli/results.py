"""The commands that show what came out: plot, table, report, compare, paper."""

from __future__ import annotations

import gc
import math
import os
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from .app import (
    ExitCode,
    Json,
    names_in,
    out_file,
    out_folder,
    print_json,
    refuse_other_kind,
    refuse_others,
    replacing,
    results_folder,
    say,
    warn,
)

if TYPE_CHECKING:
    from ..evaluation import Results

Folder = Annotated[Path, typer.Argument(parser=results_folder, metavar="DIR", help="Folder of results.")]

MOST_DRAWS = 1_000_000  # some minutes
OBJECTS = 100_000  # that are made before the collector of garbage looks again
FIGURE_NAMES = (
    "map, claims (covariance), anees, efficiency, errors, runs, posterior, steps, ways, ranks, time"  # ours
)


def _complete_figures(begun: str) -> list[str]:
    """The names of figures that go on after what was typed."""
    from ..evaluation.figures.catalogue import figure_kinds

    before, comma, name = begun.rpartition(",")
    names = [known for kind in figure_kinds() for known in (kind.name, *kind.other_names)]
    return [before + comma + known for known in names if known.startswith(name)]


def _be_brief() -> None:
    """Spare a process that only shows results what pays in long ones; no effect where others have begun it.

    The collector of garbage looks at all objects again and again, and figures are made of many that stay.
    """
    if "numpy" not in sys.modules:
        gc.set_threshold(OBJECTS)


def _unfinished(*folders: Path) -> list[Results]:
    """The results of the folders whose study was interrupted."""
    from ..evaluation import load
    from ..evaluation.results import MANIFEST, read_json

    manifests = [each / MANIFEST for each in folders if (each / MANIFEST).exists()]
    return [load(each.parent) for each in manifests if read_json(each).get("state") != "complete"]


def _warn_of_interruptions(*results: Results, end: bool = True) -> None:
    """Say which studies were interrupted.

    Args:
        results: The results that something was told of, each from a folder.
        end: Whether to end with a code of its own where no run of one was made.

    Raises:
        typer.Exit: If it was asked for.
    """
    for each in results:
        if each.interruption:
            warn(f"{each.folder} was {each.interruption}: what is there counts what was finished")
    if end and not all(any(each.made.values()) for each in results):
        raise typer.Exit(ExitCode.NOTHING_RAN)


def plot(
    folder: Folder,
    only: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAMES",
            autocompletion=_complete_figures,
            help="Figures to draw, joined by commas; all that there are unless given. Of a study: "
            f"{FIGURE_NAMES}.",
        ),
    ] = None,
    formats: Annotated[
        list[str] | None,
        typer.Option(
            "--format", metavar="FORMATS", help="png, svg, pdf, joined by commas; png,svg unless given."
        ),
    ] = None,
    width_mm: Annotated[
        float | None,
        typer.Option(
            "--width-mm",
            min=70,
            max=400,
            metavar="MM",
            help="Width of every figure, 70 to 400: 88 for a column, 180 for two; as wide as its panels need "
            "unless given.",
        ),
    ] = None,
    dpi: Annotated[
        float | None,
        typer.Option(
            "--dpi", min=50, max=1200, metavar="N", help="Pixels per inch, 50 to 1200; 160 unless given."
        ),
    ] = None,
    titles: Annotated[bool, typer.Option("--titles/--no-titles", help="Titles above the figures.")] = True,
    font_size: Annotated[
        float | None,
        typer.Option(
            "--font-size",
            min=5,
            max=20,
            metavar="PT",
            help="Letters of the axes' labels, 5 to 20 points; 8 with --width-mm, else 9. The smallest are a "
            "ninth smaller.",
        ),
    ] = None,
    as_json: Json = False,
) -> None:
    """Draw the figures of a folder of results anew, for the screen or for a paper."""
    _be_brief()
    from ..evaluation.drawing import USUAL, draw
    from ..evaluation.figures import Layout

    layout = Layout.in_mm(width_mm, font_size, titles=titles)
    unfinished = _unfinished(folder)
    _warn_of_interruptions(*unfinished, end=False)
    paths = draw(folder, names_in(only), names_in(formats, USUAL), layout, dpi)
    if as_json:
        print_json({"figures": [str(path) for path in paths]})
    else:
        for path in paths:
            say(path)
    if not paths:
        begun = all(any(each.made.values()) for each in unfinished)
        warn(f"{folder}: nothing to draw, as {'no run went well' if begun else 'no run was made yet'}")
        raise typer.Exit(ExitCode.NOTHING_RAN)


def table(
    folder: Folder,
    form: Annotated[
        str | None,
        typer.Option(
            "--format",
            metavar="FORMAT",
            help="latex, markdown or csv; what the name of the file ends with unless given, else markdown.",
        ),
    ] = None,
    out: Annotated[Path | None, out_file("The file to write; printed unless given.")] = None,
    as_json: Json = False,
) -> None:
    """Print the comparison of a study as a table for a paper: LaTeX, Markdown or CSV."""
    _be_brief()
    from ..evaluation import comparison_table, load
    from ..evaluation.comparison.table import SUFFIXES
    from ..evaluation.results import write_bytes

    if out is not None:
        refuse_other_kind(out, "a table", *SUFFIXES, ".txt")
    form = form or SUFFIXES.get(out.suffix.lower() if out else "", "markdown")
    with replacing(*([out] if out else []), kind=form):
        results = load(folder)
        text = comparison_table(results, form)
        if out is not None:
            write_bytes(out, text.encode("utf-8"))
    if as_json:
        print_json({"format": form, "file": str(out) if out else None, "table": text})
    else:
        for line in text.splitlines() if out is None else [str(out)]:
            say(line)
    _warn_of_interruptions(results)


def report(
    folders: Annotated[
        list[Path],
        typer.Argument(
            parser=results_folder,
            metavar="DIR...",
            help="Folder of results; or several of one study, in this order, on one page.",
        ),
    ],
    out: Annotated[
        Path | None,
        out_file("The page; DIR/report.html unless given, or comparison.html for several folders."),
    ] = None,
    as_json: Json = False,
) -> None:
    """Write one self-contained page about a folder of results, or about several of the same study."""
    _be_brief()
    from ..evaluation import write_comparison, write_report
    from ..evaluation.report.several import COMPARISON

    if out is not None:
        refuse_other_kind(out, "a page", ".html", ".htm")
    if len(folders) == 1 and out is None:
        path = write_report(folders[0])
    else:
        with replacing(out or Path(COMPARISON), kind="html"):
            path = write_report(folders[0], out) if len(folders) == 1 else write_comparison(folders, out)
    if as_json:
        print_json({"report": str(path)})
    else:
        say(path)
    _warn_of_interruptions(*_unfinished(*folders))


def compare(
    a: Annotated[Path, typer.Argument(parser=results_folder, metavar="A", help="Folder of results.")],
    b: Annotated[
        Path | None,
        typer.Argument(
            parser=results_folder, metavar="B", help="Another one; without it, the estimators of A."
        ),
    ] = None,
    fuse_std_m: Annotated[
        float | None,
        typer.Option(
            "--fuse-std-m",
            metavar="METRES",
            help="Of A alone: fuse each estimate with a second, independent position of this standard "
            "deviation along each axis, and say what the claimed covariance costs there.",
        ),
    ] = None,
    as_json: Json = False,
) -> None:
    """What differs between two results, or between the estimators of one, and what of it may be chance."""
    _be_brief()
    from ..evaluation import load
    from ..evaluation.comparison.compare import compare as compared
    from ..evaluation.comparison.compare import what_is_not_shared
    from ..filters.models.noise import check_spread

    if fuse_std_m is not None:
        if b is not None:
            raise ValueError("--fuse-std-m goes with one folder")
        if not 0 < fuse_std_m < math.inf:
            raise ValueError(f"--fuse-std-m must be positive and finite, got {fuse_std_m:g}")
        check_spread("--fuse-std-m", fuse_std_m)
        _fuse(a, fuse_std_m, as_json)
        return
    if b is None:
        _compare_estimators(a, as_json)
        return
    both = load(a), load(b)
    comparison = compared(*both)
    if apart := what_is_not_shared(*both):
        raise ValueError(f"{a} (A) and {b} (B) are not to be compared: they have {apart}")
    if as_json:
        print_json({"a": str(a), "b": str(b)} | comparison.to_json())
    else:
        from .screen import console
        from .tables.comparisons import differences, preamble

        screen = console()
        for line in preamble(comparison, str(a), str(b)):
            screen.say(line)
        screen.print(differences(comparison))
    _warn_of_interruptions(*both)


def _compare_estimators(folder: Path, as_json: bool) -> None:
    from ..evaluation import compare_estimators, load

    results = load(folder)
    pairs = compare_estimators(results)
    if as_json:
        print_json({"folder": str(folder), "pairs": [vars(pair) | {"words": pair.words} for pair in pairs]})
    elif len(results.estimators) < 2:
        say(f"{results.estimators[0]} is alone in {folder}: there is no other estimator to compare it with")
    elif pairs or not results.interruption:
        from .screen import console
        from .tables.comparisons import accuracy, accuracy_in_words

        screen = console()
        screen.print(accuracy(pairs))
        for line in accuracy_in_words(pairs):
            screen.say(line)
    _warn_of_interruptions(results)


def _fuse(a: Path, std: float, as_json: bool) -> None:
    from ..evaluation import fuse_estimates, load

    results = load(a)
    _warn_of_interruptions(results)
    found = fuse_estimates(results, std)
    if as_json:
        print_json({"folder": str(a), "fusions": [vars(each) | {"price": each.price} for each in found]})
        return
    from .screen import console
    from .tables.comparisons import fusions

    screen = console()
    screen.print(fusions(found))
    screen.say(
        "Fused by the claimed covariances, and by the true one of all runs; the price is the difference. It "
        "is negative where claims tell good runs from bad ones."
    )


def paper(
    out: Annotated[Path | None, out_folder("Folder for the table, the posteriors and figures.")] = None,
    as_json: Json = False,
    draws: Annotated[
        int, typer.Option(min=20, max=MOST_DRAWS, metavar="N", help="Noise draws for the bands.")
    ] = 1000,
    seed: Annotated[
        int, typer.Option("--seed", "-s", min=0, metavar="N", help="Seed of the noise draws.")
    ] = 0,
) -> None:
    """The table and figures of the paper of Stepanov and Mansour."""
    from ..evaluation.paper import save, solve

    files = [] if out is None else [out / "table1.json", out / "paper.npz"]
    for path in filter(os.path.lexists, files):  # before it takes minutes
        refuse_others(path, path.suffix[1:], ())
    solved = solve(draws, seed)
    if out is not None:
        from ..evaluation.drawing import draw

        save(solved, out)
        draw(out)
    if as_json:
        print_json(solved.to_json())
        return
    from .screen import console
    from .tables.paper import table1, table1_notes

    screen = console()
    screen.print(table1(solved))
    for note in table1_notes(solved):
        screen.say(note)
    if out is not None:
        screen.say(f"Figures: {out / 'figures'}")
