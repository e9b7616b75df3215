"""Make the page of who is honest where: every built-in estimator, at its defaults, on random problems.

Usage: python docs/make_honesty.py [--problems N] [--truths M] [--families NAME ...] [--out docs/honesty.md]

Each family has N random problems (`tests/filters/families.py`), each of them M truths from its prior with one
measurement, or four where the object moves. The reference at known headings is `exact`, which integrates over
pieces of the map on which ranges are affine; elsewhere it is `adaptive-point-mass`, asked for five times the
accuracy of its default. Those families are slow and have a quarter of the problems and of the truths.
Sections of families that are not named stay as they are in the file.
"""

from __future__ import annotations

import argparse
import sys
import time
import warnings
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE.parent))

from tests.filters.families import FAMILIES, POSITION, Drawn, draw  # noqa: E402

from rangefix.evaluation import nees  # noqa: E402
from rangefix.filters import Estimate, build  # noqa: E402
from rangefix.filters.optional_methods import numerical_error  # noqa: E402
from rangefix.filters.registry import BUILT_IN  # noqa: E402

MOST_OFF = 0.05  # of a mean, in deviations of the exact posterior: more is a miss
MOST_OFF_COVARIANCE = 0.10  # of a covariance, in the direction where it is greatest
FIRST_NUMBER = 10_000  # of the problems: not those that estimators were made on
ABOUT = {
    "room": "rectangles, Gaussian noise",
    "plan": "floor plans with pillars, walls and doors, Gaussian noise",
    "mesh": "the same as meshes, cut",
    "student": "floor plans, Student's t with 3 to 8 degrees of freedom",
    "mixture": "floor plans, beam mixture",
    "limited": "floor plans, a maximum range of 2 to 4 m",
    "circle": "floor plans, 3 to 8 beams, any heading",
    "arc": "floor plans, 3 to 8 beams, any heading in an arc of 0.3 to 3 rad",
    "walls": "rooms and plans, a pose driven against walls, four measurements",
    "fine": "floor plans, 3 to 8 beams of 1 to 10 mm, any heading",
    "walk": "rooms and plans, a walk between walls, heading known, four measurements",
}
REFERENCE_ACCURACY = 0.004  # deviations, of the adaptive filter where it is the reference
SLOW_SHARE = 4  # by so much fewer problems and truths where the adaptive filter is the reference
HEAD = """# Who is honest where

<!-- Made by `make honesty`: do not edit. -->

Every built-in estimator at its defaults on random problems: 1 to 8 beams along the axes, in random
directions or in a fan, and noise of 1 to 10 cm (in one family of 1 to 10 mm). They are none of those on
which the estimators were tried while they were made.

The reference is `exact` where the heading is known and nothing moves. Elsewhere it is `adaptive-point-mass`
asked for an accuracy of {accuracy}; what that says itself that it cannot hold (no mean heading, an error
above 5 %) is left out and counted above the table.

- **missed**: fixes whose mean is off from that of the reference by more than 5 % of its deviation, or
  whose covariance by more than 10 %, in the direction where that is greatest.
- **NEES / n**: mean squared error over claimed variance; 1 is honest, more is overconfident. The mean of few
  fixes scatters: that of `exact` or `adaptive-point-mass` beside it has met the same truths.
- **worst error stated**: by the estimator itself (`error`), in deviations; - where it cannot tell.
  **flagged**: above 0.05.
- **refused**: problems that the estimator says it does not take.
- **ms**: per measurement, setting up not counted; median over problems, all truths of a problem at once, on
  one machine: compare within a table.
"""


@dataclass
class Figures:
    """What the fixes of one estimator on one family come to."""

    missed: list[bool] = field(default_factory=list)
    ratios: list[float] = field(default_factory=list)
    errors: list[float] = field(default_factory=list)
    times: list[float] = field(default_factory=list)
    refused: int = 0

    def cells(self) -> list[str]:
        """A row of the table, but for the estimator's name."""
        if not self.missed:
            return ["-", "-", "-", "-", str(self.refused), "-"]
        ratio = float(np.mean(self.ratios))
        stated = np.array(self.errors)
        return [
            f"{100 * np.mean(self.missed):.3g} %",
            f"{ratio:.3g}" if ratio < 1000 else f"{ratio:.0e}",
            f"{stated.max():.2g}" if stated.size else "-",
            f"{100 * np.mean(stated > MOST_OFF):.3g} %" if stated.size else "-",
            str(self.refused),
            f"{1e3 * np.median(self.times):.3g}",
        ]


def off(mean: Any, covariance: Any, exact: Any) -> np.ndarray:
    """Which fixes are off from the exact ones, (M,)."""
    root = np.linalg.cholesky(exact.covariance)
    shift = np.linalg.solve(root, (mean - exact.mean)[..., None])[..., 0]
    whitened = np.linalg.solve(root, np.swapaxes(np.linalg.solve(root, covariance), 1, 2))
    wide = np.abs(np.linalg.eigvalsh(whitened) - 1).max(1)
    return np.asarray((np.linalg.norm(shift, axis=1) > MOST_OFF) | (wide > MOST_OFF_COVARIANCE))


def off_angles(space: Any, estimate: Any, reference: Any) -> Any:
    """The estimate's mean written so that its headings lie within half a turn of the reference's."""
    return reference.mean + space.difference(estimate.mean, reference.mean)


def happened(
    drawn: Drawn, truths: int, rng: np.random.Generator
) -> tuple[list[np.ndarray], list[np.ndarray]]:
    """Truths of a problem at each measurement, (M, n), and the measurements, (M, B)."""
    problem = drawn.problem
    states, readings = [problem.prior.sample(truths, rng)], []
    for control in drawn.controls:
        states.append(np.array([problem.motion.sample(state, control, rng) for state in states[-1]]))
    for state in states:
        readings.append(problem.sensor.sample(state, rng))
    return states, readings


