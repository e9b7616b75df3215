"""Make the gallery: run each study of gallery.toml with a modest number of runs, draw it, and write the page.

Usage: python docs/make_gallery.py [--runs N] [--draws N] [--out docs/gallery]

Each section of the page is one study and the commands that make its pictures. Results are kept beside the
pictures, so that a second call computes only what has changed.
"""

from __future__ import annotations

import argparse
import runpy
import shutil
import sys
import tomllib
from pathlib import Path
from typing import Any

from rangefix.evaluation import load_study, run
from rangefix.evaluation.drawing import draw
from rangefix.evaluation.figures.catalogue import figure_kinds
from rangefix.evaluation.paper import table1
from rangefix.evaluation.paper.figures import PAPER_FIGURES

HERE = Path(__file__).parent
INTRO = """# Gallery

Every picture comes from one study and from nothing else, by the commands above it. The studies have few runs
here, so that the page is made in minutes; with those of the study files, intervals are narrower. What each
figure shows in general is on the page of [figures](../figures.md).
"""
TITLES = {kind.name: kind.title for kind in (*figure_kinds(), *PAPER_FIGURES)}


def lay_out(
    title: str, text: str, commands: list[str], name: str, folder: Path, pictures: dict[str, str]
) -> list[str]:
    """A section in Markdown; its pictures are copied beside the page, two folders up.

    Args:
        title, text: Above the commands.
        commands: That make the pictures.
        name: Of the study.
        folder: Of its results.
        pictures: Name of a figure -> what is to be seen in this one.
    """
    lines = [f"## {title}", "", text, "", "```console", *(f"$ {command}" for command in commands), "```", ""]
    for figure, caption in pictures.items():
        file = f"{name}_{figure}.png"
        shutil.copyfile(folder / "figures" / f"{figure}.png", folder.parents[1] / file)
        lines += [f"![{TITLES[figure]}: {caption}]({file})", "", f"**{TITLES[figure]}.** {caption}", ""]
    return lines


def the_paper(out: Path, draws: int) -> list[str]:
    """The paper's own figures."""
    folder = out / "results" / "table1"
    table1.save(table1.solve(draws, 0), folder)
    draw(folder)
    text = "Figs. 2 and 3 of Stepanov and Mansour, for measurements without noise."
    commands = [f"rangefix paper --draws {draws} --out results/paper"]
    pictures = {kind.name: f"{kind.caption[0].upper()}{kind.caption[1:]}." for kind in PAPER_FIGURES}
    return lay_out("The paper's figures", text, commands, "paper", folder, pictures)


def a_study(section: dict[str, Any], out: Path, runs: int) -> list[str]:
    """A study: run, drawn, and laid out."""
    target: str = section["study"]
    name, count, mesh = Path(target).stem, min(runs, section["most"]), None
    command = f"rangefix run {target} --runs {count} --out results/{name}"
    folder = out / "results" / name
    if target.endswith(".toml"):
        target, mesh = str(HERE.parent / target), out / "results" / "building.ply"
        command += " --map building.ply"
        make_building(mesh)
    timing = "time" in section["pictures"]
    results = run(load_study(target, runs=count, map_path=mesh), folder, timing=timing)
    draw(folder)
    if failed := sum(len(trials.reasons) for trials in results.trials):
        print(f"gallery: {failed} trials of {name} failed", file=sys.stderr)
    commands = [command, f"rangefix plot results/{name}"]
    return lay_out(section["title"], section["text"], commands, name, folder, section["pictures"])


def make_building(path: Path) -> None:
    """Write the made-up building."""
    runpy.run_path(str(HERE / "demo" / "make_building.py"))["main"](path)


def main() -> None:
    """Make the folder of the gallery."""
    parser = argparse.ArgumentParser(description="Make the gallery of the documentation.")
    parser.add_argument("--runs", type=int, default=200, help="most runs of a study")
    parser.add_argument("--draws", type=int, default=200, help="noise draws for the paper's table")
    parser.add_argument("--out", type=Path, default=HERE / "gallery", help="folder to write")
    options = parser.parse_args()
    sections = tomllib.loads((HERE / "gallery.toml").read_text(encoding="utf-8"))["sections"]
    lines = [INTRO, *the_paper(options.out, options.draws)]
    for section in sections:
        lines += a_study(section, options.out, options.runs)
    (options.out / "index.md").write_text("\n".join(lines), encoding="utf-8")


if __name__ == "__main__":
    main()
