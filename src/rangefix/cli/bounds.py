"""The command `bounds`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from .app import (
    PICTURES,
    ExitCode,
    Json,
    as_typed,
    doing,
    named,
    names_from,
    names_in,
    one_of,
    print_json,
    replacing,
    results_folder,
    say,
    warn,
)
from .map_options import Unit, Up, tell_odd
from .studies import SHIPPED, Map, NoPlugins, read_study, studies_here, tell_odd_sensor

if TYPE_CHECKING:
    from ..evaluation import Experiment, Study
    from ..evaluation.bounds.catalogue import Row

AT_ONE_STATE = (
    "All truths of this study are one state: bounds are averages over the prior, and not about its G."
)


def names() -> tuple[str, ...]:
    """Names of the entries of the table."""
    from ..evaluation.bounds.catalogue import NAMES

    return NAMES


def bounds(
    study: Annotated[
        str,
        typer.Argument(
            metavar="STUDY",
            help="A study file, the name of one that comes along, or a folder of results.",
            autocompletion=names_from(studies_here),
        ),
    ],
    only: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAMES",
            autocompletion=names_from(names),
            help="Entries to compute, joined by commas; all unless given. It is a mistake to name one "
            "that does not apply.",
        ),
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(
            "--out",
            "-o",
            parser=named,
            metavar="DIR",
            help="Folder of the study's results, in which they are saved; results/STUDY, if it is there, "
            "unless given.",
        ),
    ] = None,
    curve: Annotated[
        Path | None,
        typer.Option(
            parser=named,
            metavar="FILE",
            help="Draw how they grow with the noise, from 1 cm to 5 m, instead: a picture (.png, .svg, .pdf) "
            "of the study's last set of beams. It may take minutes.",
        ),
    ] = None,
    map_path: Map = None,
    unit: Unit = None,
    up: Up = None,
    no_plugins: NoPlugins = False,
    as_json: Json = False,
) -> None:
    """How good anybody could be on a study: the optimum, and bounds below which no estimator comes.

    Beside results of the study they are saved: its tables and report show them then.
    """
    from ..evaluation.bounds.catalogue import bounds_of
    from ..evaluation.bounds.document import row_as_json
    from ..evaluation.monte_carlo.save_bounds import is_of, save_bounds

    if curve is not None and (only is not None or out is not None):
        raise ValueError("--curve goes without --only and --out")
    if curve is not None and curve.suffix.lower() not in PICTURES:
        raise ValueError(f"--curve {curve}: name a picture that ends with {', '.join(PICTURES)}")
    asked = names_in(only)
    chosen = tuple(one_of(name, names(), "bound") for name in asked) or names()
    described, folder = _study_and_folder(study, out, map_path, not no_plugins, unit=unit, up=up)
    if asked and out is not None:
        raise ValueError("--only goes without --out: what is saved is all there is")
    experiment = described.experiment()
    is_named = folder == Path(study) or (out is not None and curve is None)
    belongs = (is_named or not (asked or curve)) and is_of(folder, experiment)
    if is_named and not belongs:
        raise ValueError(
            f"{folder} holds no finished results of this study as it is now, of this version and the same "
            f"map: run it with --bounds, or name the study that was run and {as_typed('--out', folder)}"
        )
    tell_odd(experiment.truth.sensor.room)
    tell_odd_sensor(described, experiment.truth.sensor)
    if curve is not None:
        with replacing(curve):
            _draw_curve(described, experiment, curve, as_json)
        return
    rows = list(bounds_of(experiment, chosen, doing))
    doing("")
    refused = [row for row in rows if row.bound is None]
    components = experiment.truth.space.names
    saved = save_bounds(folder, experiment, rows) if belongs and not asked else None
    if as_json:
        print_json(
            {
                "study": described.name,
                "names": list(components),
                "rows": [row_as_json(row, components) for row in rows],
                "saved": None if saved is None else str(saved),
            }
        )
    elif len(refused) < len(rows) or not asked:
        from .screen import console
        from .tables.bounds import bounds as table

        screen = console()
        screen.print(
            table(rows, components, f"{described.title or described.name}: how good anybody could be")
        )
        for text in _notes(rows):
            screen.say(text)
        if experiment.start is not None:
            screen.say(AT_ONE_STATE)
        if saved is not None:
            report = as_typed("rangefix", "report", folder)
            screen.say(f"Saved beside the results: {saved}   Tables and report: {report}")
    if asked and refused:
        for text in dict.fromkeys(f"{row.name} does not apply: {row.refused}" for row in refused):
            warn(text)
        raise typer.Exit(ExitCode.BAD_INPUT)


def _study_and_folder(
    target: str, out: Path | None, map_name: str | None, plugins: bool, **map_keys: str | None
) -> tuple[Study, Path]:
    """The study that is asked about, and where its results may be.

    Raises:
        ValueError: If a folder of results is given with options that are for a study.
        StudyError: If the study is not sound.
    """
    from ..evaluation import load, parse_study

    folder = Path(target)
    if folder.is_dir() and target not in SHIPPED:
        results_folder(target)  # says which folders hold some
    if not folder.is_dir() or not (folder / "manifest.json").exists():
        study = read_study(target, None, None, map_name, plugins, **map_keys)
        return study, Path("results") / study.name if out is None else out
    if out is not None or map_name is not None or any(map_keys.values()):
        raise ValueError("--out, --map, --unit and --up go with a study, not with a folder of results")
    manifest = load(folder).manifest
    if not manifest["config"]:
        raise ValueError(f"{folder} is of an experiment from Python: run it once more, with bounds=True")
    words = list(map(str, manifest.get("command_line") or ()))[2:]
    if "--map" in words:
        again = as_typed("rangefix", "bounds", *words)
        raise ValueError(f"{folder} was run with --map: name its study and the same map, as by {again}")
    study = parse_study(
        manifest["config"],
        source=f"{manifest['name']}.toml",
        changes={"seed": manifest["seed"]},
        plugins=plugins,
    )
    return study, folder


def _draw_curve(study: Study, experiment: Experiment, path: Path, as_json: bool) -> None:
    """Compute the threshold curve of the last set of beams of a study, and draw it.

    Raises:
        ValueError: If nothing applies.
    """
    from ..evaluation.bounds.beam_subset import with_beams
    from ..evaluation.bounds.threshold import threshold_curve
    from ..evaluation.consistency.formatting import beams_in_words
    from ..evaluation.figures.files import write_figure
    from ..evaluation.figures.planning.threshold import draw_threshold

    beams = beams_in_words(experiment.beam_labels[-1])
    found = threshold_curve(with_beams(experiment.truth, experiment.beam_sets[-1]), tell=doing)
    doing("")
    write_figure(lambda: draw_threshold(found, f"{study.title or study.name}\n{beams}"), path)
    if as_json:
        variances = {name: values.tolist() for name, values in found.variances.items()}
        document = {"study": study.name, "names": list(found.names), "noise_std_m": found.stds.tolist()}
        print_json(document | {"variances": variances, "refused": found.refused, "figure": str(path)})
        return
    for name, reason in found.refused.items():
        say(f"{name} does not apply: {reason}")
    say(path)


def _notes(rows: list[Row]) -> list[str]:
    """What must be said with the table, and why entries are missing."""
    from ..evaluation.bounds.catalogue import LOCAL
    from ..evaluation.bounds.optimum import CIRCULAR

    notes = []
    if any(row.bound is not None and CIRCULAR in row.bound.conditions for row in rows):
        notes.append(f"{CIRCULAR[0].upper()}{CIRCULAR[1:]}.")
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
