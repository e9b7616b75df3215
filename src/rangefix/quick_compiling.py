"""What numba does again and again, or for nothing, while it compiles: once, or not at all.

- For each call in a loop it looks up what it was compiled to before, and compares the loop's options with
  those of others, thousands of times; its own comparison works out all of some twenty options, set or not.
- For each call it asks all that goes by a name, one after the other, what they make of such arguments, and
  does so at each turn of finding types: what the sum of two numbers is, a hundred times. It is asked once.
- A loop that is put in the place of a call is copied block by block, with every name of the loop each time.
- What an instruction names it looks for in all that the instruction holds, asking of each what it is.
- LLVM optimises each function by itself, and then again with all that it calls: our loops only then.

A numba that has other names for this than versions 0.63 to 0.68 do is left as it is there.
"""

from __future__ import annotations

from collections import defaultdict
from functools import cache
from typing import Any

from numba.core import codegen, ir, targetconfig
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
Instruction: Any = getattr(ir, "Inst", None)
Name: Any = getattr(ir, "Var", None)
Place: Any = getattr(ir, "Loc", None)
Scope: Any = getattr(ir, "Scope", None)
OPTIONS_ARE_KNOWN = all(hasattr(Options, name) for name in ("_values", "values"))
CALLS_ARE_KNOWN = hasattr(Stack, "top_or_none") and "_impl_keys" in _names_in(Asked, "get_call_type")
PASSES_ARE_KNOWN = {"data_layout", "_function_pass_manager"} <= _names_in(Library, "_optimize_functions")
NAMES_ARE_KNOWN = (
    {"define", "redefined", "var_redefinitions", "localvars", "parent", "loc", "VarMap"}
    <= _names_in(Scope, "__init__") | _names_in(Scope, "redefine") | _names_in(Scope, "define")
    and "_con" in _names_in(getattr(ir, "VarMap", None), "__len__")
    and not any(hasattr(kind, "__deepcopy__") for kind in (Scope, Place))
)
USES_ARE_KNOWN = {"Var", "Inst", "list_vars", "_rec_list_vars"} <= _names_in(Instruction, "_rec_list_vars")
LOOK: Any = Instruction._rec_list_vars if USES_ARE_KNOWN else None
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
    if NAMES_ARE_KNOWN:
        Scope.__deepcopy__, Place.__deepcopy__ = _with_names, _itself
    if USES_ARE_KNOWN:
        Instruction._rec_list_vars = _names_of
    if PASSES_ARE_KNOWN and ours:
        Library._optimize_functions = _lay_out


def as_numba_does() -> None:
    """All as it was."""
    if OPTIONS_ARE_KNOWN:
        Options.__eq__, Options.__hash__ = COMPARED
    if CALLS_ARE_KNOWN:
        Asked.get_call_type = ASK
    if NAMES_ARE_KNOWN:
        for kind in (Scope, Place):
            if "__deepcopy__" in vars(kind):
                del kind.__deepcopy__
    if USES_ARE_KNOWN:
        Instruction._rec_list_vars = LOOK
    if PASSES_ARE_KNOWN:
        Library._optimize_functions = OPTIMISE


def _are_same(one: Any, other: Any) -> Any:
    """Whether all options have the same values; those that neither has set have the same default."""
    if type(one) is not type(other):
        return COMPARED[0](one, other)  # which may be that it cannot tell
    mine, theirs = one._values, other._values
    if mine == theirs:
        return True
    kind: Any = type(one)
    usual = _defaults(kind)
    return {**usual, **mine} == {**usual, **theirs}


@cache
def _defaults(kind: Any) -> dict[str, Any]:
    """Options that are not set."""
    return {name: option.default for name, option in kind.options.items()}


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


def _with_names(scope: Any, memo: dict[int, Any]) -> Any:
    """A copy of what names a loop knows, with the same names in it, of which numba reads what they are."""
    copied = memo[id(scope)] = Scope(scope.parent, scope.loc)
    copied.localvars._con = dict(scope.localvars._con)
    copied.redefined = scope.redefined.copy()
    copied.var_redefinitions = defaultdict(set, {name: {*of} for name, of in scope.var_redefinitions.items()})
    return copied


def _itself(place: Any, memo: dict[int, Any]) -> Any:
    """Where in the source something is: nothing changes it."""
    return place


def _names_of(instruction: Any, held: Any) -> list[Any]:
    """The names in what an instruction holds, in their order."""
    kind = type(held)
    if kind is Name:
        return [held]
    if kind is not dict and isinstance(held, Instruction):
        return list(held.list_vars())
    if not isinstance(held, (dict, list, tuple)):
        return []
    names: list[Any] = []
    for each in held.values() if isinstance(held, dict) else held:
        kind = type(each)
        if kind is Name:
            names.append(each)
        elif kind is not Place and kind is not str and each is not None:
            names += _names_of(instruction, each)
    return names


def _lay_out(library: Any, module: Any) -> None:
    """What is left of optimising each function by itself: where the module says how data lie in memory."""
    module.data_layout = library._codegen._data_layout
