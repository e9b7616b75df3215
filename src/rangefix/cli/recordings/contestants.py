"""The estimators that a recording is put to, with their options, as they are written on the command line."""

from __future__ import annotations

from ...errors import one_line
from ...evaluation.recordings.readers.claimed_poses import is_claimed
from ...evaluation.recordings.replays import Contestant
from ...filters import Problem, build
from ...filters.registry import BUILT_IN
from ..check import read_options
from ..estimators import inspect_estimator, names, refuse_unknown


def read_contestants(given: list[str], options: list[str] | None) -> list[Contestant]:
    """Estimators with their options.

    Args:
        given: Their names.
        options: ESTIMATOR:NAME=VALUE each.

    Raises:
        ValueError: If a name is not known, stands twice, or is that of a plug-in which is not there, or an
            option is none of its estimator's.
    """
    for name in given:
        if not is_claimed(name):
            refuse_unknown(name, names())
    if len(set(given)) < len(given):
        raise ValueError("--estimators: one stands there twice")
    own: dict[str, list[str]] = {name: [] for name in given}
    for text in options or ():
        name, colon, rest = text.partition(":") if "=" in text else ("", "", "")
        while colon and name not in own and ":" in rest:  # a plug-in's name has a colon of its own
            more, _, rest = rest.partition(":")
            name = f"{name}:{more}"
        if name not in own:
            raise ValueError(f"--option {text!r}: write ESTIMATOR:NAME=VALUE for one of {', '.join(given)}")
        if is_claimed(name):
            raise ValueError(f"--option {text!r}: {name} ran elsewhere: it takes no options")
        own[name].append(rest)
    contestants = []
    for name, texts in own.items():
        theirs = name not in BUILT_IN and not is_claimed(name)
        found = inspect_estimator(name) if theirs or texts else None
        if found is not None and found.missing:
            raise ValueError(found.fault)
        read = read_options(texts, found, ours=not theirs) if found is not None and texts else {}
        contestants.append(Contestant(name, read))
    return contestants


def refuse_options(contestants: list[Contestant], problem: Problem) -> None:
    """Refuse options that an estimator cannot be built with, where it can be without them.

    Raises:
        ValueError: If there are such.
    """
    for contestant in contestants:
        if not contestant.options:
            continue
        try:
            build(contestant.name, problem, **contestant.options)
        except (ValueError, TypeError) as error:
            try:
                build(contestant.name, problem)
            except Exception:  # it is for other problems: its row says so
                continue
            raise ValueError(f"--option {contestant.name}: {one_line(error)}") from None
        except Exception:  # of a plug-in's code, or of memory: its row says so
            continue
