"""Results as tables of other libraries, which are asked for only here."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from importlib import import_module
from typing import Any

import numpy as np

from ...arrays import Array
from ...filters import StateSpace
from .files import ResultsError
from .outcome import STATUSES
from .trials import Trials

UNITS = {"heading": "rad", "v1": "m/s", "v2": "m/s"}  # of components; all else is in m


def to_dataframe(space: StateSpace, truth: Array, trials: Sequence[Trials]) -> Any:
    """A pandas.DataFrame: a row for each estimator, set of beams, run and step; m and rad.

    Columns: estimator, beams, run, step, status, reason; for each component NAME its truth NAME_true, its
    estimate NAME and its error NAME_error (truth minus estimate); the claimed covariances P_NAME_NAME;
    log_evidence, improbable; what the estimator says of its own computation, as effective_particles.

    Raises:
        ResultsError: If pandas is not installed.
    """
    pandas = _need("pandas")
    runs, steps, _ = truth.shape
    frames = []
    for trial in trials:
        errors = space.difference(truth, trial.mean)
        columns: dict[str, Any] = {
            "estimator": trial.estimator,
            "beams": trial.beams,
            "run": np.repeat(np.arange(runs), steps),
            "step": np.tile(np.arange(steps), runs),
            "status": np.repeat(np.array(STATUSES)[trial.status], steps),
            "reason": np.repeat([trial.reasons.get(run, "") for run in range(runs)], steps),
        }
        for i, name in enumerate(space.names):
            columns[f"{name}_true"] = truth[..., i].ravel()
            columns[name] = trial.mean[..., i].ravel()
            columns[f"{name}_error"] = errors[..., i].ravel()
        for i, name in enumerate(space.names):
            for j, other in enumerate(space.names[: i + 1]):
                columns[f"P_{other}_{name}"] = trial.covariance[..., j, i].ravel()
        columns |= {"log_evidence": trial.log_evidence.ravel(), "improbable": trial.improbable.ravel()}
        columns |= {name: array.ravel() for name, array in trial.diagnostics.items()}
        frames.append(pandas.DataFrame(columns))
    return pandas.concat(frames, ignore_index=True)


def to_xarray(
    space: StateSpace,
    truth: Array,
    measurement: Array,
    trials: Sequence[Trials],
    attributes: Mapping[str, Any],
) -> Any:
    """An xarray.Dataset with the dimensions estimator, beams, run, step, component, component_2 and beam.

    The variables are truth, measurement, mean, covariance, log_evidence, improbable and status, whose codes
    are places in the attribute `flag_meanings`. The attribute `units` has those of the components in turn.

    Raises:
        ResultsError: If xarray is not installed.
    """
    xarray = _need("xarray")
    names = list(space.names)
    units = {"units": ", ".join(UNITS.get(name, "m") for name in names)}
    estimators = list(dict.fromkeys(trial.estimator for trial in trials))
    beam_sets = list(dict.fromkeys(trial.beams for trial in trials))

    def stacked(name: str) -> Any:
        arrays = np.stack([getattr(trial, name) for trial in trials])
        return arrays.reshape(len(estimators), len(beam_sets), *arrays.shape[1:])

    run, trial = ("run", "step"), ("estimator", "beams", "run")
    return xarray.Dataset(
        {
            "truth": ((*run, "component"), truth, units),
            "measurement": ((*run, "beam"), measurement, {"units": "m"}),
            "mean": ((*trial, "step", "component"), stacked("mean"), units),
            "covariance": ((*trial, "step", "component", "component_2"), stacked("covariance")),
            "log_evidence": ((*trial, "step"), stacked("log_evidence"), {"units": "nats"}),
            "improbable": ((*trial, "step"), stacked("improbable")),
            "status": (trial, stacked("status"), {"flag_meanings": " ".join(STATUSES)}),
        },
        coords={
            "estimator": estimators,
            "beams": beam_sets,
            "run": np.arange(len(truth)),
            "component": names,
            "component_2": names,
            "beam": np.arange(1, measurement.shape[-1] + 1),
        },
        attrs=dict(attributes),
    )


def _need(name: str) -> Any:
    try:
        return import_module(name)
    except ModuleNotFoundError:
        raise ResultsError(f"this needs {name}: pip install 'rangefix[frames]'") from None
