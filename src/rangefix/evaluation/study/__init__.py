"""A study: what may stand in a file, and the experiment that it describes."""

from .mistakes import StudyError
from .read import load_study, parse_study, study_names
from .sections.estimators import EstimatorSection
from .study import Study

__all__ = ["EstimatorSection", "Study", "StudyError", "load_study", "parse_study", "study_names"]
