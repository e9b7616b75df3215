"""Results as tables of other libraries, which are asked for only here."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

import numpy as np

from .files import ResultsError
from .outcome import STATUSES

if TYPE_CHECKING:
    from .results import Results


def to_dataframe(results: Results) -> Any:
    """A pandas.DataFrame: a row for each estimator, set of beams, run and step; m and rad.

    Columns: estimator, beams, run, step, status, reason; for each component NAME its truth NAME_true, its
    estimate NAME and its error NAME_error (truth minus estimate); the claimed covariances P_NAME_NAME;
    log_evidence, improbable; what the estimator says of its own computation, as effective_particles.

    Raises:
        ResultsError: If pandas is not installed.
    """
    pandas = _need("pandas")
    runs, steps, _ = results.truth.shape
    names = results.space.names
    frames = []
    for trials in results.trials:
        errors = results.errors(trials)
        columns: dict[str, Any] = {
            "estimator": trials.estimator,
            "beams": trials.beams,
            "run": np.repeat(np.arange(runs), steps),
            "step": np.tile(np.arange(steps), runs),
            "status": np.repeat(np.array(STATUSES)[trials.status], steps),
            "reason": np.repeat([trials.reasons.get(run, "") for run in range(runs)], steps),
        }
        for i, name in enumerate(names):
            columns[f"{name}_true"] = results.truth[..., i].ravel()
            columns[name] = trials.mean[..., i].ravel()
            columns[f"{name}_error"] = errors[..., i].ravel()
        for i, one in enumerate(names):
            for j, other in enumerate(names[: i + 1]):
                columns[f"P_{other}_{one}"] = trials.covariance[..., j, i].ravel()
        columns |= {"log_evidence": trials.log_evidence.ravel(), "improbable": trials.improbable.ravel()}
        columns |= {name: array.ravel() for name, array in trials.diagnostics.items()}
        frames.append(pandas.DataFrame(columns))
    return pandas.concat(frames, ignore_index=True)


def to_xarray(results: Results) -> Any:
    """An xarray.Dataset with the dimensions estimator, beams, run, step, component, component_2 and beam.

    The variables are truth, measurement, mean, covariance, log_evidence, improbable and status, whose codes
    are places in the attribute `flag_meanings`.

    Raises:
        ResultsError: If xarray is not installed.
    """
    xarray = _need("xarray")
    names, sets = list(results.space.names), (len(results.estimators), len(results.beam_sets))

    def stacked(name: str) -> Any:
        arrays = np.stack([getattr(trials, name) for trials in results.trials])
        return arrays.reshape(*sets, *arrays.shape[1:])

    run, trial = ("run", "step"), ("estimator", "beams", "run")
    return xarray.Dataset(
        {
            "truth": ((*run, "component"), results.truth, {"units": "m, rad"}),
            "measurement": ((*run, "beam"), results.measurement, {"units": "m"}),
            "mean": ((*trial, "step", "component"), stacked("mean")),
            "covariance": ((*trial, "step", "component", "component_2"), stacked("covariance")),
            "log_evidence": ((*trial, "step"), stacked("log_evidence"), {"units": "nats"}),
            "improbable": ((*trial, "step"), stacked("improbable")),
            "status": (trial, stacked("status"), {"flag_meanings": " ".join(STATUSES)}),
        },
        coords={
            "estimator": list(results.estimators),
            "beams": list(results.beam_sets),
            "run": np.arange(results.runs),
            "component": names,
            "component_2": names,
            "beam": np.arange(1, results.measurement.shape[-1] + 1),
        },
        attrs={"name": results.manifest["name"], "seed": results.manifest["seed"]},
    )


def _need(name: str) -> Any:
    try:
        return import_module(name)
    except ModuleNotFoundError:
        raise ResultsError(f"this needs {name}: pip install 'rangefix[frames]'") from None
