"""The command `new`."""

from __future__ import annotations

import re
from importlib import resources
from pathlib import Path
from typing import Annotated

import typer

from .app import Json, print_json


def new_study(target: Path) -> Path:
    """Write a commented study to begin with; `.toml` is added where it is missing.

    Raises:
        ValueError: If there is such a file, or it cannot be written.
    """
    path = target if target.suffix == ".toml" else target.with_name(f"{target.name}.toml")
    text = (resources.files(f"{__package__.partition('.')[0]}.evaluation.study") / "starter.toml").read_text(
        encoding="utf-8"
    )
    name = re.sub(r'["\\\x00-\x1f]', "_", path.stem)
    text = text.replace("STUDY.toml", path.name.replace("\n", "_")).replace("NAME", name)
    made = False
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with path.open("x", encoding="utf-8") as file:
            made = True
            file.write(text)
    except FileExistsError:
        raise ValueError(f"{path} is there already: choose another name, or remove it") from None
    except OSError as error:
        if made:
            path.unlink(missing_ok=True)
        raise ValueError(f"cannot write {path}: {error.strerror or error}") from None
    return path


def new(
    study: Annotated[Path, typer.Argument(metavar="STUDY", help="The file to write.")], as_json: Json = False
) -> None:
    """Write a commented study to begin with."""
    path = new_study(study)
    if as_json:
        print_json({"study": str(path)})
    else:
        typer.echo(f"{path}   Run it: rangefix run {path}")
