"""Make the page of who is honest where: every built-in estimator, at its defaults, on random problems.

Usage: python docs/make_honesty.py [--problems N] [--truths M] [--families NAME ...] [--out docs/honesty.md]

Each family has N random problems (`tests/filters/families.py`), each of them M truths from its prior with one
measurement. The reference is `exact`, which integrates over pieces of the map on which ranges are affine.
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

from tests.filters.families import POSITION, draw  # noqa: E402

from rangefix.evaluation import nees  # noqa: E402
from rangefix.filters import build  # noqa: E402
from rangefix.filters.estimator import numerical_error  # noqa: E402
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
}
HEAD = """# Who is honest where

<!-- Made by `make honesty`: do not edit. -->

Every built-in estimator at its defaults, one measurement at a known heading. Each family has {problems}
random problems with {truths} truths each: 1 to 8 beams along the axes, in random directions or in a fan, and
noise of 1 to 10 cm. They are none of those on which the estimators were tried while they were made. The
reference is `exact`.

- **missed**: fixes whose mean is off from that of the exact posterior by more than 5 % of its deviation, or
  whose covariance by more than 10 %, in the direction where that is greatest.
- **NEES / n**: mean squared error over claimed variance; 1 is honest, more is overconfident. The mean of few
  fixes scatters: that of `exact` beside it has met the same truths.
- **worst error stated**: by the estimator itself (`error`), in deviations; - where it cannot tell.
  **flagged**: above 0.05.
- **refused**: problems that the estimator says it does not take.
- **ms**: per fix, setting up not counted; median over problems, {truths} fixes at once, on one machine:
  compare within the table.
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


def judge(family: str, problems: int, truths: int) -> dict[str, Figures]:
    """All built-in estimators on one family."""
    table = {name: Figures() for name in BUILT_IN}
    for number in range(FIRST_NUMBER, FIRST_NUMBER + problems):
        problem = draw(family, number).problem
        rng = np.random.default_rng([12, number])
        states = problem.prior.sample(truths, rng)
        readings = problem.sensor.sample(states, rng)
        exact = None
        for name in ("exact", *(other for other in BUILT_IN if other != "exact")):
            figures = table[name]
            try:
                estimator = build(name, problem)
            except ValueError:
                figures.refused += 1
                continue
            rngs = [np.random.default_rng([13, number, run]) for run in range(truths)]
            belief = estimator.init(problem.prior, rngs)
            start = time.perf_counter()
            belief = estimator.update(belief, readings, rngs)
            estimate = estimator.estimate(belief)
            figures.times.append((time.perf_counter() - start) / truths)
            exact = estimate if exact is None else exact
            fine = np.isfinite(estimate.covariance).all((1, 2)) & np.isfinite(estimate.mean).all(1)
            missed = np.ones(truths, dtype=bool)
            missed[fine] = off(
                estimate.mean[fine], estimate.covariance[fine], type(exact)(*(a[fine] for a in exact))
            )
            figures.missed += missed.tolist()
            ratios = (
                nees(problem.space.difference(states, estimate.mean), estimate.covariance)
                / problem.space.size
            )
            figures.ratios += ratios[fine].tolist()
            if (stated := numerical_error(estimator, belief, truths)) is not None:
                figures.errors += stated.tolist()
        print(f"{family} {number - FIRST_NUMBER + 1} of {problems}", file=sys.stderr)
    return table


def section(family: str, table: dict[str, Figures]) -> list[str]:
    """A family as lines of Markdown."""
    lines = [f"## {family}: {ABOUT[family]}", ""]
    lines += [
        "| estimator | missed | NEES / n | worst error stated | flagged | refused | ms |",
        "|---|---|---|---|---|---|---|",
    ]
    lines += [f"| {name} | {' | '.join(figures.cells())} |" for name, figures in table.items()]
    return [*lines, ""]


def main() -> None:
    """Make the page."""
    parser = argparse.ArgumentParser(description="Make the page of who is honest where.")
    parser.add_argument("--problems", type=int, default=40, help="of each family")
    parser.add_argument("--truths", type=int, default=20, help="of each problem")
    parser.add_argument("--families", nargs="+", choices=POSITION, default=POSITION)
    parser.add_argument("--out", type=Path, default=HERE / "honesty.md", help="file to write")
    given = parser.parse_args()
    warnings.simplefilter("ignore", RuntimeWarning)
    lines = [HEAD.format(problems=given.problems, truths=given.truths)]
    for family in given.families:
        lines += section(family, judge(family, given.problems, given.truths))
    given.out.write_text("\n".join(lines).rstrip() + "\n", encoding="utf-8")
    print(f"Written: {given.out}")


if __name__ == "__main__":
    main()
