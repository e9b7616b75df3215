"""Measure how time and memory grow with the size of a problem, and draw it as one figure.

Usage: python docs/make_growth.py [--curves TEXT ...] [--million] [--out docs/benchmarks.md]

Writes a table between two markers of the page, `images/growth.png`, and the numbers as `growth.json` beside
the page. Each point is a process of its own on one thread (Linux only), which does the least size of its
curve first, so that all is imported and compiled. Time is that of the processor, the least of some repeats;
memory is the peak of the resident set, setting up included, minus the resident set before. Curves that are
not named stay as they were measured before; `--million` adds a million runs of the harness, some minutes.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
from pathlib import Path
from time import process_time
from typing import Any

import numpy as np

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE))

from growth_curves import CURVES, HARNESS, Curve, harness  # noqa: E402

from rangefix.evaluation.figures.style import COLOURS, MARKERS, styled  # noqa: E402

START, END = "<!-- Made by `make growth`: do not edit until the next such line. -->", "<!-- Made so far. -->"
LAST = 3  # sizes that a slope is taken over
MOST = 1.1  # of a slope, unless the mathematics says so
LEAST_MB = 8.5  # what setting the problem up takes, for a moment: less says nothing of the size
ONE_REPEAT_S, REPEATS, ALL_REPEATS_S = 0.03, 7, 4.0
MILLION = 1_000_000
COLOURS_KEPT = 64  # in the picture


def memory_mb(line: str) -> float:
    """A line of Linux's counters of this process, MB."""
    lines = Path("/proc/self/status").read_text(encoding="ascii").splitlines()
    return next(int(each.split()[1]) / 1024 for each in lines if each.startswith(line))


