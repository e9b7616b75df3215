"""Results that reports are made of, whatever stands in them, and a reader of pages."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from functools import partial
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from rangefix.evaluation import Experiment, NamedEstimator, parse_gates, run, write_report
from rangefix.evaluation.consistency.belief_scores import RANK_DRAWS, belief_arrays, measure
from rangefix.evaluation.results import FolderLayout, read_part, trials_path, write_part
from rangefix.filters import RandomWalk

from ..conftest import PriorOnly, make_problem
from .browser import Browser, browser, missing

VOID = {"meta", "link", "img", "br"}
HOSTILE = (
    "</title></style><script>document.body.remove()</script><img src=x onerror=alert(1)>\"'&\u202e\x00 $x_1$"
)
LABEL = "<b onclick='alert(1)'>bold</b>&amp; " + "unbroken" * 30
NASTY = "</pre><script src='https://example.org/a.js'></script><!-- <svg/onload=alert(1)>"


class Broken:
    """Raises what could break a page."""

    def __init__(self, problem: Any) -> None:
        self.size = problem.space.size

    def init(self, prior: Any, rngs: Any) -> Any:
        raise RuntimeError(NASTY)

    def predict(self, belief: Any, control: Any, rngs: Any) -> Any:
        return belief

    def update(self, belief: Any, measurement: Any, rngs: Any) -> Any:
        return belief

    def estimate(self, belief: Any) -> Any:
        return belief


@pytest.fixture(scope="session")
def study(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Four estimators, one of them failing, on two sets of beams."""
    folder = tmp_path_factory.mktemp("study")
    estimators = {
        "exact": NamedEstimator("point-mass", {"cell": 0.05}),
        "sure": partial(PriorOnly, scale=0.01),
        "cautious": partial(PriorOnly, scale=4.0),
        LABEL: Broken,
    }
    experiment = Experiment(
        make_problem(0.2),
        estimators,
        runs=120,
        seed=2,
        beam_sets=[[1], [1, 2, 3]],
        title=HOSTILE,
        config=NASTY,
        beliefs=True,
    )
    run(experiment, folder, command_line=["rangefix", "run", NASTY])
    return folder


@pytest.fixture(scope="session")
def drive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """One estimator over five measurements, with measures of sampled beliefs in its parts."""
    folder = tmp_path_factory.mktemp("drive")
    problem = make_problem()
    moving = dataclasses.replace(problem, motion=RandomWalk(problem.space, std=np.full(2, 1e-6)))
    experiment = Experiment(moving, {"prior": PriorOnly}, runs=100, controls=np.zeros((4, 0)))
    results = run(experiment, folder, timing=False)
    rng = np.random.default_rng(5)
    plan = FolderLayout.read(results.manifest)
    for first, end in plan.blocks():
        path = trials_path(folder, "prior", "all", first, end)
        draws = rng.uniform([0, 0], [4, 6], size=(5, end - first, RANK_DRAWS, 2))
        found = [measure(draws[t], results.truth[first:end, t], problem.space) for t in range(5)]
        write_part(path, read_part(path) | belief_arrays(found), plan.key("prior", "all", first, end))
    return folder


class Reader(HTMLParser):
    """Counts elements and checks that they nest."""

    def __init__(self) -> None:
        super().__init__()
        self.open: list[str] = []
        self.elements: list[tuple[str, dict[str, str | None]]] = []
        self.data: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.elements.append((tag, dict(attrs)))
        if tag not in VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.elements.append((tag, dict(attrs)))

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        self.data.append(data)


def read(page: str) -> Reader:
    reader = Reader()
    reader.feed(page)
    reader.close()
    assert not reader.open
    return reader


@pytest.fixture(scope="session")
def page(study: Path) -> str:
    return write_report(study, gates=parse_gates(["exact", "sure:anees=0.8:1.25"])).read_text(
        encoding="utf-8"
    )


@pytest.fixture(scope="session")
def three(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """Three folders of one study, the same truths: an estimator stays, one changes, one is new at the end."""
    root = tmp_path_factory.mktemp("three")
    folders = []
    for number, scale in enumerate((1.0, 1.0, 0.4)):
        estimators: dict[str, Any] = {"steady": PriorOnly, "changed": partial(PriorOnly, scale=scale)}
        if number == 2:
            estimators[LABEL] = partial(PriorOnly, jitter=1.0)
        experiment = Experiment(
            make_problem(0.2), estimators, runs=80, seed=3, beam_sets=[[1], [1, 2, 3]], title=HOSTILE,
            name="history", config=NASTY + "\nchanged" * (number == 2),
        )  # fmt: skip
        folders.append(root / f"night {number}")
        run(experiment, folders[-1], timing=False)
    return folders


@pytest.fixture(scope="session")
def window(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Browser]:
    if absent := missing():
        pytest.skip(f"no headless browser: {absent} is not installed")
    with browser(tmp_path_factory.mktemp("profile")) as opened:
        yield opened
