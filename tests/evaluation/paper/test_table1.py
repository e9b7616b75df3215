"""Table 1 of Stepanov and Mansour."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from rangefix.evaluation.paper import Paper, table1
from rangefix.evaluation.paper.table1 import cut_off_interval, only

CONVERGED = {  # standard deviations for noise-free measurements, m
    "1": (0.6460, 0.9695),
    "2": (1.1547, 0.0500),
    "3": (0.6460, 0.9695),
    "1+2": (0.5928, 0.0326),
    "2+3": (0.5928, 0.0326),
    "1+3": (0.0200, 0.8869),
    "1+2+3": (0.0268, 0.0382),
}


@pytest.fixture(scope="module")
def solved() -> Paper:
    return table1.solve(draws=200)


@pytest.mark.parametrize("beams", CONVERGED)
def test_noise_free_standard_deviations(solved: Paper, beams: str) -> None:
    """Within 0.2 % of the converged values, or half a unit of their last digit."""
    np.testing.assert_allclose(solved.row(beams).std, CONVERGED[beams], rtol=2e-3, atol=5.1e-5)


def test_means_are_mirror_images(solved: Paper) -> None:
    """Beams 1 and 3 mirror each other about x1 = 2 m, and so do the posteriors; 2 leaves x1 in the middle."""
    for left, right in (("1", "3"), ("1+2", "2+3")):
        one, other = solved.row(left).mean, solved.row(right).mean
        np.testing.assert_allclose([4 - one[0], one[1]], other, atol=1e-9)
    for beams in ("2", "1+3", "1+2+3"):
        assert solved.row(beams).mean[0] == pytest.approx(2.0, abs=1e-9)


def test_convergence(solved: Paper) -> None:
    """From cells of 0.02 to cells of 0.01 m nothing changes by 0.3 %."""
    fine, finest = solved.convergence[0.02], solved.convergence[0.01]
    np.testing.assert_allclose(fine, finest, rtol=3e-3)


def test_densities_integrate_to_one(solved: Paper) -> None:
    """Each posterior density sums to one over the room."""
    x1, x2 = solved.axes
    cell = (x1[1] - x1[0]) * (x2[1] - x2[0])
    for density in solved.densities.values():
        assert density.shape == (len(x2), len(x1))
        assert density.sum() * cell == pytest.approx(1.0, abs=1e-9)


def test_the_printed_figures_lie_in_their_bands(solved: Paper) -> None:
    """One draw of the noise explains each of the 14 figures on its own (it need not explain all at once)."""
    assert all(all(row.in_band()) for row in solved.rows)


def test_a_wrong_figure_would_lie_outside(solved: Paper) -> None:
    """Negative control: 0.70 m for beam 1 is in no draw's reach."""
    row = solved.row("1")
    wrong = table1.Table1Row(row.beams, row.std, row.mean, ("0.70", "0.96"), row.band, row.percentile)
    assert wrong.in_band() == [False, True]


def test_cut_off_interval() -> None:
    """Digits stand for all numbers that cut off to them, with a hair of rounding below."""
    low, high = cut_off_interval("0.64")
    assert (low, high) == (pytest.approx(0.64, abs=2e-5), pytest.approx(0.65))
    assert low < 0.64
    assert cut_off_interval("1.1")[1] == pytest.approx(1.2)


def test_only_the_chosen_beams_are_measured() -> None:
    np.testing.assert_array_equal(only(np.array([1.0, 2.0, 3.0]), "1+3"), [1.0, np.nan, 3.0])


def test_saved_and_loaded(solved: Paper, tmp_path: Path) -> None:
    """What is loaded says the same; densities are kept in single precision."""
    table1.save(solved, tmp_path)
    loaded = table1.load(tmp_path)
    assert loaded.to_json() == solved.to_json()
    np.testing.assert_allclose(loaded.densities["1+3"], solved.densities["1+3"], rtol=1e-6, atol=1e-30)
    assert set(loaded.scene) == set(solved.scene)


def test_the_same_seed_gives_the_same_bands(solved: Paper) -> None:
    """Noise draws come from the seed's streams; another seed gives other bands."""
    assert table1.solve(draws=200).to_json() == solved.to_json()
    assert table1.solve(draws=200, seed=1).to_json() != solved.to_json()
