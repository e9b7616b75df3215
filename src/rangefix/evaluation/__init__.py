"""Whether to trust it: Monte Carlo truth against what each estimator claims."""

from .covariance import anees_band, coverage, credibility, is_positive, nees, noncredibility
from .experiment import Experiment, Named
from .intervals import Interval, mean_interval, ratio_interval, share_interval
from .mistakes import StudyError
from .report import write_report
from .results import Results, Trials, load, summarise
from .runner import Progress, run
from .seeds import stream, streams
from .store import ResultsError
from .study import Study, load_study, parse_study, study_names
from .summary import STATUSES, Row, to_csv
from .verdict import Verdict, decide
from .verdict_gates import check_gates, parse_gates

__all__ = [
    "STATUSES",
    "Experiment",
    "Interval",
    "Named",
    "Progress",
    "Results",
    "ResultsError",
    "Row",
    "Study",
    "StudyError",
    "Trials",
    "Verdict",
    "anees_band",
    "check_gates",
    "coverage",
    "credibility",
    "decide",
    "is_positive",
    "load",
    "load_study",
    "mean_interval",
    "nees",
    "noncredibility",
    "parse_gates",
    "parse_study",
    "ratio_interval",
    "run",
    "share_interval",
    "stream",
    "streams",
    "study_names",
    "summarise",
    "to_csv",
    "write_report",
]
