"""The command `map-accuracy`: how accurate a position is going to be at each place of a map."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from .app import Json, out_folder, print_json, replacing
from .directions import read_directions
from .map_options import Unit, Up, tell_odd
from .studies import Map, NoPlugins, StudyFile, read_study, tell_odd_sensor

if TYPE_CHECKING:
    from ..arrays import Array
    from ..evaluation.planning.accuracy_map import AccuracyMap
    from ..filters import Rangefinder

SCHEMA = 1


def map_accuracy(
    study: StudyFile,
    step_m: Annotated[
        float, typer.Option("--step-m", metavar="METRES", help="From one place to the next, m.")
    ] = 0.1,
    beams_deg: Annotated[
        str | None,
        typer.Option(
            "--beams-deg",
            metavar="DEGREES",
            help="Beams to read: -90,0,90 or -90:90:15 (from:to:step), deg clockwise from where the "
            "laser looks; the study's own unless given.",
        ),
    ] = None,
    map_path: Map = None,
    unit: Unit = None,
    up: Up = None,
    out: Annotated[Path | None, out_folder("Folder for the picture and the grid of numbers.")] = None,
    no_plugins: NoPlugins = False,
    as_json: Json = False,
) -> None:
    """How accurate a position is going to be at each place of a map, from gradients of the ranges."""
    if not 0 < step_m < math.inf:
        raise ValueError(f"--step-m must be positive and finite, got {step_m:g}")
    given = read_study(study, None, None, map_path, not no_plugins, unit=unit, up=up)
    world = given.world()

    import numpy as np

    from ..evaluation.planning.accuracy_map import accuracy_map
    from ..evaluation.planning.cells import check_plannable, turned

    problem = world.assumed or world.truth
    tell_odd(problem.sensor.room)
    sensor = check_plannable(problem)
    if beams_deg is not None:
        sensor = turned(sensor, read_directions(beams_deg, "--beams-deg"))
    tell_odd_sensor(given, sensor)
    files = [] if out is None else [out / "accuracy.png", out / "accuracy.npz"]
    with replacing(*files):
        found = accuracy_map(problem, sensor, step_m)
        std = found.position_std
        known = np.isfinite(std)
        if not known.any():
            raise ValueError(f"no place in free space is met at steps of {step_m:g} m: take smaller ones")
        if files:
            _write(found, sensor, *files)
    shares = (0.05, 0.5, 0.95, 1.0)
    figures = [
        [float(np.quantile(values[known], share)) for share in shares] for values in (std, found.worst()[0])
    ]
    mistaken = found.mistaken[known]
    known_heading = problem.space.heading is not None
    if as_json:
        document = _document(found, step_m, figures, mistaken) | {"heading_is_known": known_heading}
        print_json(document | {"files": [str(path) for path in files]})
    else:
        _show(found, figures, mistaken, known_heading, files)


def _write(found: AccuracyMap, sensor: Rangefinder, picture: Path, grid: Path) -> None:
    import numpy as np

    from ..evaluation.figures.files import write_figure
    from ..evaluation.figures.planning.accuracy import draw_accuracy
    from ..evaluation.results.npz import write_npz

    write_figure(lambda: draw_accuracy(found, np.asarray(sensor.room.segments)), picture)
    worst, direction = found.worst()
    write_npz(
        grid,
        {
            "schema": np.array(SCHEMA),
            "x1_m": found.x1,
            "x2_m": found.x2,
            "position_std_m": found.position_std,
            "worst_std_m": worst,
            "worst_direction_rad": direction,
            "covariance_m2": found.covariance,
            "mistaken_share": found.mistaken,
            "beams_seen": found.beams_seen.astype(np.int32),
            "bearings_rad": found.bearings,
            "heading_rad": np.array(found.heading),
        },
    )


def _document(
    found: AccuracyMap, step_m: float, figures: list[list[float]], mistaken: Array
) -> dict[str, Any]:
    """What was found, for programs.

    Args:
        found: The accuracy of the places.
        step_m: From one to the next, m.
        figures: Quantiles of the deviations of the position, and of those in the worst direction, m.
        mistaken: Of the places that are met, how often each is mistaken; NaN where that is not judged.
    """
    import numpy as np

    names = ("q05", "median", "q95", "max")
    rows = [dict(zip(names, row, strict=True)) for row in figures]
    return {
        "places": len(mistaken),
        "step_m": step_m,
        "beams": len(found.bearings),
        "what": "information from range gradients: local, no bound near jumps",
        "heading_deg": float(np.rad2deg(found.heading)),
        "position_std_m": rows[0],
        "worst_std_m": rows[1],
        "mistaken_share": float(mistaken.mean()) if np.isfinite(mistaken).any() else None,
        "mistaken_share_what": "of scans that fit the most similar place elsewhere better: an estimate",
    }


def _show(
    found: AccuracyMap, figures: list[list[float]], mistaken: Array, known_heading: bool, files: list[Path]
) -> None:
    """The same for people."""
    import numpy as np

    from ..evaluation.consistency.formatting import format_percent
    from .screen import console, new_table

    table = new_table("Expected deviations over the map, m", ["", "5 %", "median", "95 %", "largest"])
    for name, row in zip(("position", "worst direction"), figures, strict=True):
        table.add_row(name, *(f"{value:.4g}" for value in row))
    screen = console()
    screen.print(table)
    screen.say(
        f"{len(mistaken)} places, {len(found.bearings)} beams at heading {np.rad2deg(found.heading):.6g} "
        "deg. Information from gradients of the ranges: local, and no bound near jumps."
    )
    if not known_heading:
        screen.say(
            "The study does not know the heading, and other headings are not looked at: beams meet other "
            "walls there, and places may look alike at two headings that differ at this one."
        )
    if np.isfinite(mistaken).any():
        screen.say(
            f"Mistaken for the most similar place elsewhere: {format_percent(mistaken.mean())} of scans on "
            f"average, {format_percent(mistaken.max())} at the worst place. An estimate from pairs of "
            "places; 50 % is a toss-up."
        )
    else:
        screen.say(
            "How often places are mistaken for others is not worked out for so many: take larger steps."
        )
    for path in files:
        screen.say(str(path))
