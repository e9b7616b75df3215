"""The commands `estimators` and `check`, and how options are read."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Iterable
from typing import Annotated, Any

import typer

from .app import ExitCode, Json, print_json


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
    from ..evaluation.isolation.checks import run_checks_isolated
    from ..filters.checks import conforms, sum_up, told

    options, reasons = read_options(option or ()), read_reasons(expect_failure or ())
    results = []
    for result in run_checks_isolated(target, options, reasons, timeout):
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
        raise typer.Exit(ExitCode.SOME_FAILED)


def estimators(as_json: Json = False) -> None:
    """The estimators that there are, with their options."""
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


def describe() -> list[dict[str, Any]]:
    """Name, first line of the docstring and options (with defaults) of each estimator.

    Plug-ins are imported in processes of their own; one that cannot be has a fault that says why.
    """
    from ..evaluation.isolation import signature_of as look_at
    from ..evaluation.isolation.look import inspect_plugin
    from ..filters import available
    from ..filters.registry import BUILT_IN, resolve

    described = []
    for name in available():
        seen = look_at(name, resolve(name)) if name in BUILT_IN else inspect_plugin(name)
        row = {"name": name, "summary": seen.summary, "options": dict(seen.parameters)}
        described.append(row | ({"fault": seen.fault} if seen.fault else {}))
    return described


def read_options(given: Iterable[str]) -> dict[str, Any]:
    """Options written as in a study, NAME=VALUE, in m and rad.

    Raises:
        ValueError: If one has no value, or one that a study would not take.
    """
    from ..evaluation.study import EstimatorSection

    options: dict[str, Any] = {}
    for each in given:
        name, equals, value = each.partition("=")
        try:
            options[name.strip()] = tomllib.loads(f"value = {value}")["value"]
        except tomllib.TOMLDecodeError:
            if not equals or not re.fullmatch(r"\s*[A-Za-z][\w.-]*\s*", value):
                raise ValueError(
                    f"--option {each!r}: write NAME=VALUE as in a study, such as cell_m=0.05"
                ) from None
            options[name.strip()] = value.strip()  # a word without quotation marks
    return EstimatorSection(name="-", options=options).converted()


def read_reasons(given: Iterable[str]) -> dict[str, str]:
    """Checks that are expected to fail, CHECK=REASON.

    Raises:
        ValueError: If one has no reason.
    """
    reasons = {}
    for each in given:
        name, equals, reason = each.partition("=")
        if not equals or not reason.strip():
            raise ValueError(f"--expect-failure {each!r}: write CHECK=REASON, the reason in quotation marks")
        reasons[name.strip()] = reason.strip()
    return reasons