def measure(curve: Curve, size: int) -> dict[str, float]:
    """Time and memory of one size, in this process."""
    curve.make(curve.sizes[0])()
    before = memory_mb("VmRSS")
    Path("/proc/self/clear_refs").write_text("5", encoding="ascii")  # forgets the peak so far
    work = curve.make(size)
    start = process_time()
    work()
    best = process_time() - start
    peak, calls = memory_mb("VmHWM") - before, int(max(1, ONE_REPEAT_S // max(best, 1e-6)))
    begun = process_time()
    for _ in range(0 if curve.once else REPEATS):
        start = process_time()
        for _ in range(calls):
            work()
        best = min(best, (process_time() - start) / calls)
        if process_time() - begun > ALL_REPEATS_S:
            break
    return {"size": size, "seconds": best, "mb": max(peak, 0.0)}


def apart(curve: Curve, size: int) -> dict[str, float]:
    """The same in a process of its own, on one thread."""
    threads = dict.fromkeys(("NUMBA_NUM_THREADS", "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"), "1")
    command = [sys.executable, __file__, "--one", str(CURVES.index(curve)), str(size)]
    done = subprocess.run(command, env=os.environ | threads, stdout=subprocess.PIPE, text=True, check=True)
    return dict(json.loads(done.stdout))


def slope(points: list[dict[str, float]], key: str) -> float | None:
    """Of the logarithm against that of the size, over the last sizes; none where they are too small."""
    sizes, values = (np.array([point[each] for point in points[-LAST:]]) for each in ("size", key))
    if key == "mb" and values.min() < LEAST_MB:
        return None
    return float(np.polyfit(np.log(sizes), np.log(values), 1)[0])


def told(value: float | None) -> str:
    """A slope, in bold where it is steep."""
    if value is None:
        return "-"
    text = f"{value:.2f}".replace("-0.00", "0.00")
    return f"**{text}**" if float(text) > MOST else text


def duration(seconds: float) -> str:
    """With three figures."""
    return f"{1e3 * seconds:.3g} ms" if seconds < 1 else f"{seconds:.3g} s"


def megabytes(value: float) -> str:
    """With two or three figures, for less is chance."""
    return f"{value:.0f} MB" if value >= LEAST_MB else f"below {LEAST_MB:g} MB"


def key_of(curve: Curve) -> str:
    """What a curve is called in the file of numbers."""
    return f"{curve.against}: {curve.name}"


def table(found: dict[str, Any]) -> str:
    """The slopes in Markdown, and what so many runs of the harness took."""
    lines = ["| against | what | sizes | time of the largest | slope | memory of the largest | slope |"]
    lines += ["|---" * 7 + "|"]
    for curve in CURVES:
        points = found[key_of(curve)]
        first, last = points[0], points[-1]
        cells = [curve.against, curve.name, f"{first['size']:,} to {last['size']:,}"]
        cells += [duration(last["seconds"]), told(slope(points, "seconds"))]
        cells += [megabytes(last["mb"]), told(slope(points, "mb"))]
        lines.append("| " + " | ".join(cells) + " |")
    points = found[key_of(next(curve for curve in CURVES if curve.make is harness))]
    names = ["".join([name, *(f" {a}={b}" for a, b in given.items())]) for name, given in HARNESS.items()]
    told_of = "results on disk, summary included, no timing pass"
    lines += ["", f"Runs of the harness ({', '.join(names)}; {told_of}):", ""]
    lines += ["| runs | time | a run | memory |", "|---|---|---|---|"]
    for point in points:
        each = f"{1e6 * point['seconds'] / point['size']:.0f} us"
        cells = [f"{point['size']:,}", duration(point["seconds"]), each, megabytes(point["mb"])]
        lines.append("| " + " | ".join(cells) + " |")
    return "\n".join(lines)


def draw(found: dict[str, Any], path: Path) -> None:
    """Time and memory over the size, a row for each kind of size, with slopes beside it."""
    from matplotlib.figure import Figure
    from PIL import Image  # comes with matplotlib

    kinds = list(dict.fromkeys(curve.against for curve in CURVES))
    with styled():
        figure = Figure(figsize=(9.6, 2.15 * len(kinds)), layout="constrained")
        for row, kind in zip(figure.subplots(len(kinds), 2), kinds, strict=True):
            shown = [curve for curve in CURVES if curve.against == kind]
            for panel, key, factor, unit in zip(
                row, ("seconds", "mb"), (1e3, 1), ("time, ms", "memory, MB"), strict=True
            ):
                for place, curve in enumerate(shown):
                    points = found[key_of(curve)]
                    slopes = [told(slope(points, each)).strip("*") for each in ("seconds", "mb")]
                    panel.plot(
                        [point["size"] for point in points], [factor * point[key] for point in points],
                        label=f"{curve.name}:  {slopes[0]};  {slopes[1]}", color=COLOURS[place],
                        marker=MARKERS[place], markersize=4, linewidth=1.2,
                    )  # fmt: skip
                panel.set(xscale="log", yscale="log", xlabel=kind, ylabel=unit)
                ends = np.array(row[0].get_xlim())
                span = panel.get_ylim() if key == "seconds" else (1.0, max(300.0, panel.get_ylim()[1]))
                panel.set(xlim=ends, ylim=span)
                middle = np.sqrt(np.prod(panel.get_ylim()) / np.prod(ends))
                panel.plot(ends, middle * ends, color="0.75", linewidth=3, zorder=0)
                panel.grid(alpha=0.25, linewidth=0.5)
            title = "slopes of time; memory"
            row[1].legend(title=title, loc="center left", bbox_to_anchor=(1.02, 0.5), frameon=False)
        figure.savefig(path, dpi=100)
    Image.open(path).quantize(COLOURS_KEPT).save(path, optimize=True)  # a third of the bytes


def main() -> None:
    """Measure, and write the page."""
    parser = argparse.ArgumentParser(description="How time and memory grow.")
    parser.add_argument(
        "--curves", nargs="*", default=[""], help="parts of names; none: only write what is known"
    )
    parser.add_argument("--million", action="store_true", help="a million runs of the harness as well")
    parser.add_argument("--out", type=Path, default=HERE / "benchmarks.md", help="page to write into")
    parser.add_argument("--one", nargs=2, type=int, help=argparse.SUPPRESS)
    given = parser.parse_args()
    if given.one:
        print(json.dumps(measure(CURVES[given.one[0]], given.one[1])))
        return
    numbers = given.out.parent / "growth.json"
    found = json.loads(numbers.read_text(encoding="utf-8")) if numbers.exists() else {}
    for curve in CURVES:
        if not any(part in key_of(curve) for part in given.curves):
            continue
        points = []
        for size in (*curve.sizes, *([MILLION] if given.million and curve.make is harness else [])):
            points.append(apart(curve, size))
            print(f"{key_of(curve)}: {size} {points[-1]}", file=sys.stderr, flush=True)
        found[key_of(curve)] = points
        numbers.write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")
    before, _, rest = given.out.read_text(encoding="utf-8").partition(START)
    after = rest.partition(END)[2]
    given.out.write_text(f"{before}{START}\n\n{table(found)}\n\n{END}{after}", encoding="utf-8")
    draw(found, given.out.parent / "images/growth.png")
    print(f"Written: {given.out}")


if __name__ == "__main__":
    main()
