"""Every figure a function of saved results and of nothing else."""

from .catalogue import FigureKind
from .data import FigureData
from .layout import Layout
from .plots import (
    Artists,
    plot_anees,
    plot_covariance,
    plot_efficiency,
    plot_errors,
    plot_map,
    plot_posterior,
    plot_ranks,
    plot_runs,
    plot_steps,
    plot_time,
    plot_ways,
)

__all__ = [
    "Artists",
    "FigureData",
    "FigureKind",
    "Layout",
    "plot_anees",
    "plot_covariance",
    "plot_efficiency",
    "plot_errors",
    "plot_map",
    "plot_posterior",
    "plot_ranks",
    "plot_runs",
    "plot_steps",
    "plot_time",
    "plot_ways",
]
