"""Whether to trust it: Monte Carlo truth against what each estimator claims."""

from .covariance import anees_band, coverage, credibility, is_positive, nees, noncredibility
from .intervals import Interval, mean_interval, ratio_interval, share_interval
from .results import STATUSES, Results, Trials, summarise
from .seeds import stream, streams
from .store import ResultsError
from .summary import Row, to_csv

__all__ = [
    "STATUSES",
    "Interval",
    "Results",
    "ResultsError",
    "Row",
    "Trials",
    "anees_band",
    "coverage",
    "credibility",
    "is_positive",
    "mean_interval",
    "nees",
    "noncredibility",
    "ratio_interval",
    "share_interval",
    "stream",
    "streams",
    "summarise",
    "to_csv",
]
