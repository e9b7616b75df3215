"""Measure what planning beams is worth: even, random, planned and adaptive ones in three maps.

Usage: python docs/make_planning.py [--runs N] [--building FILE] [--maps NAME ...] [--kinds NAME ...]
    [--ways NAME ...] [--small] [--out FILE]

Writes a page with tables, `docs/images/planning-study.png`, and the numbers as `planning-study.json` beside
the page. Accuracy is the root of the mean of trace P of the posterior over truths from the prior (x1 and x2),
which for an exact posterior is the RMS error; P comes from the exact filter, and of adaptive beams from the
cells by which the next one is chosen. Maps, kinds and ways that are not named stay as they were: each column
keeps how many truths it was measured over, and with which code, and the page says so.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from rangefix.arrays import Array
from rangefix.evaluation import load_study
from rangefix.evaluation.planning.cells import Cells, check_plannable, turned
from rangefix.evaluation.planning.selection import Planner
from rangefix.evaluation.planning.whole_sets.covariances import covariances_after, criterion_of, exact_filter
from rangefix.filters import (
    Gaussian,
    Problem,
    Rangefinder,
    Stationary,
    Uniform,
    pose_space,
    position_space,
    sweep,
)
from rangefix.maps import FloorPlan, RectangularRoom

HERE = Path(__file__).parent
BUILDING = HERE.parent.parent / "shared/data/avz/avz.ply"
BEAMS = (1, 2, 3, 4, 5, 6, 7, 8)
PLANNED = (1, 2, 3, 4, 6, 8)  # a plan in the building takes minutes
MORE_EVEN = (12, 16, 24, 32, 48, 64)  # for how many beams an accuracy takes
OFFSETS = 8  # of even beams, and sets of random ones, over which runs are spread
STD, MAP_STD, GRAZING_DEG = 0.05, 0.02, 75.0
WRONG_M = 0.2  # a posterior wider than that is counted
TARGETS_M = (0.10, 0.05, 0.02)
TRUTHS = 64  # of the planner, as `rangefix plan` has it unless asked otherwise
MORE_TRUTHS = 25  # times as many for beams that are named beforehand, which the exact filter judges
IN_BUILDING = 2  # of the truths there: one in so many
SEED = 14
WAYS = ("even", "random", "planned", "adaptive")
KINDS = ("all", "limited")
ABOUT = {
    "room": "the paper's room, 4 x 6 m",
    "l-shape": "an L-shape of 6 x 5 m without a corner of 3 x 2.5 m",
    "avz": "a scanned building, a box of 10 x 10 m of it",
}


def problem_in(name: str, building: Path) -> Problem:
    """A rangefinder of 5 cm that can look everywhere, at a known heading, anywhere in a map."""
    if name == "avz":
        given = load_study("mesh", map_path=building).problem()
        sensor = check_plannable(given)
        return replace(given, sensor=replace(sensor, noise=Gaussian(STD), blind_sector=0.0))
    plan = FloorPlan([[0, 0], [6, 0], [6, 2.5], [3, 2.5], [3, 5], [0, 5]])
    room = RectangularRoom(4, 6) if name == "room" else plan
    space = position_space(heading=0.0)
    sensor = Rangefinder(room, np.array([0.0]), Gaussian(STD), space)
    return Problem(space, Stationary(space), sensor, Uniform(room, space))


def traces(problem: Problem, bearings: Array, states: Array, rng: np.random.Generator) -> Array:
    """Trace of P of x1 and x2 after some beams, for each true state, m^2."""
    sensor = turned(check_plannable(problem), bearings)
    exact = exact_filter(replace(problem, sensor=sensor))
    assert exact is not None  # the heading is known, and the noise is Gaussian
    return criterion_of(covariances_after(exact, sensor.sample(states, rng)), "trace")


def spread_over_sets(
    problem: Problem, sets: Sequence[Array], states: Array, rng: np.random.Generator
) -> Array:
    """The same with several sets of beams, each for its share of the truths."""
    parts = np.array_split(states, len(sets))
    return np.concatenate(
        [traces(problem, beams, part, rng) for beams, part in zip(sets, parts, strict=True)]
    )


def even(count: int) -> list[Array]:
    """Even beams round the circle, at all offsets."""
    step = 2 * np.pi / count
    return [step * (np.arange(count) + (offset + 0.5) / OFFSETS) for offset in range(OFFSETS)]


def adaptive(planner: Planner, states: Array, rng: np.random.Generator) -> dict[int, Array]:
    """Trace of P after each beam, which is chosen after the readings before it."""
    first = int(np.argmin(planner.objective.first))
    found: dict[int, list[float]] = {count: [] for count in BEAMS}
    for place, state in enumerate(states):
        chosen: list[int] = []
        readings = np.empty(0)
        belief: Cells | None = None
        for count in BEAMS:
            beam = first if belief is None else planner.next_beam(belief)[0]
            chosen.append(beam)
            sensor = turned(check_plannable(planner.problem), planner.candidates[[beam]])
            readings = np.append(readings, sensor.sample(state, rng))
            belief = planner.belief_after(chosen, readings, belief)
            found[count].append(float(belief.covariance[:2, :2].trace()))
        if place % 20 == 0:
            tell(f"  adaptive: {place + 1} of {len(states)}")
    return {count: np.array(values) for count, values in found.items()}


def tell(text: str) -> None:
    """Say how far it is."""
    print(text, file=sys.stderr, flush=True)


def figures_of(values: Array) -> dict[str, float]:
    """RMS with its 95 % interval (bootstrap), median, and share of posteriors wider than WRONG_M."""
    rng = np.random.default_rng(0)
    means = values[rng.integers(0, len(values), (1000, len(values)))].mean(axis=1)
    low, high = np.sqrt(np.quantile(means, [0.025, 0.975]))
    wide = float((values > WRONG_M**2).mean())
    rms, median = float(np.sqrt(values.mean())), float(np.sqrt(np.median(values)))
    return {"rms": rms, "low": float(low), "high": float(high), "median": median, "wide": wide}


def measured(problem: Problem, runs: int, counts: Sequence[int], way: str) -> dict[str, dict[str, Any]]:
    """One way of choosing k beams: figures for each k, with random numbers of their own.

    Args:
        problem: What is measured in.
        runs: Truths for adaptive beams; for others MORE_TRUTHS times as many.
        counts: How many beams.
        way: One of WAYS.
    """
    states = problem.prior.sample(truths_of(way, runs), np.random.default_rng(SEED))
    planner = Planner(problem, sweep(np.deg2rad(0.36), 0.0), truths=TRUTHS, seed=SEED)
    found: dict[str, dict[str, Any]] = {}
    if way == "adaptive":
        rng = np.random.default_rng([SEED, WAYS.index(way), 0])
        return {str(count): figures_of(each) for count, each in adaptive(planner, states, rng).items()}
    for count in counts:
        tell(f"  {way}: {count}")
        rng = np.random.default_rng([SEED, WAYS.index(way), count])
        more: dict[str, Any] = {}
        if way == "even":
            sets: list[Array] = even(count)
        elif way == "random":
            sets = [rng.uniform(-np.pi, np.pi, count) for _ in range(OFFSETS)]
        else:
            steps = planner.plan(count, everywhere=False).steps
            sets = [np.array([step.bearing for step in steps], dtype=float)]
            degrees = np.round(np.rad2deg(sets[0]), 2).tolist()
            more = {"promised": steps[-1].position_std, "bearings_deg": degrees}
        found[str(count)] = figures_of(spread_over_sets(problem, sets, states, rng)) | more
    return found


def truths_of(way: str, runs: int) -> int:
    """Over how many truths a way is measured."""
    return runs if way == "adaptive" else runs * MORE_TRUTHS


def code_used() -> str:
    """The last commit of the library that is measured, and its date; with a star where files are changed."""
    git = ("git", "-C", str(HERE.parent))
    last = [*git, "log", "-1", "--format=%h of %as", "--", "src"]
    told = subprocess.run(last, check=True, capture_output=True, text=True).stdout.strip()
    changed = subprocess.run([*git, "diff", "--quiet", "HEAD", "--", "src"]).returncode
    return told + ("*" if changed else "")


def small_cases() -> list[dict[str, Any]]:
    """Greedy, exchange and exhaustive search over few candidates: the trace that each promises, m^2."""
    rows: list[dict[str, Any]] = []
    room, space = RectangularRoom(4, 6), pose_space()
    for label, beams, arc, degrees in (
        ("3 beams of 13 directions in a half circle, noise 0.05 m", 3, None, np.arange(-90.0, 91.0, 15.0)),
        ("2 beams of 24 directions, noise 0.05 m", 2, None, np.arange(0.0, 360.0, 15.0)),
        (
            "2 beams of 8 directions, heading unknown within 120 deg, noise 0.3 m",
            2,
            60.0,
            np.arange(0, 360, 45.0),
        ),
    ):
        problem, truths = problem_in("room", BUILDING), TRUTHS // 2
        if arc is not None:
            sensor = Rangefinder(room, np.array([0.0]), Gaussian(0.3), space)
            prior = Uniform(room, space, headings=(-np.deg2rad(arc), np.deg2rad(arc)))
            problem, truths = Problem(space, Stationary(space), sensor, prior), 12
        planner = Planner(problem, np.deg2rad(degrees), truths=truths, seed=SEED)
        row: dict[str, Any] = {"case": label, "code": code_used()}
        for method in ("greedy", "exchange", "exhaustive"):
            tell(f"  {label}: {method}")
            steps = planner.plan(beams, method, everywhere=False).steps
            row[method] = (steps[-1].position_std, steps[-1].error / (2 * steps[-1].position_std))
        rows.append(row)
    return rows


def worth(even_rms: dict[int, float], rms: float) -> str:
    """How many even beams are as accurate, between those that were tried."""
    counts = np.array(sorted(even_rms))
    values = np.minimum.accumulate([even_rms[count] for count in counts])
    if rms < values[-1]:
        return f"more than {counts[-1]}"
    return f"{np.exp(np.interp(-np.log(rms), -np.log(values), np.log(counts))):.1f}"


def needed(rms: dict[int, float], target: float, common: float = 0.0) -> str:
    """The least number of beams that reach an accuracy; of those that were tried."""
    enough = [count for count, value in sorted(rms.items()) if np.hypot(value, common) <= target]
    return str(enough[0]) if enough else f"not with {max(rms)}"


def what_was_run(found: dict[str, Any], small: list[dict[str, Any]]) -> str:
    """Which parts of the study the page has, and which it lacks, in sentences."""
    limited = [name for name, kinds in found.items() if "limited" in kinds]
    told = []
    if limited:
        told.append(
            f"With beams that meet a wall at more than {GRAZING_DEG:g} deg lost all was done again in: "
            + "; ".join(ABOUT[name] for name in limited) + "."
        )  # fmt: skip
    lacking = [
        *(text for name, text in ABOUT.items() if name not in found),
        *(f"grazing beams lost in {ABOUT[name]}" for name in found if name not in limited),
        *([] if small else ["greedy against exchange against exhaustive search"]),
    ]
    if lacking:
        told.append("Not run yet: " + "; ".join(lacking) + ".")
    return "\n".join(told)


def made(columns: dict[str, dict[str, Any]]) -> str:
    """Over how many truths columns were measured, and with which code, in a line."""
    same: dict[str, list[str]] = {}
    for way, column in columns.items():
        note = f" ({column['note']})" if "note" in column else ""
        same.setdefault(f"{column['truths']} truths, code {column['code']}{note}", []).append(way)
    told = [f"{', '.join(ways)}: {how}" for how, ways in same.items()]
    return f"{'; '.join(told)}."


def cell(row: dict[str, float] | None) -> str:
    """What one way reaches with so many beams, or a dash."""
    if row is None:
        return "–"
    rms, low, high, median = (1e3 * row[key] for key in ("rms", "low", "high", "median"))
    return f"{rms:.0f} [{low:.0f}, {high:.0f}]; {median:.0f}; {100 * row['wide']:.3g} %"


def tables(found: dict[str, Any], small: list[dict[str, Any]]) -> str:
    """The page."""
    lines = [HEAD.format(std=STD, map_std=MAP_STD, offsets=OFFSETS, done=what_was_run(found, small))]
    for name, kinds in found.items():
        for kind, columns in kinds.items():
            limited = (
                "" if kind == "all" else f", beams that graze a wall at more than {GRAZING_DEG:g} deg lost"
            )
            lines += [f"## {ABOUT[name]}{limited}", "", made(columns), ""]
            lines += ["| beams | " + " | ".join(WAYS) + " | promised |", "|---" * (len(WAYS) + 2) + "|"]
            rows = {way: columns[way]["beams"] for way in WAYS}
            for count in map(str, BEAMS):
                cells = [cell(rows[way].get(count)) for way in WAYS]
                foretold = rows["planned"].get(count, {}).get("promised")
                promised = "–" if foretold is None else f"{1e3 * foretold:.0f}"
                lines.append(f"| {count} | " + " | ".join([*cells, promised]) + " |")
            rms = {way: {int(count): each["rms"] for count, each in rows[way].items()} for way in WAYS}
            equal = ", ".join(
                f"{count}: {worth(rms['even'], rms['planned'][count])}" for count in (2, 3, 4, 8)
            )
            lines += ["", f"Even beams that so many planned ones are worth: {equal}.", ""]
            lines += ["| RMS, m | " + " | ".join(WAYS) + " | the same, map off by 2 cm |", "|---" * 6 + "|"]
            floor = np.sqrt(2) * MAP_STD
            for target in TARGETS_M:
                each = [needed(rms[way], target) for way in WAYS]
                off = (
                    f"never: {floor:.3f} m stay"
                    if floor > target
                    else ", ".join(f"{way} {needed(rms[way], target, floor)}" for way in WAYS)
                )
                lines.append(f"| {target:.2f} | " + " | ".join(each) + f" | {off} |")
            lines.append("")
    if small:
        lines += [
            "## Greedy, exchange, exhaustive",
            "",
            SMALL_HEAD,
            "",
            "| case | greedy, m | exchange, m | exhaustive, m | code |",
        ]
        lines += ["|---|---|---|---|---|"]
        for row in small:
            cells = ["{:.4f} +- {:.4f}".format(*row[key]) for key in ("greedy", "exchange", "exhaustive")]
            lines.append(f"| {row['case']} | " + " | ".join(cells) + f" | {row['code']} |")
        lines.append("")
    return "\n".join(lines)


HEAD = """# What planned beams are worth