def answer(
    name: str, options: dict[str, float], drawn: Drawn, readings: list[np.ndarray], seed: list[int]
) -> Any:
    """An estimator's estimate, the error that it states, and seconds a measurement; None where it refuses.

    A single truth that it refuses, as the adaptive filter does one that takes too many rays, is NaN.
    """
    try:
        estimator = build(name, drawn.problem, **options)
    except ValueError:
        return None
    truths, size = len(readings[0]), drawn.problem.space.size
    rngs = [np.random.default_rng([*seed, run]) for run in range(truths)]
    start = time.perf_counter()
    try:
        belief = estimator.init(drawn.problem.prior, rngs)
        for step, reading in enumerate(readings):
            if step:
                belief = estimator.predict(belief, drawn.controls[step - 1], rngs)
            belief = estimator.update(belief, reading, rngs)
        estimate = estimator.estimate(belief)
        seconds = (time.perf_counter() - start) / (truths * len(readings))
        stated = numerical_error(estimator, belief, truths)
    except ValueError:
        if truths == 1:
            nothing = Estimate(np.full((1, size), np.nan), np.full((1, size, size), np.nan), np.zeros(1))
            return nothing, np.full(1, np.inf), time.perf_counter() - start
        each = [
            answer(name, options, drawn, [reading[run : run + 1] for reading in readings], [*seed, run])
            for run in range(truths)
        ]
        estimate = Estimate(*(np.concatenate([np.atleast_1d(one[0][k]) for one in each]) for k in range(3)))
        stated = None if each[0][1] is None else np.concatenate([one[1] for one in each])
        seconds = float(np.mean([one[2] for one in each]))
    return estimate, stated, seconds


def judge(family: str, problems: int, truths: int) -> tuple[dict[str, Figures], int]:
    """All built-in estimators on one family, and how many fixes the reference itself could not hold."""
    table, left_out = {name: Figures() for name in BUILT_IN}, 0
    known = family in POSITION
    for number in range(FIRST_NUMBER, FIRST_NUMBER + problems):
        drawn = draw(family, number)
        space = drawn.problem.space
        states, readings = happened(drawn, truths, np.random.default_rng([12, number]))
        name, options = ("exact", {}) if known else ("adaptive-point-mass", {"accuracy": REFERENCE_ACCURACY})
        exact, sure, _ = answer(name, options, drawn, readings, [13, number])
        held = np.asarray(sure) <= MOST_OFF
        left_out += int((~held).sum())
        for name, figures in table.items():
            if (given := answer(name, {}, drawn, readings, [13, number])) is None:
                figures.refused += 1
                continue
            estimate, stated, seconds = given
            figures.times.append(seconds)
            fine = np.isfinite(estimate.covariance).all((1, 2)) & np.isfinite(estimate.mean).all(1)
            missed, both = np.ones(truths, dtype=bool), fine & held
            near = off_angles(space, estimate, exact)
            missed[both] = off(near[both], estimate.covariance[both], type(exact)(*(a[both] for a in exact)))
            figures.missed += missed[held].tolist()
            errors = space.difference(states[-1], estimate.mean)
            figures.ratios += (nees(errors, estimate.covariance) / space.size)[both].tolist()
            if stated is not None:
                figures.errors += stated[held].tolist()
        print(f"{family} {number - FIRST_NUMBER + 1} of {problems}", file=sys.stderr)
    return table, left_out


def section(family: str, counts: tuple[int, int], table: dict[str, Figures], left_out: int) -> str:
    """A family in Markdown."""
    lines = [f"## {family}: {ABOUT[family]}", "", f"Problems: {counts[0]}, truths of each: {counts[1]}."]
    if family not in POSITION:
        lines += [f"Fixes left out, which the reference cannot hold: {left_out}."]
    lines += [""]
    lines += [
        "| estimator | missed | NEES / n | worst error stated | flagged | refused | ms |",
        "|---|---|---|---|---|---|---|",
    ]
    lines += [f"| {name} | {' | '.join(figures.cells())} |" for name, figures in table.items()]
    return "\n".join(lines) + "\n"


def sections_of(page: Path) -> dict[str, str]:
    """What a page says of each family."""
    parts = page.read_text(encoding="utf-8").split("\n## ")[1:] if page.exists() else []
    return {part.split(":")[0]: f"## {part.rstrip()}\n" for part in parts}


def main() -> None:
    """Make the page."""
    parser = argparse.ArgumentParser(description="Make the page of who is honest where.")
    parser.add_argument("--problems", type=int, default=40, help="of each family")
    parser.add_argument("--truths", type=int, default=20, help="of each problem")
    parser.add_argument("--families", nargs="+", choices=FAMILIES, default=FAMILIES)
    parser.add_argument("--out", type=Path, default=HERE / "honesty.md", help="file to write")
    given = parser.parse_args()
    warnings.simplefilter("ignore", RuntimeWarning)
    sections = sections_of(given.out)
    for family in given.families:
        share = 1 if family in POSITION else SLOW_SHARE
        counts = max(1, given.problems // share), max(1, given.truths // share)
        sections[family] = section(family, counts, *judge(family, *counts))
    shown = [sections[family] for family in FAMILIES if family in sections]
    head = HEAD.format(accuracy=REFERENCE_ACCURACY)
    given.out.write_text("\n".join([head, *shown]), encoding="utf-8")
    print(f"Written: {given.out}")


if __name__ == "__main__":
    main()
