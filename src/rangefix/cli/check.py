"""The command `check`, and how its options are read."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Iterable
from typing import TYPE_CHECKING, Annotated, Any

import typer

from .app import ExitCode, Json, names_from, print_json, say
from .estimators import inspect_estimator, names, refuse_unknown

if TYPE_CHECKING:
    from ..evaluation.isolation import PluginInfo
    from ..filters.checks import CheckResult


def check(
    target: Annotated[
        str,
        typer.Argument(
            metavar="ESTIMATOR",
            help="A name of `rangefix estimators`, module:function, or path/file.py:function.",
            autocompletion=names_from(names),
        ),
    ],
    option: Annotated[
        list[str] | None,
        typer.Option(
            "--option",
            "-O",
            metavar="NAME=VALUE",
            help="An option, as in a study: cell_m=0.05; may be repeated.",
        ),
    ] = None,
    only: Annotated[
        list[str] | None,
        typer.Option("-k", metavar="TEXT", help="Only checks whose names hold this; may be repeated."),
    ] = None,
    first: Annotated[bool, typer.Option("-x", help="Stop after the first check that fails.")] = False,
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
    from ..filters.registry import BUILT_IN

    refuse_unknown(target, names())
    options, reasons = (
        read_options(option or (), inspect_estimator(target), ours=target in BUILT_IN),
        read_reasons(expect_failure or ()),
    )
    results: list[CheckResult] = []
    for result in run_checks_isolated(target, options, reasons, timeout, chosen(only or ())):
        results.append(result)
        if not as_json and not (result.outcome == "skipped" and _told_before(results)):
            for line in lines_of(result):
                say(line)
        if first and not conforms([result]):
            break
    if as_json:
        checks = [vars(result) for result in results]
        print_json({"target": target, "conforms": conforms(results), "checks": checks})
    else:
        say(sum_up(results))
    if not conforms(results):
        raise typer.Exit(ExitCode.SOME_FAILED)


def _told_before(results: list[CheckResult]) -> bool:
    """Whether the last of the checks was skipped for what the one before it says already."""
    *_, before, last = [None, *results]
    cause = ("it was not built", "it was not imported", "not tried: ")
    return before is not None and last is not None and last.detail.startswith(cause)


def chosen(texts: Iterable[str]) -> tuple[str, ...]:
    """Names of the checks that hold one of some texts; all of them if there is none.

    Raises:
        ValueError: If a text is in no name.
    """
    from ..errors import suggestion
    from ..filters.checks import check_names

    given = list(texts)
    for text in given:
        if not any(text in name for name in check_names()):
            words = dict.fromkeys(word for name in check_names() for word in name.split("_"))
            hint = suggestion(text, words)
            hint = hint if hint.startswith("did you mean") else f"there are {', '.join(check_names())}"
            raise ValueError(f"-k {text}: no check has this in its name; {hint}")
    return tuple(name for name in check_names() if not given or any(text in name for text in given))


def read_options(given: Iterable[str], plugin: PluginInfo, *, ours: bool = False) -> dict[str, Any]:
    """Options written as in a study, NAME=VALUE, as the estimator takes them: in m and rad.

    Args:
        given: The options.
        plugin: What the estimator says of them.
        ours: Whether it is built in: of those it is known which options are numbers.

    Raises:
        ValueError: If one has no value, stands twice, is none of the estimator's, or has a value that a study
            would not take.
    """
    from pydantic import ValidationError

    from ..evaluation.study.check_estimators import unfit_value
    from ..evaluation.study.sections.base import misfits_of
    from ..evaluation.study.sections.estimators import EstimatorSection

    options: dict[str, Any] = {}
    for text in given:
        name, equals, value = (part.strip() for part in text.partition("="))
        if name in options:
            raise ValueError(f"--option {name} is given more than once: which one counts?")
        if equals and (wrong := plugin.misnamed(name)):
            raise ValueError(f"--option {name}: the estimator {wrong}")
        try:
            options[name] = tomllib.loads(f"value = {value}")["value"]
        except tomllib.TOMLDecodeError:
            if not equals or not re.fullmatch(r"[A-Za-z][\w.-]*", value):
                raise ValueError(
                    f"--option {text!r}: write NAME=VALUE as in a study, such as cell_m=0.05"
                ) from None
            options[name] = value  # a word without quotation marks
    try:
        variants = EstimatorSection(name="-", options=options).variants()
    except ValidationError as error:
        faults = [fault.get("ctx", {}).get("error", fault["msg"]) for fault in error.errors()]
        told = []
        for fault in faults:
            misfits = misfits_of(fault)
            told += [f"{'.'.join(map(str, misfit.path))}: {misfit}" for misfit in misfits] or [str(fault)]
        raise ValueError(f"--option {'; '.join(told)}") from None
    if len(variants) > 1:
        raise ValueError("--option: a list of values makes several estimators: check one after the other")
    for given_as, (name, value) in zip(options, variants[0].options.items(), strict=True):
        if ours and (unfit := unfit_value(name, value, plugin)):
            raise ValueError(f"--option {given_as} {unfit}")
    return variants[0].options


def read_reasons(given: Iterable[str]) -> dict[str, str]:
    """Checks that are expected to fail, CHECK=REASON.

    Raises:
        ValueError: If one has no reason, or stands twice.
    """
    reasons: dict[str, str] = {}
    for text in given:
        name, _, reason = (part.strip() for part in text.partition("="))
        if not reason:
            raise ValueError(f"--expect-failure {text!r}: write CHECK=REASON, the reason in quotation marks")
        if name in reasons:
            raise ValueError(f"--expect-failure {name} is given more than once: which one counts?")
        reasons[name] = reason
    return reasons