<!-- Made by `make planning`: do not edit. -->

A rangefinder of {std} m that can look in every direction, at a known heading, at any place of a map.
Even beams stand evenly round the circle, at {offsets} offsets; random ones anywhere, {offsets} sets of
them; planned ones are chosen by `rangefix plan` before anything is measured, as it does unless asked
otherwise; adaptive ones each after the readings before it. In each cell: RMS error of the position with
its 95 % interval, median of the posteriors' deviations, both in mm, and how many posteriors are wider than
0.2 m: rare wrong modes make the RMS. Promised is the RMS error that the plan foretold, in mm. Part of what
adaptive beams gain comes from beams that graze a wall, which tell most where the noise does not grow with
the angle. Each column says over how many truths it was measured, and with the code of which commit.
{done}

A map that is off as a whole by {map_std} m (one standard deviation along each axis) adds the same error
to all beams: its square is added, and no number of beams takes it away.

![Error over the number of beams](images/planning-study.png)
"""


SMALL_HEAD = """In the paper's room: the RMS error that is expected of the plan, with its standard error. All
searches meet the same truths where they choose, and the same fresh ones are judged by."""


def draw(found: dict[str, Any], path: Path) -> None:
    """Error over the number of beams, a panel for each map."""
    from matplotlib.figure import Figure

    panels = [(name, kind, ways) for name, kinds in found.items() for kind, ways in kinds.items()]
    figure = Figure(figsize=(3.4 * len(panels), 3.4), layout="constrained")
    axes = np.atleast_1d(figure.subplots(1, len(panels), sharey=True))
    for axis, (name, kind, ways) in zip(axes, panels, strict=True):
        for way, colour, marker in zip(
            WAYS, ("#888888", "#cc8800", "#1f6fb4", "#b4301f"), "sv^o", strict=True
        ):
            beams = [count for count in BEAMS if str(count) in ways[way]["beams"]]
            rows = [ways[way]["beams"][str(count)] for count in beams]
            rms = np.array([row["rms"] for row in rows])
            bars = np.abs(np.array([[row["low"] for row in rows], [row["high"] for row in rows]]) - rms)
            axis.errorbar(
                beams, rms, bars, label=way, color=colour, marker=marker, markersize=4, linewidth=1.2
            )
        axis.set(yscale="log", xlabel="beams", xticks=BEAMS)
        axis.set_title(name + ("" if kind == "all" else f", up to {GRAZING_DEG:g} deg"), fontsize=9)
        axis.grid(alpha=0.25, which="both", linewidth=0.5)
    axes[0].set_ylabel("RMS error of the position, m")
    axes[0].legend(frameon=False, fontsize=8)
    figure.savefig(path, dpi=120)


def main() -> None:
    """Measure, and write the page."""
    parser = argparse.ArgumentParser(description="What planned beams are worth.")
    parser.add_argument(
        "--runs", type=int, default=400,
        help=f"truths for adaptive beams; {MORE_TRUTHS} times as many for others; in the building half",
    )  # fmt: skip
    parser.add_argument(
        "--building", type=Path, default=BUILDING, help="mesh; left out where it is not there"
    )
    parser.add_argument(
        "--maps", nargs="*", choices=ABOUT, default=tuple(ABOUT),
        help="maps to measure in; none: only the page is written, from what was measured before",
    )  # fmt: skip
    parser.add_argument("--kinds", nargs="*", choices=KINDS, default=KINDS, help="all beams, or grazing lost")
    parser.add_argument("--ways", nargs="*", choices=WAYS, default=WAYS, help="of choosing beams: columns")
    parser.add_argument("--small", action="store_true", help="compare greedy, exchange and exhaustive search")
    parser.add_argument("--out", type=Path, default=HERE / "planning-study.md", help="page to write")
    given = parser.parse_args()
    numbers = given.out.with_suffix(".json")
    before = json.loads(numbers.read_text()) if numbers.exists() else {"found": {}, "small": []}
    found, small = before["found"], before["small"]

    def keep() -> None:
        numbers.write_text(json.dumps({"found": found, "small": small}, indent=1) + "\n")

    for name in given.maps:
        if name == "avz" and not given.building.exists():
            tell(f"no mesh at {given.building}: the building is left out")
            continue
        problem = problem_in(name, given.building)
        sensor = check_plannable(problem)
        lost = replace(sensor, max_incidence=np.deg2rad(GRAZING_DEG))
        for kind in given.kinds:
            some = problem if kind == "all" else replace(problem, sensor=lost)
            runs = given.runs // (IN_BUILDING if name == "avz" else 1)
            for way in given.ways:
                tell(f"{name}, {kind}, {way}")
                counts: tuple[int, ...] = PLANNED if way == "planned" else BEAMS
                if (way, kind) == ("even", "all") and name != "avz":
                    counts += MORE_EVEN
                column = {"code": code_used(), "truths": truths_of(way, runs)}
                columns = found.setdefault(name, {}).setdefault(kind, {})
                columns[way] = column | {"beams": measured(some, runs, counts, way)}
                found[name][kind] = {way: columns[way] for way in WAYS if way in columns}
                found[name] = {kind: found[name][kind] for kind in KINDS if kind in found[name]}
                found = {key: found[key] for key in ABOUT if key in found}
                keep()
    if given.small:
        small = small_cases()
        keep()
    given.out.write_text(tables(found, small), encoding="utf-8")
    (given.out.parent / "images").mkdir(exist_ok=True)
    draw(found, given.out.parent / "images/planning-study.png")
    print(f"Written: {given.out}")


if __name__ == "__main__":
    main()
