"""The commands before and after a run: new, check, estimators; plot, report, compare."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from .application import SOME_FAILED, Json, app, print_json


@app.command()
def new(
    study: Annotated[Path, typer.Argument(metavar="STUDY", help="The file to write.")], as_json: Json = False
) -> None:
    """Write a commented study to begin with."""
    from .starting import new_study

    path = new_study(study)
    if as_json:
        print_json({"study": str(path)})
    else:
        typer.echo(f"{path}   Run it: rangefix run {path}")


@app.command()
def check(
    target: Annotated[str, typer.Argument(help="A name, module:function, or path/file.py:function.")],
    option: Annotated[
        list[str] | None,
        typer.Option(metavar="NAME=VALUE", help="An option, as in a study: cell_m=0.05; may be repeated."),
    ] = None,
    expect_failure: Annotated[
        list[str] | None,
        typer.Option(metavar="CHECK=REASON", help="A check that must fail, and why; may be repeated."),
    ] = None,
    timeout: Annotated[
        float, typer.Option(min=0.1, metavar="SECONDS", help="Longest that a check may take.")
    ] = 60.0,
    as_json: Json = False,
) -> None:
    """Whether an estimator does what every estimator must; exit code 1 if not."""
    from .evaluation.checked import check_apart
    from .filters.checks import conforms, sum_up, told
    from .starting import read_options, read_reasons

    options, reasons = read_options(option or ()), read_reasons(expect_failure or ())
    results = []
    for result in check_apart(target, options, reasons, timeout):
        results.append(result)
        for line in () if as_json else told(result):
            typer.echo(line)
    if as_json:
        print_json(
            {"target": target, "conforms": conforms(results), "checks": [vars(each) for each in results]}
        )
    else:
        typer.echo(sum_up(results))
    if not conforms(results):
        raise typer.Exit(SOME_FAILED)


@app.command()
def estimators(as_json: Json = False) -> None:
    """The estimators that there are, with their options."""
    from .listing import describe

    described = describe()
    if as_json:
        print_json({"estimators": described})
        return
    for each in described:
        if "fault" in each:
            typer.echo(f"{each['name']:<12} cannot be used: {each['fault']}")
            continue
        listed = ", ".join(f"{name}={value}" for name, value in each["options"].items())
        typer.echo(f"{each['name']:<12} {each['summary']}\n{'':<12} options: {listed or 'none'}")


@app.command()
def plot(folder: Annotated[Path, typer.Argument(help="Folder of results.")], as_json: Json = False) -> None:
    """Draw the figures of a folder of results anew."""
    from .evaluation.plots import draw

    paths = draw(folder)
    if as_json:
        print_json({"figures": [str(path) for path in paths]})
        return
    for path in paths:
        typer.echo(path)


@app.command()
def report(
    folder: Annotated[Path, typer.Argument(help="Folder of results.")],
    out: Annotated[Path | None, typer.Option(help="The page; DIR/report.html unless given.")] = None,
    as_json: Json = False,
) -> None:
    """Write one self-contained page about a folder of results."""
    from .evaluation.report import write_report

    path = write_report(folder, out)
    if as_json:
        print_json({"report": str(path)})
    else:
        typer.echo(path)


@app.command()
def compare(
    a: Annotated[Path, typer.Argument(metavar="A", help="Folder of results.")],
    b: Annotated[Path, typer.Argument(metavar="B", help="Another one.")],
    as_json: Json = False,
) -> None:
    """What differs between two results, in config, versions and numbers, and what of it may be chance."""
    from .evaluation.compare import compare as compared
    from .evaluation.results import load

    comparison = compared(load(a), load(b))
    if as_json:
        print_json({"a": str(a), "b": str(b)} | comparison.to_json())
        return
    from .differences import differences, preamble
    from .tables import console

    screen = console()
    for line in preamble(comparison, str(a), str(b)):
        screen.print(line, markup=False, soft_wrap=True)
    screen.print(differences(comparison))
