"""The command `plan`: which beams to measure, before any is."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from .app import (
    PICTURES,
    Json,
    doing,
    folder_or_picture,
    names_from,
    one_of,
    print_json,
    replacing,
)
from .directions import read_directions
from .map_options import Unit, Up, tell_odd
from .studies import Map, NoPlugins, Seed, StudyFile, read_study, tell_odd_sensor

if TYPE_CHECKING:
    from ..arrays import Array
    from ..evaluation.planning.expected_covariance import Criterion
    from ..evaluation.planning.plans import Plan
    from ..evaluation.planning.selection import Method
    from ..filters import Problem, Rangefinder

RESOLUTION_DEG = 0.36  # of the paper's rangefinder
CANDIDATES = "--candidates-deg"
MEASURED = "beams"  # a word for it: those of the study
TRUTHS = 64
RARE = 3.0  # events of a kind to be expected in so many draws, if it is to be met in 95 of 100 cases


def criteria() -> tuple[Criterion, ...]:
    """Names of what may be made least."""
    from ..evaluation.planning.expected_covariance import CRITERIA

    return CRITERIA


def methods() -> tuple[Method, ...]:
    """Names of ways to choose beams."""
    from ..evaluation.planning.selection import METHODS

    return METHODS


def plan(
    study: StudyFile,
    beams: Annotated[int, typer.Option("--beams", "-b", min=1, metavar="N", help="How many beams.")] = 3,
    criterion: Annotated[
        str,
        typer.Option(
            metavar="NAME",
            autocompletion=names_from(criteria),
            help="What is made least on average: trace, det or largest eigenvalue of the position's "
            "covariance; or, made greatest, information.",
        ),
    ] = "trace",
    method: Annotated[
        str | None,
        typer.Option(
            metavar="NAME",
            autocompletion=names_from(methods),
            help="greedy; exchange, which goes on from there; or exhaustive, all sets of few candidates. "
            "Unless given: exchange.",
        ),
    ] = None,
    adaptive: Annotated[
        bool, typer.Option("--adaptive", help="Choose each beam after the readings before it are known.")
    ] = False,
    candidates_deg: Annotated[
        str | None,
        typer.Option(
            CANDIDATES,
            metavar="DEGREES",
            help="Directions to choose from: -90,0,90 or -90:90:15 (from:to:step), deg clockwise from where "
            f"the laser looks; or {MEASURED!r}, the study's own. Every {RESOLUTION_DEG:g} deg outside the "
            "blind sector unless given.",
        ),
    ] = None,
    truths: Annotated[
        int | None,
        typer.Option(
            min=2,
            metavar="N",
            help="Truths by which beams are looked for from the second on; the table averages over more "
            f"where the exact filter can. Unless given: {TRUTHS}.",
        ),
    ] = None,
    seed: Seed = None,
    map_path: Map = None,
    unit: Unit = None,
    up: Up = None,
    out: Annotated[
        Path | None,
        typer.Option(
            "--out",
            "-o",
            parser=folder_or_picture,
            metavar="PATH",
            help="A folder, or a picture (.png, .svg, .pdf): the objective round the compass on the map.",
        ),
    ] = None,
    no_plugins: NoPlugins = False,
    as_json: Json = False,
) -> None:
    """Which beams to measure: the expected accuracy of a position before anything is measured."""
    least = one_of(criterion, criteria(), "criterion is called")
    if adaptive and method is not None:
        raise ValueError("--method has no effect with --adaptive, which chooses each beam by itself")
    asked = {"--method": method, "--adaptive": adaptive or None, "--truths": truths, "--seed": seed}
    useless = [name for name, value in asked.items() if value is not None] if beams == 1 else []
    way = one_of(method or "exchange", methods(), "method is called")
    given = read_study(study, None, seed, map_path, not no_plugins, unit=unit, up=up)
    world = given.world()

    from ..evaluation.planning.selection import Planner

    problem = world.assumed or world.truth
    tell_odd(problem.sensor.room)
    tell_odd_sensor(given, world.truth.sensor)
    candidates = read_candidates(candidates_deg, problem)
    planner = Planner(problem, candidates, least, truths or TRUTHS, given.seed, doing)
    if beams > len(candidates):
        raise ValueError(f"--beams {beams}: there are {len(candidates)} directions ({CANDIDATES})")
    pictures = _pictures(out)
    with replacing(*pictures):
        found = planner.plan(beams, way, adaptive, everywhere=out is not None)
        doing("")
        seconds = _times(problem, planner.sensor, found, given.seed)
        if pictures:
            _draw(found, problem, planner.prior.centres, pictures)
    if as_json:
        print_json(_document(given.name, found, seconds, problem) | {"figures": list(map(str, pictures))})
        return
    _show(given.name, found, seconds, problem, useless)
    for path in pictures:
        from .screen import console

        console().say(str(path))


def read_candidates(text: str | None, problem: Problem) -> Array:
    """Directions that may be chosen, rad, (D,).

    Raises:
        ValueError: As `read_directions`; or if measurements cannot be planned for the problem.
    """
    import numpy as np

    from ..evaluation.planning.cells import beams_alike, check_plannable
    from ..filters import sweep

    sensor = check_plannable(problem)
    if text == MEASURED or (text is None and not beams_alike(sensor)):
        return np.asarray(sensor.bearings[~sensor.blind])
    if text is None:
        return sweep(np.deg2rad(RESOLUTION_DEG), sensor.blind_sector)
    return read_directions(text, CANDIDATES, f", or {MEASURED!r}")


def _times(problem: Problem, sensor: Rangefinder, found: Plan, seed: int) -> list[float]:
    """Seconds of an update with the first 1, 2, ... beams; of an adaptive plan, with even ones instead."""
    import numpy as np

    from ..evaluation.planning.update_time import update_seconds
    from ..filters.models.rangefinder import some_beams

    count = len(found.steps)
    places = np.linspace(0, len(found.candidates) - 1, count).round().astype(int)
    if not found.adaptive:
        places = np.array([step.candidate for step in found.steps])
    return [
        update_seconds(problem, some_beams(sensor, places[: each + 1]), seed=seed) for each in range(count)
    ]


def _pictures(out: Path | None) -> list[Path]:
    if out is None:
        return []
    is_picture = out.suffix.lower() in PICTURES and not out.is_dir()
    return [out] if is_picture else [out / "plan.png", out / "plan.svg"]


def _draw(found: Plan, problem: Problem, centres: Array, paths: list[Path]) -> None:
    from ..evaluation.figures.files import write_figure
    from ..evaluation.figures.planning.compass import draw_plan
    from ..evaluation.planning.scene import FloorPlan

    floor = FloorPlan.of(problem, centres[:, problem.space.position_indices])
    write_figure(lambda: draw_plan(found, floor), *paths)


def _show(name: str, found: Plan, seconds: list[float], problem: Problem, useless: list[str]) -> None:
    from .screen import console, new_table

    unit = {"trace": "m²", "det": "m⁴", "largest": "m²", "information": "nats, of this beam"}[found.criterion]
    columns = ["beams", "direction,\ndeg", "position,\nrms m", f"{found.criterion},\n{unit}", "± (draws)"]
    table = new_table(f"Planned beams: {name}", [*columns, "ms per\nupdate"])
    numbers = _own_numbers(found, problem)
    for number, (step, second) in enumerate(zip(found.steps, seconds, strict=True), start=1):
        direction = "by readings" if step.bearing is None else f"{_degrees(step.bearing):.2f}"
        if own := numbers[number - 1]:
            direction += f" (beam {own})"
        error = f"{step.error:.2g}" if step.error else "none"
        cells = f"{step.position_std:.4g}", f"{step.value:.4g}", error, f"{1e3 * second:.3g}"
        table.add_row(str(number), direction, *cells)
    screen = console()
    screen.print(table)
    how = "each chosen after the readings before it" if found.adaptive else f"by {found.method}"
    how += " search" if found.method == "exhaustive" else ""
    known = _known_heading(problem)
    heading = "that is estimated" if known is None else f"that is known to be {known:g} deg"
    directions = len(found.candidates)
    screen.say(
        f"Expected before anything is measured, for a heading {heading}; {how}, of {directions} directions."
    )
    if useless:
        had = f"{', '.join(useless)} {'have' if len(useless) > 1 else 'has'}"
        screen.say(f"{had} no effect on one beam: all directions are tried, and averaged over all readings.")
    if found.adaptive:
        screen.say("Times of updates are of as many beams, spread evenly.")
    last = found.steps[-1]
    if last.truths:
        told = f"The last line is an average over {last.truths} truths"
        if last.looked_at > last.truths:
            told += (
                f", chosen from {last.looked_at} so that those that are easily mistaken for other places are "
            )
            told += "among them"
        told += f". Wrong places that fewer than 1 truth in {last.looked_at / RARE:.0f} leaves open may be "
        told += "missed, by ± too"
        if not found.adaptive:
            told += f": before you claim it, run the study with {_as_keys(found, numbers)}"
        screen.say(f"{told}.")


def _own_numbers(found: Plan, problem: Problem) -> list[int | None]:
    """Numbers of a plan's beams in the study, from 1; None where all its beams have the same noise."""
    from ..evaluation.planning.cells import beams_alike, check_plannable, own_beams

    sensor = check_plannable(problem)
    if beams_alike(sensor):
        return [None for _ in found.steps]
    numbers = (own_beams(sensor, found.candidates) + 1).tolist()
    return [None if step.candidate is None else numbers[step.candidate] for step in found.steps]


