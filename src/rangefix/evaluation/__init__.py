"""Whether to trust it: Monte Carlo truth against what each estimator claims.

Names are loaded when they are first asked for: who draws figures need not wait for what runs studies.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from ..lazy_names import offered_by

if TYPE_CHECKING:
    from .comparison.fusion import Fusion, fuse_estimates
    from .comparison.paired import PairedComparison, compare_estimators
    from .comparison.table import comparison_table
    from .comparison.worst_runs import WorstRun, worst_runs
    from .consistency.averages import ratio_interval
    from .consistency.from_arrays import coverage, credibility, noncredibility
    from .consistency.gates import check_gates, parse_gates
    from .consistency.intervals import Interval, mean_interval, share_interval
    from .consistency.metrics import Metric, RunBlock
    from .consistency.row import Row, to_csv
    from .consistency.scores import anees_band, is_positive, nees
    from .consistency.summarise import summarise
    from .consistency.verdict import Verdict, decide
    from .experiment import Experiment, NamedEstimator
    from .monte_carlo import ClusterTls, Progress, repeat_run, run
    from .report import write_comparison, write_report
    from .results import STATUSES, Results, ResultsError, Trials, load
    from .seeds import stream, streams
    from .study import Study, StudyError, load_study, parse_study, study_names

    Named = NamedEstimator

__all__ = [
    "STATUSES",
    "ClusterTls",
    "Experiment",
    "Fusion",
    "Interval",
    "Metric",
    "Named",
    "NamedEstimator",
    "PairedComparison",
    "Progress",
    "Results",
    "ResultsError",
    "Row",
    "RunBlock",
    "Study",
    "StudyError",
    "Trials",
    "Verdict",
    "WorstRun",
    "anees_band",
    "check_gates",
    "compare_estimators",
    "comparison_table",
    "coverage",
    "credibility",
    "decide",
    "fuse_estimates",
    "is_positive",
    "load",
    "load_study",
    "mean_interval",
    "nees",
    "noncredibility",
    "parse_gates",
    "parse_study",
    "ratio_interval",
    "repeat_run",
    "run",
    "share_interval",
    "stream",
    "streams",
    "study_names",
    "summarise",
    "to_csv",
    "worst_runs",
    "write_comparison",
    "write_report",
]
_MODULES = {
    "comparison.fusion": ("Fusion", "fuse_estimates"),
    "comparison.paired": ("PairedComparison", "compare_estimators"),
    "comparison.table": ("comparison_table",),
    "comparison.worst_runs": ("WorstRun", "worst_runs"),
    "consistency.averages": ("ratio_interval",),
    "consistency.from_arrays": ("coverage", "credibility", "noncredibility"),
    "consistency.gates": ("check_gates", "parse_gates"),
    "consistency.intervals": ("Interval", "mean_interval", "share_interval"),
    "consistency.metrics": ("Metric", "RunBlock"),
    "consistency.row": ("Row", "to_csv"),
    "consistency.scores": ("anees_band", "is_positive", "nees"),
    "consistency.summarise": ("summarise",),
    "consistency.verdict": ("Verdict", "decide"),
    "experiment": ("Experiment", "NamedEstimator"),
    "monte_carlo": ("ClusterTls", "Progress", "repeat_run", "run"),
    "report": ("write_comparison", "write_report"),
    "results": ("STATUSES", "Results", "ResultsError", "Trials", "load"),
    "seeds": ("stream", "streams"),
    "study": ("Study", "StudyError", "load_study", "parse_study", "study_names"),
}  # module -> what it offers
_OLDER = {"Named": "NamedEstimator"}  # its name in 0.1
__getattr__, __dir__ = offered_by(__name__, _MODULES, _OLDER)
