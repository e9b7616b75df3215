"""What users type, before and after the parser: lists of numbers, and mistakes in one line each."""

from __future__ import annotations


def explain(error: Exception) -> list[str] | None:
    """Mistakes of the user, one line each; None for an error that is ours."""
    if hasattr(error, "format_message"):  # a wrong option or argument
        lines = [error.format_message()]
    elif hasattr(error, "mistakes"):  # a study file
        lines = list(error.mistakes)
    elif isinstance(error, KeyError | ValueError | OSError):
        lines = [str(error.args[0]) if isinstance(error, KeyError) and error.args else str(error)]
    else:
        return None
    return [" ".join(line.split()) for line in lines]


def gather_bearings(arguments: list[str]) -> list[str]:
    """Join the numbers after --bearings-deg by commas, so that they may also stand apart."""
    joined: list[str] = []
    gathering = False
    for argument in arguments:
        if gathering and _are_numbers(argument):
            joined[-1] += ("," if joined[-1] else "") + argument.strip(",")
            continue
        gathering = False
        joined.append(argument)
        if argument == "--bearings-deg":
            gathering = True
            joined.append("")
    return [each for each in joined if each] if "--bearings-deg" in arguments else joined


def _are_numbers(text: str) -> bool:
    try:
        return bool([float(part) for part in text.strip(",").split(",")])
    except ValueError:
        return False
