"""Whether to trust it: Monte Carlo truth against what each estimator claims."""

from .covariance import anees_band, coverage, credibility, is_positive, nees, noncredibility
from .experiment import Experiment, Named
from .intervals import Interval, mean_interval, ratio_interval, share_interval
from .results import Results, Trials, load, summarise
from .runner import Progress, run
from .seeds import stream, streams
from .store import ResultsError
from .summary import STATUSES, Row, to_csv

__all__ = [
    "STATUSES",
    "Experiment",
    "Interval",
    "Named",
    "Progress",
    "Results",
    "ResultsError",
    "Row",
    "Trials",
    "anees_band",
    "coverage",
    "credibility",
    "is_positive",
    "load",
    "mean_interval",
    "nees",
    "noncredibility",
    "ratio_interval",
    "run",
    "share_interval",
    "stream",
    "streams",
    "summarise",
    "to_csv",
]
