"""The code blocks of a page, and how to run them as a reader would: in order, in one folder.

- `python`: run in one namespace for the page; one that begins with `# name.py` is that file.
- `console`: each line that begins with `$ ` is a command, `rangefix ...` or `python FILE ...`, and must end
  with exit code 0. Lines below it must be printed by it, in that order; a line of three dots skips some.
- `toml`: a study, which must be sound; one that begins with `# name.toml` is that file too. A part of a study
  is completed where a comment says so; another comment makes it a floor plan, or appends it to a file.
- Anything else, and whatever cannot run, needs a comment with the reason above it.
"""

from __future__ import annotations

import io
import re
import runpy
import shlex
import sys
import tomllib
from contextlib import redirect_stdout
from dataclasses import dataclass, field
from pathlib import Path
from types import ModuleType

from markdown_it import MarkdownIt

from rangefix.cli import main
from rangefix.evaluation import parse_study
from rangefix.maps import load

SCRIPT = "page"  # what the module is called that a page's Python is run in; its classes can be pickled
DIRECTIVES = ("{toctree}", "{include}")
PART, PARTS = "part of a study", "toml blocks: parts of a study"
REST = {
    "map": '[map]\nkind = "rectangle"\nwidth_m = 4.0\nlength_m = 6.0\n',
    "sensor": "[sensor]\nbearings_deg = [0, 60, 120]\nstd_m = 0.05\n",
    "estimators": '[[estimators]]\nname = "ekf"\n',
}


@dataclass(frozen=True)
class Block:
    """A code block: its language, text, the comment right above it, and its line in the page."""

    language: str
    text: str
    mark: str
    line: int

    @property
    def reason(self) -> str:
        """Why it is not run; "" if it is."""
        return self.mark.removeprefix("not run: ") if self.mark.startswith("not run: ") else ""

    @property
    def file(self) -> str:
        """The file that it is, named in its first line; "" if it is none."""
        found = re.match(r"# (\w+\.(?:py|toml))\n", self.text)
        return found[1] if found else ""


def blocks(text: str) -> list[Block]:
    """All code blocks of a page, fenced or indented, in lists and quotations too; directives are none."""
    found, mark = [], ""
    for token in MarkdownIt().parse(text):
        if token.type == "html_block":
            mark = "".join(re.findall(r"^<!-- (.*) -->\s*$", token.content))
        elif token.type in ("fence", "code_block"):
            language = token.info.split(" ")[0]
            if language not in DIRECTIVES:
                found.append(Block(language, token.content, mark, (token.map or [0])[0] + 1))
            mark = ""
        elif token.block and token.type not in ("list_item_open", "ordered_list_open", "bullet_list_open"):
            mark = ""
    return found


@dataclass
class Page:
    """A page that is being read: its text, and what its blocks have defined so far."""

    name: str
    text: str
    module: ModuleType = field(default_factory=lambda: ModuleType(SCRIPT))
    ran: list[str] = field(default_factory=list)
    skipped: list[str] = field(default_factory=list)

    def run(self) -> None:
        """Run all blocks in the current folder.

        Raises:
            AssertionError: If one does not do what the page says, or is not marked as it must be.
        """
        sys.modules[SCRIPT] = self.module
        for block in blocks(self.text):
            if block.reason:
                self.skipped.append(block.reason)
                continue
            where = f"{self.name}:{block.line}"
            assert block.language in ("python", "console", "toml"), f"{where}: say why this is not run"
            getattr(self, f"_{block.language}")(block, where)
            self.ran.append(block.language)

    def _python(self, block: Block, where: str) -> None:
        if block.file:
            Path(block.file).write_text(block.text, encoding="utf-8")
            runpy.run_path(block.file)
        else:
            code = compile("\n" * block.line + block.text, self.name, "exec", dont_inherit=True)
            exec(code, vars(self.module))

    def _console(self, block: Block, where: str) -> None:
        printed: list[str] = []
        for line in block.text.splitlines():
            if line.startswith("$ "):
                printed = command(line[2:], where)
            elif line.strip() == "...":
                assert printed, f"{where}: nothing more was printed"
            else:
                told = " ".join(line.split())
                assert told in printed, f"{where}: {told!r} was not printed; there was {printed}"
                printed = printed[printed.index(told) + 1 :]

    def _toml(self, block: Block, where: str) -> None:
        if block.mark.startswith("append to "):
            with open(block.mark.removeprefix("append to "), "a", encoding="utf-8") as file:
                file.write(block.text)
            return
        if block.file:
            Path(block.file).write_text(block.text, encoding="utf-8")
        if block.mark == "floor plan":
            path = Path(block.file or "plan.toml")
            path.write_text(block.text, encoding="utf-8")
            load(path)
            return
        lacking = [name for name in REST if name not in tomllib.loads(block.text)]
        marked = block.mark == PART or f"<!-- {PARTS}" in self.text
        assert marked or not lacking, f"{where}: no whole study, and not marked as a part"
        parse_study(block.text + "".join(REST[name] for name in lacking), folder=Path()).experiment()


def command(line: str, where: str) -> list[str]:
    """What a command prints, line by line, spaces squeezed."""
    words = shlex.split(line, comments=True)
    out = io.StringIO()
    arguments = sys.argv
    try:
        with redirect_stdout(out):
            if words[0] == "rangefix":
                sys.argv = words
                main(words[1:])
            assert words[0] == "python", f"{where}: cannot run {words[0]!r} here: mark it, with a reason"
            sys.argv = words[1:]
            runpy.run_path(words[1], run_name="__main__")
    except SystemExit as end:
        code = end.code
    else:
        code = 0
    finally:
        sys.argv = arguments
    assert not code, f"{where}: {line!r} ended with exit code {code}"
    return [" ".join(each.split()) for each in out.getvalue().splitlines() if each.strip()]
