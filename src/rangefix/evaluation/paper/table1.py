"""The paper's example: Table 1 and the posteriors of Figs. 2 and 3 (Stepanov and Mansour).

The paper prints standard deviations for one unstated draw of the noise, cut off and not rounded. Beside them
stand the values for measurements without noise, which anybody can repeat, and the band over noise draws: how
far one draw may be from another.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ...arrays import Array
from ...errors import one_line
from ...filters import Gaussian, Problem, Rangefinder, Stationary, Uniform, position_space
from ...filters.estimator import filtered
from ...maps import RectangularRoom
from ..results import ResultsError, read_json, read_npz, scene, write_json, write_npz
from ..seeds import streams

if TYPE_CHECKING:
    from ...filters.point_mass import PointMassBelief, PointMassFilter

WIDTH, LENGTH = 4.0, 6.0  # m
TRUTH = (2.0, 3.0)  # m
NOISE_STD = 0.05  # m
BEARINGS_DEG = (326.3, 0.0, 33.7)
PRINTED = {  # the paper's Table 1: sqrt P[1,1] and sqrt P[2,2] in metres, digit for digit
    "1": ("0.64", "0.96"),
    "2": ("1.1", "0.05"),
    "3": ("0.64", "0.96"),
    "1+2": ("0.63", "0.03"),
    "2+3": ("0.61", "0.03"),
    "1+3": ("0.02", "0.87"),
    "1+2+3": ("0.02", "0.03"),
}
FIGURE_2 = ("1", "2", "3", "1+2", "2+3", "1+3")
FIGURE_3 = ("1+2+3",)
CELLS = (0.10, 0.05, 0.02, 0.01)  # m; the last is the table's
BAND_CELL = 0.02  # m
CELL_SUM_ROUNDING = 1e-5  # m; beam 2 alone gives 0.05 m whatever the draw, up to the rounding of sums
BAND = (5.0, 95.0)  # percent of the draws


@dataclass(frozen=True)
class Table1Row:
    """One beam set of Table 1; axis 0 holds x1, x2.

    Attributes:
        beams: The beam set, "1+2".
        std, mean: Conditional standard deviation and mean for measurements without noise, m, (2,).
        printed: What the paper prints, its digits.
        band: 5 % and 95 % quantile of the standard deviation over draws of the noise, m, (2, 2).
        percentile: Percent of the draws that lie below the printed figure and below the next one: the paper
            cuts off, so 0.64 is anything from 0.64 to 0.65; (2, 2).
    """

    beams: str
    std: Array
    mean: Array
    printed: tuple[str, str]
    band: Array
    percentile: Array

    def in_band(self) -> list[bool]:
        """Whether the values that the paper may have cut off meet the band, per component."""
        return [
            bool(low <= self.band[i, 1] and high > self.band[i, 0])
            for i, (low, high) in enumerate(map(cut_off_interval, self.printed))
        ]


@dataclass(frozen=True)
class Paper:
    """Table 1 with all that Figs. 2 and 3 are drawn from.

    Attributes:
        rows: Table 1.
        convergence: Standard deviations by cell size in metres, (beam sets, 2) each.
        agreeing: Share of the noise draws for which all printed figures come out at once.
        draws, seed: Number of noise draws, and the seed they come from.
        axes: Cell centres along x1 and x2 in metres.
        densities: Posterior densities by beam set, 1/m^2, (x2, x1).
        scene: Walls, beams and true position, as the drawing of maps takes them.
    """

    rows: tuple[Table1Row, ...]
    convergence: Mapping[float, Array]
    agreeing: float
    draws: int
    seed: int
    axes: tuple[Array, Array]
    densities: Mapping[str, Array]
    scene: Mapping[str, Array]

    def row(self, beams: str) -> Table1Row:
        """The table's row for a beam set."""
        return next(row for row in self.rows if row.beams == beams)

    def to_json(self) -> dict[str, Any]:
        """Table 1 as plain numbers, for `rangefix paper --json`."""
        table = {
            row.beams: {
                "std_m": row.std.tolist(),
                "mean_m": row.mean.tolist(),
                "paper_std_m": [float(digits) for digits in row.printed],
                "band_std_m": row.band.tolist(),
                "paper_percentile": row.percentile.tolist(),
                "paper_in_band": row.in_band(),
            }
            for row in self.rows
        }
        return {
            "table1": table,
            "cell_m": CELLS[-1],
            "convergence": [
                {"cell_m": cell, "std_m": dict(zip(table, stds.tolist(), strict=True))}
                for cell, stds in self.convergence.items()
            ],
            "noise_draws": {
                "count": self.draws,
                "seed": self.seed,
                "band_percent": list(BAND),
                "share_with_all_printed_figures": self.agreeing,
            },
        }


def cut_off_interval(digits: str) -> tuple[float, float]:
    """The numbers that cut off to these digits, less rounding below: "0.64" -> (0.64, 0.65)."""
    places = len(digits.partition(".")[2])
    low = round(float(digits) * 10**places)
    return low / 10**places - CELL_SUM_ROUNDING, (low + 1) / 10**places


def example() -> Problem:
    """The paper's room, rangefinder and prior."""
    room, space = RectangularRoom(width=WIDTH, length=LENGTH), position_space(heading=0.0)
    sensor = Rangefinder(room, np.deg2rad(BEARINGS_DEG), Gaussian(NOISE_STD), space)
    return Problem(space=space, motion=Stationary(space), sensor=sensor, prior=Uniform(room, space))


