"""Whether to trust it: Monte Carlo truth against what each estimator claims.

Studies, their running and reports are loaded when they are first asked for: who draws figures, or scores
arrays of their own, need not wait for them.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

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
from .results import STATUSES, Results, ResultsError, Trials, load
from .seeds import stream, streams

if TYPE_CHECKING:
    from .monte_carlo import ClusterTls, Progress, repeat_run, run
    from .report import write_comparison, write_report
    from .study import Study, StudyError, load_study, parse_study, study_names

Named = NamedEstimator  # its name in 0.1

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
_LATER = {
    "monte_carlo": ("ClusterTls", "Progress", "repeat_run", "run"),
    "report": ("write_comparison", "write_report"),
    "study": ("Study", "StudyError", "load_study", "parse_study", "study_names"),
}  # folder -> what it offers


def __getattr__(name: str) -> Any:
    """Load a folder that is not loaded yet, or what it offers."""
    for folder, names in _LATER.items():
        if name == folder or name in names:
            module = import_module(f".{folder}", __name__)
            return module if name == folder else globals().setdefault(name, vars(module)[name])
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__, *_LATER})
