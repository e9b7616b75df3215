"""Whether to trust it: Monte Carlo truth against what each estimator claims."""

from .consistency import (
    Interval,
    Metric,
    Row,
    RunBlock,
    Verdict,
    anees_band,
    check_gates,
    coverage,
    credibility,
    decide,
    is_positive,
    mean_interval,
    nees,
    noncredibility,
    parse_gates,
    ratio_interval,
    share_interval,
    to_csv,
)
from .consistency.summarise import summarise
from .experiment import Experiment, NamedEstimator
from .monte_carlo import Progress, run
from .report import write_report
from .results import STATUSES, Results, ResultsError, Trials, load
from .seeds import stream, streams
from .study import Study, StudyError, load_study, parse_study, study_names

Named = NamedEstimator  # its name in 0.1

__all__ = [
    "STATUSES",
    "Experiment",
    "Interval",
    "Metric",
    "Named",
    "NamedEstimator",
    "Progress",
    "Results",
    "ResultsError",
    "Row",
    "RunBlock",
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