def _as_keys(found: Plan, numbers: list[int | None]) -> str:
    """The beams of a plan as keys of a study: by their numbers, where each has noise of its own."""
    own = sorted(number for number in numbers if number is not None)
    chosen = [f"{_degrees(step.bearing):.6g}" for step in found.steps if step.bearing is not None]
    return f"beam_sets = [{own}]" if own else f"bearings_deg = [{', '.join(chosen)}]"


def _known_heading(problem: Problem) -> float | None:
    """The heading that directions count from, deg; None where it is estimated."""
    return None if problem.space.heading is None else _degrees(problem.space.heading)


def _document(name: str, found: Plan, seconds: list[float], problem: Problem) -> dict[str, Any]:
    numbers = _own_numbers(found, problem)
    return {
        "study": name,
        "known_heading_deg": _known_heading(problem),
        "criterion": found.criterion,
        "method": found.method,
        "adaptive": found.adaptive,
        "candidates": len(found.candidates),
        "beams": [
            {
                "beam": number,
                "direction_deg": None if step.bearing is None else _degrees(step.bearing),
                "beam_of_study": numbers[number - 1],
                "position_rms_m": step.position_std,
                "expected_covariance": step.covariance.tolist(),
                "value": step.value,
                "standard_error": step.error,
                "truths": step.truths,
                "truths_looked_at": step.looked_at,
                "update_s": second,
            }
            for number, (step, second) in enumerate(zip(found.steps, seconds, strict=True), start=1)
        ],
    }


def _degrees(bearing: float) -> float:
    import numpy as np

    return round(float(np.rad2deg(bearing)), 9)
