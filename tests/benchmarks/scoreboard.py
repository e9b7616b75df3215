"""What the benchmarks found: one row a comparison, with the machine, versions and threads."""

from __future__ import annotations

import importlib.metadata
import json
import os
import platform
import subprocess
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

HEAD = ("", "rangefix", "against", "its value", "ratio", "target", "")
PACKAGES = (
    "rangefix",
    "numpy",
    "scipy",
    "numba",
    "open3d",
    "filterpy",
    "stonesoup",
    "bayesloop",
    "particles",
    "jax",
    "jaxlib",
    "cuthbert",
    "dynamax",
    "blackjax",
)
NO_TARGET = "-"


@dataclass(frozen=True)
class Row:
    """One comparison. Ratio = theirs / ours, so more is better; a target of None is for information."""

    what: str
    ours: float
    peer: str
    theirs: float
    unit: str
    target: float | None

    @property
    def ratio(self) -> float:
        return self.theirs / self.ours

    @property
    def verdict(self) -> str:
        if self.target is None:
            return ""
        return "reached" if self.ratio >= self.target else "NOT REACHED"

    def cells(self) -> tuple[str, ...]:
        target = NO_TARGET if self.target is None else f">= {self.target:.3g}"
        return (
            self.what, amount(self.ours, self.unit), self.peer, amount(self.theirs, self.unit),
            f"{self.ratio:.3g}", target, self.verdict,
        )  # fmt: skip


@dataclass
class Scoreboard:
    """Rows in the order in which they were found, and what was left out."""

    rows: list[Row] = field(default_factory=list)
    skipped: dict[str, str] = field(default_factory=dict)

    def add(
        self,
        what: str,
        ours: float,
        peer: str,
        theirs: float,
        *,
        unit: str = "s",
        target: float | None = None,
        slack: float = 0.5,
    ) -> None:
        """Note a comparison; fails only below `slack` times the target, so that a busy machine does not."""
        row = Row(what, ours, peer, theirs, unit, target)
        self.rows.append(row)
        assert target is None or row.ratio >= slack * target, " | ".join(row.cells())

    @property
    def ordered(self) -> list[Row]:
        """Lettered benchmarks first, in order of their letters."""
        return sorted(self.rows, key=lambda row: row.what[0] if row.what[1:2] == ":" else "~")

    def lines(self) -> list[str]:
        """The table, and under it what it was measured with."""
        table = [HEAD, *(row.cells() for row in self.ordered)]
        widths = [max(map(len, column)) for column in zip(*table, strict=True)]
        sides = (str.ljust, str.rjust, str.ljust, str.rjust, str.rjust, str.rjust, str.ljust)
        lines = [
            "  ".join(
                side(cell, width) for side, cell, width in zip(sides, cells, widths, strict=True)
            ).rstrip()
            for cells in table
        ]
        about = surroundings()
        versions = ", ".join(f"{name} {number}" for name, number in about["versions"].items())
        verdicts = [row.verdict for row in self.rows if row.target is not None]
        return [
            *lines,
            "",
            f"{verdicts.count('reached')} of {len(verdicts)} targets reached.",
            "Ratio: its value over rangefix's. Shortest of rounds taken in turns, in one process.",
            f"{about['cpu']}, {about['cores']} cores, load {about['load']}; {about['threads']}",
            f"Python {about['python']}; {versions}; commit {about['commit']}",
            *(f"left out: {name}: {reason}" for name, reason in self.skipped.items()),
        ]

    def save(self, path: Path) -> None:
        rows = [{**asdict(row), "ratio": row.ratio, "verdict": row.verdict} for row in self.ordered]
        path.parent.mkdir(parents=True, exist_ok=True)
        document = {**surroundings(), "rows": rows, "skipped": self.skipped}
        path.write_text(json.dumps(document, indent=1) + "\n", encoding="utf-8")


def amount(value: float, unit: str) -> str:
    if unit != "s":
        return f"{value:.3g} {unit}"
    return f"{value:.3g} s" if value >= 1 else f"{1e3 * value:.3g} ms"


def surroundings() -> dict[str, Any]:
    """Machine, versions, threads and commit."""
    import numba

    versions = {}
    for name in PACKAGES:
        try:
            versions[name] = importlib.metadata.version(name)
        except importlib.metadata.PackageNotFoundError:
            continue
    return {
        "cpu": processor(),
        "cores": os.cpu_count(),
        "load": " ".join(f"{load:.1f}" for load in os.getloadavg()),
        "threads": f"numba {numba.get_num_threads()} threads, BLAS 1",
        "python": platform.python_version(),
        "versions": versions,
        "commit": commit(),
    }


def processor() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        return platform.processor()
    return next(
        (line.partition(":")[2].strip() for line in lines if line.startswith("model name")), "unknown"
    )


def commit() -> str:
    """Short hash of the checkout, with a plus sign where it was changed since."""
    answers = []
    for arguments in (["rev-parse", "--short", "HEAD"], ["status", "--porcelain", "--untracked-files=no"]):
        try:
            answers.append(
                subprocess.run(["git", *arguments], capture_output=True, text=True, check=True).stdout
            )
        except (OSError, subprocess.CalledProcessError):
            return "unknown"
    return answers[0].strip() + ("+" if answers[1] else "")
