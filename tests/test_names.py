"""Names that were given up do not come back: each said something else than the thing it stood for."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest

import rangefix

ROOT = Path(rangefix.__file__).parent
GIVEN_UP = [
    "evaluation.isolation.look.look",
    "evaluation.isolation.look.Look",
    "evaluation.isolation.look.describe",
    "evaluation.isolation.checks.check_apart",
    "evaluation.isolation.process.Child",
    "evaluation.isolation.process.Stopped",
    "evaluation.isolation.process.Refused",
    "evaluation.isolation.marks",
    "evaluation.monte_carlo.worker.Crew",
    "evaluation.monte_carlo.worker.Unbuilt",
    "evaluation.monte_carlo.worker.Worker.seen",
    "evaluation.monte_carlo.worker.Worker.first_two",
    "evaluation.trials.built_estimator.Contestant",
    "evaluation.trials.built_estimator.BuiltEstimator.of",
    "evaluation.trials.guard.Guard",
    "evaluation.trials.guard.GuardedEstimator.over",
    "evaluation.consistency.accumulator.Judgement",
    "evaluation.consistency.accumulator.Chunk",
    "evaluation.consistency.accumulator.Accumulator.doubts",
    "evaluation.consistency.intervals.Moments.doubt",
    "evaluation.consistency.row.Scores",
    "evaluation.consistency.row.Beliefs",
    "evaluation.paper.table1.Row",
    "evaluation.report.data.Digest",
    "evaluation.report.data.digest",
    "evaluation.results.files.digest",
    "evaluation.consistency.verdict.verdict",
    "evaluation.consistency.verdict.overconfident",
    "evaluation.consistency.formatting.short",
    "evaluation.consistency.formatting.times",
    "evaluation.consistency.formatting.percent",
    "evaluation.consistency.formatting.measured",
    "evaluation.consistency.formatting.name_beams",
    "evaluation.results.folder.whole",
    "evaluation.results.files.sweep",
    "evaluation.results.folder.Plan",
    "evaluation.results.trials.Held",
    "evaluation.results.trials.Saved",
    "evaluation.results.outcome.judged",
    "evaluation.results.outcome.blank",
    "evaluation.results.outcome.joined",
    "evaluation.monte_carlo.environment.surroundings",
    "evaluation.monte_carlo.keys.keys",
    "evaluation.monte_carlo.keys.fingerprint",
    "evaluation.isolation.process.pickled",
    "evaluation.experiment.Named",
    "evaluation.experiment.NamedEstimator.made",
    "evaluation.experiment.NamedEstimator.ours",
    "evaluation.experiment.Experiment.told",
    "evaluation.experiment.Experiment.moves",
    "evaluation.experiment.Experiment.limit",
    "filters.registry.made",
    "filters.plugin_line.located",
    "filters.estimator.draw",
    "filters.adaptive.lattices.mode_gaussians.draws",
    "evaluation.study.sections.clearance_graph.Lattice",
    "filters.models.uniform_prior.lattice",
    "filters.point_mass.cell_error.missed",
    "filters.point_mass.cell_error.missed_about",
    "filters.point_mass.cell_error.add_error",
    "filters.point_mass.mode_shape.pick",
    "filters.point_mass.mode_shape.picks",
    "filters.point_mass.turning_ranges.TurningRanges",
    "filters.point_mass.cell_ranges.EachCell",
    "filters.point_mass.cell_ranges.cast",
    "filters.particle.metropolis.root_of",
    "filters.particle.metropolis.spread_alike",
    "filters.particle.metropolis.within_walls",
    "filters.models.confined.is_clear",
    "filters.models.confined.RowByRow",
    "filters.adaptive.gauss_newton.looked_at",
    "filters.adaptive.range_bounds.shortfalls",
    "filters.adaptive.prediction.predicted.predicted",
    "evaluation.study.sections.prior.roomiest_box",
    "filters.kalman.extended.BatchExtendedKalmanFilter",
    "filters.kalman.unscented.BatchUnscentedKalmanFilter",
]
CONSTANTS = [
    "TURN",
    "LOG_TURN",
    "MOST",
    "PATIENCE",
    "STARTING",
    "GRACE",
    "SLACK",
    "DRAWS",
    "ROUNDING",
    "BLOCK",
    "FEW",
    "LEAST",
    "MUCH",
    "SAID",
    "RUN",
    "SPOT",
    "KEPT",
    "OFTEN",
    "FINE",
    "SOME_FAILED",
    "BAD_INPUT",
    "NOTHING_RAN",
    "GATE_FAILED",
]


def defined(tree: ast.Module, prefix: str) -> set[str]:
    """Qualified names of what a module, and the classes in it, define."""
    names = {prefix}
    for node in tree.body:
        if isinstance(node, ast.FunctionDef | ast.ClassDef):
            names.add(f"{prefix}.{node.name}")
        if isinstance(node, ast.ClassDef):
            names |= {
                f"{prefix}.{node.name}.{each.name}" for each in node.body if isinstance(each, ast.FunctionDef)
            }
        if isinstance(node, ast.Assign):
            targets = [part for target in node.targets for part in ast.walk(target)]
            names |= {f"{prefix}.{target.id}" for target in targets if isinstance(target, ast.Name)}
    return names


@pytest.fixture(scope="module")
def names() -> set[str]:
    """All qualified names of the package, without its own name in front."""
    found: set[str] = set()
    for path in ROOT.rglob("*.py"):
        parts = path.relative_to(ROOT).with_suffix("").parts
        prefix = ".".join(part for part in parts if part != "__init__")
        found |= defined(ast.parse(path.read_text(encoding="utf-8")), prefix)
    return found


def test_no_name_given_up_is_there(names: set[str]) -> None:
    """Exact qualified names of functions, classes, methods and modules."""
    assert not set(GIVEN_UP) & names


def test_a_constant_says_what_of_what(names: set[str]) -> None:
    """None of the short names that meant several things is a constant of any module."""
    constants = {
        name.rpartition(".")[2] for name in names if name.count(".") and name.rpartition(".")[2].isupper()
    }
    assert not set(CONSTANTS) & constants


def test_names_are_found(names: set[str]) -> None:
    """Negative control: names that there are, of each sort, are in the list."""
    assert {
        "evaluation.experiment.Experiment.assumed_problem",
        "filters.registry.build_with",
        "arrays.TWO_PI",
        "maps.readers.open_map",
    } <= names
