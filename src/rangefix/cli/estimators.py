"""The commands `estimators` and `check`, and how options are read."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Iterable
from typing import Annotated, Any

import typer

from .app import ExitCode, Json, print_json, say


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
    from ..filters.checks import conforms, lines_of, sum_up

    options, reasons = read_options(option or ()), read_reasons(expect_failure or ())
    results = []
    for result in run_checks_isolated(target, options, reasons, timeout):
        results.append(result)
        for line in () if as_json else lines_of(result):
            say(line)
    if as_json:
        checks = [vars(result) for result in results]
        print_json({"target": target, "conforms": conforms(results), "checks": checks})
    else:
        say(sum_up(results))
    if not conforms(results):
        raise typer.Exit(ExitCode.SOME_FAILED)


def estimators(
    no_plugins: Annotated[
        bool, typer.Option("--no-plugins", help="Leave out those of other packages, which are imported here.")
    ] = False,
    as_json: Json = False,
) -> None:
    """The estimators that there are, with their options."""
    from ..evaluation.isolation import signature_of
    from ..evaluation.isolation.look import inspect_plugin
    from ..filters import available
    from ..filters.registry import BUILT_IN, resolve

    described = []
    for name in BUILT_IN if no_plugins else available():  # plug-ins are imported in processes of their own
        plugin = signature_of(name, resolve(name)) if name in BUILT_IN else inspect_plugin(name)
        options = dict(plugin.parameters)
        row: dict[str, Any] = {"name": name, "summary": plugin.summary, "options": options}
        described.append(row | ({"fault": plugin.fault} if plugin.fault else {}))
    if as_json:
        print_json({"estimators": described})
        return
    for row in described:
        if "fault" in row:
            say(f"{row['name']:<12} cannot be used: {row['fault']}")
            continue
        listed = ", ".join(f"{name}={value}" for name, value in row["options"].items())
        say(f"{row['name']:<12} {row['summary']}")
        say(f"{'':<12} options: {listed or 'none'}")


def read_options(given: Iterable[str]) -> dict[str, Any]:
    """Options written as in a study, NAME=VALUE, in m and rad.

    Raises:
        ValueError: If one has no value, or one that a study would not take.
    """
    from ..evaluation.study import EstimatorSection

    options: dict[str, Any] = {}
    for text in given:
        name, equals, value = (part.strip() for part in text.partition("="))
        try:
            options[name] = tomllib.loads(f"value = {value}")["value"]
        except tomllib.TOMLDecodeError:
            if not equals or not re.fullmatch(r"[A-Za-z][\w.-]*", value):
                raise ValueError(
                    f"--option {text!r}: write NAME=VALUE as in a study, such as cell_m=0.05"
                ) from None
            options[name] = value  # a word without quotation marks
    return EstimatorSection(name="-", options=options).converted()


def read_reasons(given: Iterable[str]) -> dict[str, str]:
    """Checks that are expected to fail, CHECK=REASON.

    Raises:
        ValueError: If one has no reason.
    """
    reasons = {}
    for text in given:
        name, _, reason = (part.strip() for part in text.partition("="))
        if not reason:
            raise ValueError(f"--expect-failure {text!r}: write CHECK=REASON, the reason in quotation marks")
        reasons[name] = reason
    return reasons
