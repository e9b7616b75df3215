"""What numba does again and again, or for nothing, while it compiles: once, or not at all.

- For each call in a loop it looks up what it was compiled to before, and compares the loop's options with
  those of others, thousands of times; its own comparison works out all of some twenty options, set or not.
- For each call it asks all that goes by a name, one after the other, what they make of such arguments, and
  does so at each turn of finding types: what the sum of two numbers is, a hundred times. It is asked once.
- LLVM optimises each function by itself, and then again with all that it calls: our loops only then.

A numba that has other names for this than versions 0.63 to 0.68 do is left as it is there.
"""

from __future__ import annotations

from functools import cache
from typing import Any

from numba.core import codegen, targetconfig
from numba.core.types import functions

__all__ = ["as_numba_does", "compile_quickly"]


def _names_in(kind: Any, method: str) -> set[str]:
    """What the code of a method names; nothing where there is none."""
    code = getattr(getattr(kind, method, None), "__code__", None)
    return set() if code is None else {*code.co_names}


Options: Any = getattr(targetconfig, "TargetConfig", None)
Stack: Any = getattr(targetconfig, "ConfigStack", None)
Asked: Any = getattr(functions, "BaseFunction", None)
Library: Any = getattr(codegen, "CPUCodeLibrary", None)
OPTIONS_ARE_KNOWN = all(hasattr(Options, name) for name in ("_values", "values"))
CALLS_ARE_KNOWN = hasattr(Stack, "top_or_none") and "_impl_keys" in _names_in(Asked, "get_call_type")
PASSES_ARE_KNOWN = {"data_layout", "_function_pass_manager"} <= _names_in(Library, "_optimize_functions")
COMPARED: Any = (Options.__eq__, Options.__hash__) if OPTIONS_ARE_KNOWN else None
ASK: Any = Asked.get_call_type if CALLS_ARE_KNOWN else None
OPTIMISE: Any = Library._optimize_functions if PASSES_ARE_KNOWN else None
KNOWN_CALLS = dict[tuple[Any, ...], tuple[Any, Any]]()  # types of arguments and result, and what does it


def compile_quickly(ours: bool) -> None:
    """Spare numba what can be from now on; `ours`: of the loops of rangefix, LLVM too."""
    if OPTIONS_ARE_KNOWN:
        Options.__eq__, Options.__hash__ = _are_same, _hash
    if CALLS_ARE_KNOWN:
        Asked.get_call_type = _ask_once
    if PASSES_ARE_KNOWN and ours:
        Library._optimize_functions = _lay_out


def as_numba_does() -> None:
    """All as it was."""
    if OPTIONS_ARE_KNOWN:
        Options.__eq__, Options.__hash__ = COMPARED
    if CALLS_ARE_KNOWN:
        Asked.get_call_type = ASK
    if PASSES_ARE_KNOWN:
        Library._optimize_functions = OPTIMISE


def _are_same(one: Any, other: Any) -> Any:
    """Whether all options have the same values; those that neither has set have the same default."""
    if type(one) is not type(other):
        return COMPARED[0](one, other)  # which may be that it cannot tell
    mine, theirs = one._values, other._values
    return mine == theirs or all(getattr(one, name) == getattr(other, name) for name in mine | theirs)


def _hash(options: Any) -> int:
    """Numba's hash, which is of the options' names alone."""
    kind: Any = type(options)
    return _hash_of(kind)


@cache
def _hash_of(kind: Any) -> int:
    return int(COMPARED[1](kind()))


def _ask_once(asked: Any, context: Any, arguments: Any, named: Any) -> Any:
    """The types of a call's arguments and result, as numba found them the first time.

    A name that has come to stand for more since is another one, and so are options that differ.
    """
    options = Stack.top_or_none()
    call = asked, context, tuple(arguments), tuple(named.items()), options
    if call in KNOWN_CALLS:
        types, asked._impl_keys[types.args] = KNOWN_CALLS[call]
    else:
        types = ASK(asked, context, arguments, named)
        KNOWN_CALLS[call] = types, asked._impl_keys[types.args]
    return types


def _lay_out(library: Any, module: Any) -> None:
    """What is left of optimising each function by itself: where the module says how data lie in memory."""
    module.data_layout = library._codegen._data_layout
