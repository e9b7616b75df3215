"""What the commands `new` and `check` do, without printing."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Iterable
from importlib import resources
from pathlib import Path
from typing import Any


def new_study(target: Path) -> Path:
    """Write a commented study to begin with; `.toml` is added where it is missing.

    Raises:
        ValueError: If there is such a file, or it cannot be written.
    """
    path = target if target.suffix == ".toml" else target.with_name(f"{target.name}.toml")
    text = (resources.files(__package__) / "evaluation" / "starter.toml").read_text(encoding="utf-8")
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


def read_options(given: Iterable[str]) -> dict[str, Any]:
    """Options written as in a study, NAME=VALUE, in m and rad.

    Raises:
        ValueError: If one has no value, or one that a study would not take.
    """
    from .evaluation.schema import EstimatorSection

    options: dict[str, Any] = {}
    for each in given:
        name, equals, value = each.partition("=")
        try:
            options[name.strip()] = tomllib.loads(f"value = {value}")["value"]
        except tomllib.TOMLDecodeError:
            if not equals or not re.fullmatch(r"\s*[A-Za-z][\w.-]*\s*", value):
                raise ValueError(
                    f"--option {each!r}: write NAME=VALUE as in a study, such as cell_m=0.05"
                ) from None
            options[name.strip()] = value.strip()  # a word without quotation marks
    return EstimatorSection(name="-", options=options).converted()


def read_reasons(given: Iterable[str]) -> dict[str, str]:
    """Checks that are expected to fail, CHECK=REASON.

    Raises:
        ValueError: If one has no reason.
    """
    reasons = {}
    for each in given:
        name, equals, reason = each.partition("=")
        if not equals or not reason.strip():
            raise ValueError(f"--expect-failure {each!r}: write CHECK=REASON, the reason in quotation marks")
        reasons[name.strip()] = reason.strip()
    return reasons
