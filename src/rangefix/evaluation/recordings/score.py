"""How an estimator did on a recording: its errors against what it claimed, in memory that does not grow."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field

import numpy as np

from ...arrays import Array
from ...filters import StateSpace
from ..consistency.scores import CorrelationAxes, is_positive
from .frame_offset import LastingError
from .replay import Believed

LEVEL = 0.95  # of the ellipsoids whose coverage is told
FITS_M = 0.1  # a residual of less than that counts as a reading of the map


@dataclass(frozen=True)
class Row:
    """A line of the table of a replay. The scans of one run are no independent trials: there is no interval.

    Attributes:
        estimator: Its name and options.
        scans: How many scans it took.
        judged: After how many of them the true pose is known.
        reason: Why it ended before the recording, or was not built; "" if it did neither.
        position_rmse_m: Root mean square error of the position, m.
        position_claimed_m: What it claims for that: the root of the mean trace of its covariance, m.
        offset_m: Length of the mean error in the frame of the map, m, where that is the same throughout, as
            where the map lies off the frame of the truth; NaN where it is not: see `LastingError`.
        heading_rmse_deg: Of the heading, deg.
        heading_claimed_deg: What it claims for that, deg.
        anees: Mean of e' P^-1 e over 3: 1 where errors are as large as claimed; inf where one is excluded.
        certain: After how many of the scans judged it claims that something is known exactly: its covariance
            is singular.
        coverage: Share of scans whose true pose lies in the ellipsoid claimed to hold it in 95 % of them.
        scans_per_s: Scans in a second of processor time, after the first: move, update and estimate.
        first_scan_s: Processor time of the first scan, which may be taken in by many stages, s.
        residual_median_m: Of readings less the range of the map at the estimate, m.
        residual_share: Share of the readings that are within 0.1 m of the map.
        lost_at: Number of the first scan, from 1, that does not fit the map where the robot was believed to
            be; None if all fit.
        lost_share: Share of the scans that do not fit; NaN where that was not asked.
        end: The last estimate: x1, x2 (m), heading (rad), (3,); None if there is none.
        end_stds: Its claimed deviations, (3,).
    """

    estimator: str
    scans: int = 0
    judged: int = 0
    reason: str = ""
    position_rmse_m: float = np.nan
    position_claimed_m: float = np.nan
    offset_m: float = np.nan
    heading_rmse_deg: float = np.nan
    heading_claimed_deg: float = np.nan
    anees: float = np.nan
    certain: int = 0
    coverage: float = np.nan
    scans_per_s: float = np.nan
    first_scan_s: float = np.nan
    residual_median_m: float = np.nan
    residual_share: float = np.nan
    lost_at: int | None = None
    lost_share: float = np.nan
    end: Array | None = None
    end_stds: Array | None = None


@dataclass
class Score:
    """Sums over the scans of a replay; an error is truth minus estimate, as in studies.

    Attributes:
        space: Of the states.
    """

    space: StateSpace
    scans: int = 0
    judged: int = 0
    certain: int = 0
    first_s: float = 0.0
    seconds: float = 0.0
    covered: int = 0
    watched: int = 0
    lost: int = 0
    lost_at: int | None = None
    nees: float = 0.0
    errors: LastingError = field(default_factory=LastingError)
    squares: Array = field(default_factory=lambda: np.zeros(3))
    variances: Array = field(default_factory=lambda: np.zeros(3))
    residuals: Counter[int] = field(default_factory=Counter)
    last: Believed | None = None

    def add(self, believed: Believed) -> Believed:
        """Count what is believed after a scan; returned as it is."""
        if self.last is None:
            self.first_s = believed.seconds
        else:
            self.seconds += believed.seconds
        self.last, self.scans = believed, self.scans + 1
        self.watched += believed.fit is not None and believed.fit.readings > 0
        if believed.is_lost:
            self.lost += 1
            self.lost_at = believed.step.scan if self.lost_at is None else self.lost_at
        values = believed.residuals[np.isfinite(believed.residuals)]
        self.residuals.update(np.clip(np.round(values * 1000), -100_000, 100_000).astype(int).tolist())
        if believed.truth is None:
            return believed
        error = self.space.difference(believed.truth, believed.mean)
        ratio = float(CorrelationAxes.of(believed.covariance).nees(error))
        self.judged += 1
        self.certain += not is_positive(believed.covariance)
        self.nees += ratio
        self.covered += ratio <= _limit()
        self.errors.add(error[:2])
        self.squares += error**2
        self.variances += np.diagonal(believed.covariance)
        return believed

    def row(self, name: str, reason: str = "") -> Row:
        """What it comes to."""
        if self.last is None:
            return Row(name, reason=reason)
        total = sum(self.residuals.values())
        fits = sum(count for value, count in self.residuals.items() if abs(value) <= 1000 * FITS_M)
        stds = np.sqrt(np.diagonal(self.last.covariance))
        row = {
            "lost_share": self.lost / self.watched if self.watched else np.nan,
            "scans_per_s": (self.scans - 1) / self.seconds if self.seconds else np.nan,
            "first_scan_s": self.first_s,
            "residual_median_m": _median(self.residuals) / 1000,
            "residual_share": fits / total if total else np.nan,
        }
        if self.judged:
            mean, claimed = self.squares / self.judged, self.variances / self.judged
            row |= {
                "position_rmse_m": float(np.sqrt(mean[0] + mean[1])),
                "position_claimed_m": float(np.sqrt(claimed[0] + claimed[1])),
                "offset_m": self.errors.offset(float(np.sqrt(claimed[0] + claimed[1]))),
                "heading_rmse_deg": float(np.rad2deg(np.sqrt(mean[2]))),
                "heading_claimed_deg": float(np.rad2deg(np.sqrt(claimed[2]))),
                "anees": self.nees / self.judged / 3,
                "coverage": self.covered / self.judged,
            }
        return Row(
            name,
            self.scans,
            self.judged,
            reason,
            **row,
            certain=self.certain,
            lost_at=self.lost_at,
            end=self.last.mean,
            end_stds=stds,
        )


def _limit() -> float:
    """What e' P^-1 e of three components stays below in 95 % of honest Gaussian claims."""
    from scipy.special import chdtri

    return float(chdtri(3, 1 - LEVEL))


def _median(counts: Counter[int]) -> float:
    """The median of values that are counted; NaN of none."""
    half, seen = 0.5 * sum(counts.values()), 0
    for value in sorted(counts):
        seen += counts[value]
        if seen >= half:
            return float(value)
    return float("nan")
