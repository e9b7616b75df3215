"""Units of options: declared once, and then held to in the names that studies and commands write."""

from __future__ import annotations

from dataclasses import dataclass

import pytest

from rangefix.evaluation.isolation.look import argument_lines, signature_of
from rangefix.filters import Problem, build, option_units
from rangefix.filters.checks import run_checks
from rangefix.filters.option_units import bare_name, units_of, written_name
from rangefix.filters.registry import BUILT_IN, resolve


@option_units(reach="m", turn="rad")
@dataclass(frozen=True)
class Plugin:
    """A filter.

    Args:
        problem: What may be known.
        reach: How far it looks, and no further; a
            long line. It has a second sentence.
        size: How many.

    Raises:
        ValueError: If it does.
    """

    problem: Problem
    reach: float = 0.5
    turn: float = 0.1
    size: int = 3


@dataclass(frozen=True)
class Heir(Plugin):
    """One that inherits the declaration."""


@pytest.mark.parametrize(
    ("written", "wrong"),
    [
        ("reach_m", ""),
        ("turn_deg", ""),
        ("size", ""),
        ("reach", "takes a length: write reach_m"),
        ("reach_deg", "takes a length: write reach_m"),
        ("turn", "takes an angle: write turn_deg"),
        ("size_m", "takes it without a unit: write size"),
        ("raech_m", "has no such option; did you mean reach_m?"),
    ],
)
@pytest.mark.parametrize("factory", [Plugin, Heir])
def test_a_declared_option_has_one_name(factory: type, written: str, wrong: str) -> None:
    """Every other spelling is refused with the right one."""
    assert signature_of("x", factory).misnamed(written) == wrong


def test_without_a_declaration_units_are_taken_off_and_plain_names_stay() -> None:
    """As for plug-ins of before; a parameter with a unit in its own name is told how to be called."""

    def plain(problem: Problem, reach: float = 0.5, cell_m: float = 0.1) -> None: ...

    info = signature_of("x", plain)
    assert [info.misnamed(name) for name in ("reach", "reach_m", "reach_deg")] == ["", "", ""]
    assert info.misnamed("cell_m").startswith("must call its parameter 'cell'")


@pytest.mark.parametrize("name", BUILT_IN)
def test_options_of_ours_are_written_as_they_are_listed(name: str) -> None:
    """Each listed name is taken, and the bare name of one with a unit is not; each option has its words."""
    info = signature_of(name, resolve(name))
    assert info.units is not None
    assert set(info.about) >= set(info.parameters)
    for written in info.written:
        assert info.misnamed(written) == ""
        assert bare_name(written) == written or info.misnamed(bare_name(written))


def test_a_wrong_declaration_is_told() -> None:
    """A unit that is none, and an option that is none: when it is declared, looked at, and checked."""
    with pytest.raises(ValueError, match="reach='km': the units are m, rad"):
        option_units(reach="km")
    wrong = option_units(raech="m")(dataclass(type("Wrong", (), {"__annotations__": {"problem": Problem}})))
    with pytest.raises(TypeError, match="option_units names raech, no option of it; there are none"):
        units_of(wrong)
    first = run_checks(wrong)[0]
    assert (first.name, first.outcome) == ("can_be_built", "failed")
    assert "raech" in first.detail


def test_python_takes_si() -> None:
    """The declaration changes nothing of what is declared, nor of `build`."""
    assert Plugin.__name__ == "Plugin"
    assert (written_name("turn", units_of(Plugin)), written_name("size", units_of(Plugin))) == (
        "turn_deg",
        "size",
    )
    with pytest.raises(TypeError, match="cell_m"):
        build("point-mass", None, cell_m=0.05)  # type: ignore[arg-type]


def test_lines_of_a_docstring() -> None:
    """The first sentence of each argument, over lines; nothing of other sections."""
    lines = argument_lines((Plugin.__doc__ or "").replace("\n    ", "\n"))
    assert lines == {
        "problem": "What may be known",
        "reach": "How far it looks, and no further; a long line",
        "size": "How many",
    }


def test_what_is_done_without_an_option_is_told() -> None:
    """Of each option of ours that is None unless given: `rangefix estimators` shows no other value."""
    told = {name: signature_of(name, resolve(name)) for name in BUILT_IN}
    unset = {
        (name, option): info.about[option]
        for name, info in told.items()
        for option, default in info.parameters.items()
        if default is None
    }
    assert ("particle", "temper") in unset
    assert [each for each, text in unset.items() if "unless given" not in text] == []