def only(measurement: Array, beams: str) -> Array:
    """The measurement with the beams outside the set taken as not measured: (..., B) -> (..., B)."""
    chosen = np.isin(np.arange(1, measurement.shape[-1] + 1), [int(beam) for beam in beams.split("+")])
    return np.where(chosen, measurement, np.nan)


def solve(draws: int = 1000, seed: int = 0) -> Paper:
    """Work out the example: noise-free posteriors on ever finer grids, and the band over noise draws.

    Args:
        draws: Number of noise draws, each from a stream of its own.
        seed: Seed of the streams.
    """
    from ...filters.point_mass import (
        PointMassFilter,
    )  # brings numba, which reading a saved table does not need

    problem, truth = example(), np.array(TRUTH)
    assert isinstance(problem.sensor, Rangefinder)
    exact = problem.sensor.expected(truth)
    readings = np.stack(
        [problem.sensor.sample(truth, rng) for rng in streams(seed, "measurement", range(draws))]
    )
    noise_free = np.stack([only(exact, beams) for beams in PRINTED])
    convergence, mean = {}, np.empty(0)
    for cell in CELLS:
        finest = PointMassFilter(problem, cell)
        mean, convergence[cell] = _moments(finest, noise_free)
    coarse = PointMassFilter(problem, BAND_CELL)
    drawn = np.stack([_moments(coarse, only(readings, beams))[1] for beams in PRINTED])
    intervals = np.array([[cut_off_interval(digits) for digits in pair] for pair in PRINTED.values()])
    below = drawn[..., None] < intervals[:, None]  # (beam sets, draws, components, lower and upper edge)
    bands = np.moveaxis(np.percentile(drawn, BAND, axis=1), 0, -1)
    rows = zip(
        PRINTED, convergence[CELLS[-1]], mean, PRINTED.values(), bands, 100 * below.mean(1), strict=True
    )
    grid = finest.grid
    density = grid.image(finest.posterior(_update(finest, noise_free))) / grid.step.prod()
    return Paper(
        rows=tuple(Table1Row(*row) for row in rows),
        convergence=convergence,
        agreeing=float((below[..., 1] & ~below[..., 0]).all(axis=(0, 2)).mean()),
        draws=draws,
        seed=seed,
        axes=tuple(
            low + step * (np.arange(count) + 0.5)
            for low, step, count in zip(grid.lower, grid.step, grid.shape, strict=True)
        ),
        densities=dict(zip(PRINTED, np.nan_to_num(np.swapaxes(density, 1, 2)), strict=True)),
        scene=scene(problem.sensor, problem.prior, truth),
    )


def _update(estimator: PointMassFilter, measurements: Array) -> PointMassBelief:
    """The belief after one measurement (M, B), from the prior."""
    rngs = [np.random.default_rng(0)] * len(measurements)  # nothing is drawn
    *_, (_, _, belief) = filtered(estimator, estimator.problem.prior, (), [measurements], rngs)
    return belief


def _moments(estimator: PointMassFilter, measurements: Array) -> tuple[Array, Array]:
    """Posterior means and standard deviations for measurements (M, B), (M, 2) each, m."""
    mean, covariance, _ = estimator.estimate(_update(estimator, measurements))
    return mean, np.sqrt(np.diagonal(covariance, axis1=1, axis2=2))


def save(paper: Paper, folder: Path) -> None:
    """Write table1.json and paper.npz, all that `load` needs."""
    folder.mkdir(parents=True, exist_ok=True)
    write_json(folder / "table1.json", paper.to_json())
    arrays: dict[str, NDArray[Any]] = {
        f"density {beams}": density.astype(np.float32) for beams, density in paper.densities.items()
    }
    arrays |= {f"scene {name}": array for name, array in paper.scene.items()}
    write_npz(folder / "paper.npz", arrays | {"x1": paper.axes[0], "x2": paper.axes[1]})


def load(folder: Path) -> Paper:
    """The example as `save` left it.

    Raises:
        ResultsError: If the folder holds no saved example, or a damaged one.
    """
    try:
        return _read(read_json(folder / "table1.json"), read_npz(folder / "paper.npz"))
    except ResultsError:
        raise
    except Exception as error:  # whatever is not as `save` left it
        cause = one_line(error)[:200]
        raise ResultsError(f"{folder / 'table1.json'} is damaged ({cause}): make it again") from None


def _read(text: Any, saved: Mapping[str, NDArray[Any]]) -> Paper:
    """The example of the two files of a folder."""
    rows = []
    for beams, row in text["table1"].items():
        std, mean, band, percentile = (
            np.array(row[name], dtype=float) for name in ("std_m", "mean_m", "band_std_m", "paper_percentile")
        )
        rows.append(Table1Row(beams, std, mean, PRINTED[beams], band, percentile))
    draws = text["noise_draws"]
    return Paper(
        rows=tuple(rows),
        convergence={
            entry["cell_m"]: np.array(list(entry["std_m"].values()), dtype=float)
            for entry in text["convergence"]
        },
        agreeing=float(draws["share_with_all_printed_figures"]),
        draws=int(draws["count"]),
        seed=int(draws["seed"]),
        axes=(saved["x1"], saved["x2"]),
        densities=_under(saved, "density "),
        scene=_under(saved, "scene "),
    )


def _under(arrays: Mapping[str, Array], prefix: str) -> dict[str, Array]:
    """The arrays whose names begin so, without the prefix."""
    return {name.removeprefix(prefix): array for name, array in arrays.items() if name.startswith(prefix)}
