"""The commands `studies`, `new` and `validate`, and what names a study."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ..errors import counted
from .app import Json, as_typed, named, names_from, one_of, out_file, print_json, refuse_other_kind, say, warn
from .map_options import Unit, Up, tell_odd

if TYPE_CHECKING:
    from ..evaluation import Experiment, Study
    from ..filters import Sensor

EXAMPLES = Path(__file__).parents[1] / "evaluation/study/examples"  # listed without what a study loads
SHIPPED = tuple(sorted(file.stem for file in EXAMPLES.glob("*.toml")))
FOUND, DRAWINGS = ("mesh", "occupancy"), (".dxf", ".geojson")  # maps whose free space is found, not written
FAN_BEAMS = 3  # whose directions tell their unit
SPREADS = {"std_m", "scale_m"}  # keys of a noise
USUAL_STD, STDS_ACROSS = 1.0, 20  # m of noise, and how many of it a map is across: more and less are odd
GIVEN_AS = {"runs": "--runs", "seed": "--seed", "map": "--map", "unit": "--unit", "up": "--up"}


def studies_here() -> Iterator[str]:
    """Names of studies that come along, and of study files in the current folder."""
    yield from SHIPPED
    yield from sorted(file.name for file in Path().glob("*.toml"))


StudyFile = Annotated[
    str,
    typer.Argument(
        metavar="STUDY",
        help="A study file, or the name of one that comes along: see `rangefix studies`.",
        autocompletion=names_from(studies_here),
    ),
]
Runs = Annotated[
    int | None, typer.Option("--runs", "-n", metavar="N", help="Monte Carlo runs, instead of the study's.")
]
Seed = Annotated[int | None, typer.Option("--seed", "-s", metavar="N", help="Seed, instead of the study's.")]
Map = Annotated[
    str | None,
    typer.Option("--map", "-m", metavar="MAP", help="A map file or room:4x6 (m), instead of the study's."),
]
NoPlugins = Annotated[
    bool,
    typer.Option("--no-plugins", help="Refuse a study that names estimators which are not built in."),
]


def read_study(
    study: str,
    runs: int | None,
    seed: int | None,
    map_name: str | None,
    plugins: bool,
    **map_keys: str | None,
) -> Study:
    """A study with what options say instead; its mistakes name the options.

    Args:
        study: A file, or the name of one that comes along.
        runs, seed, map_name: Instead of the study's, unless None.
        plugins: Whether it may name estimators that are not built in.
        map_keys: Keys of [map] instead of the study's, unless None.

    Raises:
        StudyError: With every mistake, one line each.
    """
    from ..evaluation import load_study

    return load_study(
        study,
        runs=runs,
        seed=seed,
        map_path=map_name,
        map_keys=map_keys,
        plugins=plugins,
        given_as=GIVEN_AS,
    )


def studies(
    name: Annotated[
        str | None,
        typer.Argument(
            metavar="NAME", help="One of them: its text.", autocompletion=names_from(lambda: SHIPPED)
        ),
    ] = None,
    out: Annotated[Path | None, out_file("Copy it to this file.")] = None,
    as_json: Json = False,
) -> None:
    """List the studies that come along, show the text of one, or copy it to a file."""
    if name is None:
        if out is not None:
            raise ValueError("--out needs a NAME: which study is to be copied?")
        _list(as_json)
        return
    text = _text(one_of(name, SHIPPED, "study that comes along is called"))
    if out is None:
        if as_json:
            print_json({"study": name, "text": text})
        else:
            for line in text.splitlines():
                say(line)
        return
    refuse_other_kind(out, "a study", ".toml")
    path = write_new(out, text)
    if as_json:
        print_json({"study": str(path)})
    else:
        say(f"{path}   Run it: {as_typed('rangefix', 'run', path)}")


def _list(as_json: bool) -> None:
    tables = [tomllib.loads(_text(name)) for name in SHIPPED]
    listed = [{"name": table["name"], "runs": table["runs"], "title": table["title"]} for table in tables]
    if as_json:
        print_json({"studies": listed})
        return
    for study in listed:
        say(f"{study['name']:<20} {counted(study['runs'], 'run'):>10}   {study['title']}")
    say("Run one: rangefix run NAME   Copy one to change it: rangefix studies NAME --out FILE")


def _text(name: str) -> str:
    return (EXAMPLES / f"{name}.toml").read_text(encoding="utf-8")


def new(
    study: Annotated[Path, typer.Argument(parser=named, metavar="STUDY", help="The file to write.")],
    as_json: Json = False,
) -> None:
    """Write a commented study to begin with."""
    if study.name in ("", ".."):
        raise ValueError(f"{study} is a folder: name a file to write")
    path = study if study.suffix == ".toml" else study.with_name(f"{study.name}.toml")
    text = (EXAMPLES.parent / "starter.toml").read_text(encoding="utf-8")
    name = re.sub(r'["\\\x00-\x1f]', "_", path.stem)
    schema = (EXAMPLES.parent / "study.schema.json").as_uri()  # editors complete and check a study by it
    results = as_typed(f"results/{name}")
    for word, meant in (
        ("STUDY.toml", as_typed(path.name.replace("\n", "_"))),
        ("report results/NAME", f"report {results}"),
        ("NAME", name),
        ("SCHEMA", schema),
    ):
        text = text.replace(word, meant)
    write_new(path, text)
    if as_json:
        print_json({"study": str(path)})
    else:
        say(f"{path}   Run it: {as_typed('rangefix', 'run', path)}")


def write_new(path: Path, text: str) -> Path:
    """Write a file that is not there yet; nothing is left of one that cannot be written.

    Raises:
        ValueError: If there is such a file, or it cannot be written.
    """
    made, content = False, text.encode("utf-8")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with path.open("xb") as file:
            made = True
            file.write(content)
    except FileExistsError:
        raise ValueError(f"{path} is there already: choose another name, or remove it") from None
    except OSError as error:
        if made:
            path.unlink(missing_ok=True)
        raise ValueError(f"cannot write {path}: {error.strerror or error}") from None
    return path


def validate(
    study: StudyFile,
    runs: Runs = None,
    seed: Seed = None,
    map_path: Map = None,
    unit: Unit = None,
    up: Up = None,
    no_plugins: NoPlugins = False,
    as_json: Json = False,
) -> None:
    """Check a study and the memory it takes, but no code of plug-ins; say what would run, and run nothing."""
    from ..evaluation.monte_carlo.cost import check_memory
    from ..evaluation.study.outline import outline

    told = outline(read_study(study, runs, seed, map_path, not no_plugins, unit=unit, up=up))
    check_memory(told.experiment)
    tell_odd_study(told.study, told.experiment)
    if as_json:
        print_json(told.as_json())
        return
    for line in told.lines():
        say(line)


def tell_odd_study(study: Study, experiment: Experiment) -> None:
    """What is odd about a study that is sound, on standard error: a line for each question to its author."""
    drawn = any(file.suffix.lower() in DRAWINGS for file in study.map.files(study.folder))
    _tell_map(experiment, drawn or study.map.kind in FOUND)
    tell_odd_sensor(study, experiment.truth.sensor)
    _tell_odometry(experiment)


def _tell_map(experiment: Experiment, whole: bool) -> None:
    """What is odd about the map, and about the one that estimators are told, where that is another.

    Of the whole map of a file, whose walls were found in it, what it is.
    """
    from ..maps.describe import describe

    true, assumed = experiment.truth.sensor.room, experiment.assumed_problem.sensor.room
    for what, room in {"map": true, "map that estimators assume": assumed}.items():
        if what == "map" or assumed != true:
            if whole:
                warn(f"{what}: {describe(room)}")
            tell_odd(room, what)


def tell_odd_sensor(study: Study, sensor: Sensor) -> None:
    """That lengths of a sensor are as large as if in mm or cm, or angles as small as if in radians."""
    import numpy as np

    diagonal = float(np.hypot(*np.subtract(*sensor.room.bounds)))
    across = f"{diagonal:.4g} m from corner to corner of the map: is it in metres?"
    noise = (study.sensor.noise or study.sensor).model_dump()
    for key in SPREADS & noise.keys():
        if (std := np.min(noise[key])) > max(USUAL_STD, diagonal / STDS_ACROSS):
            warn(f"sensor: {key} is {std:.4g}, and it is {across}")
    if sensor.min_range >= diagonal:
        warn(f"sensor: min_range_m is {sensor.min_range:.4g}, and it is {across}")
    fan, graze = np.rad2deg(np.ptp(sensor.bearings)), np.rad2deg(sensor.max_incidence)
    if len(sensor.bearings) >= FAN_BEAMS and fan <= 2 * np.pi:
        warn(f"sensor: all {len(sensor.bearings)} beams lie within {fan:.3g} deg: are they in degrees?")
    if graze <= np.pi / 2:
        warn(f"sensor: beams are lost beyond {graze:.3g} deg from a wall's normal: is that in degrees?")


def _tell_odometry(experiment: Experiment) -> None:
    """That odometry is without noise, which it is unless a study says otherwise."""
    from ..filters import Confined, Odometry

    motions = {"motion": experiment.truth.motion, "assumed.motion": experiment.assumed_problem.motion}
    for what, motion in motions.items():
        free = motion.motion if isinstance(motion, Confined) else motion
        noisy = not isinstance(free, Odometry) or any(free.alphas) or free.floors.any()
        if not noisy and (what == "motion" or motion != motions["motion"]):
            follow = "true ways follow it exactly" if what == "motion" else "estimators trust it blindly"
            warn(f"{what}: odometry without noise: {follow} (alphas, floor_m, floor_deg)")
