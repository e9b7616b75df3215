"""The command `bounds`."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Any

import typer

from .app import ExitCode, Json, doing, names_from, names_in, one_of, print_json, warn
from .studies import Map, NoPlugins, StudyFile, read_study

if TYPE_CHECKING:
    from ..evaluation.bounds.catalogue import Row


def names() -> tuple[str, ...]:
    """Names of the entries of the table."""
    from ..evaluation.bounds.catalogue import NAMES

    return NAMES


def bounds(
    study: StudyFile,
    only: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAMES",
            autocompletion=names_from(names),
            help="Entries to compute, joined by commas; all unless given. It is a mistake to name one "
            "that does not apply.",
        ),
    ] = None,
    map_path: Map = None,
    no_plugins: NoPlugins = False,
    as_json: Json = False,
) -> None:
    """How good anybody could be on a study: the optimum, and bounds below which no estimator comes."""
    from ..evaluation.bounds.catalogue import bounds_of

    asked = names_in(only)
    chosen = tuple(one_of(name, names(), "bound") for name in asked) or names()
    described = read_study(study, None, None, map_path, not no_plugins)
    experiment = described.experiment()
    rows = list(bounds_of(experiment, chosen, doing))
    doing("")
    refused = [row for row in rows if row.bound is None]
    components = experiment.truth.space.names
    if as_json:
        print_json(
            {
                "study": described.name,
                "names": list(components),
                "rows": [_as_json(row, components) for row in rows],
            }
        )
    elif len(refused) < len(rows) or not asked:
        from .screen import console
        from .tables import bounds as table

        screen = console()
        screen.print(
            table(rows, components, f"{described.title or described.name}: how good anybody could be")
        )
        for text in _notes(rows):
            screen.say(text)
    if asked and refused:
        for text in dict.fromkeys(f"{row.name} does not apply: {row.refused}" for row in refused):
            warn(text)
        raise typer.Exit(ExitCode.BAD_INPUT)


def _notes(rows: list[Row]) -> list[str]:
    """What must be said with the table, and why entries are missing."""
    from ..evaluation.bounds.catalogue import LOCAL

    notes = []
    if any(row.name in LOCAL and row.bound is not None for row in rows):
        notes.append("cramer-rao is local: it holds at one state, for unbiased estimators, and bounds no G.")
    refused: dict[tuple[str, str], list[str]] = {}
    for row in rows:
        if row.bound is None:
            refused.setdefault((row.name, row.refused), []).append(row.beams)
    sets = len({row.beams for row in rows})
    for (name, reason), beams in refused.items():
        of = "" if len(beams) == sets else f" for beams {', '.join(beams)}"
        notes.append(f"{name} does not apply{of}: {reason}")
    return notes


def _as_json(row: Row, components: tuple[str, ...]) -> dict[str, Any]:
    told: dict[str, Any] = {"beams": row.beams, "name": row.name}
    if row.bound is None:
        return told | {"refused": row.refused}
    variances = {name: float(row.bound.matrix[i, i]) for i, name in enumerate(components)}
    return told | {
        "variances": variances,
        "matrix": row.bound.matrix.tolist(),
        "error": row.bound.error.tolist(),
        "share_of_optimum": None
        if row.of_optimum is None
        else dict(zip(components, row.of_optimum.tolist(), strict=True)),
        "conditions": list(row.bound.conditions),
    }
