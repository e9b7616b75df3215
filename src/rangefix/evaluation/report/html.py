"""HTML that cannot be broken by what stands in it: every string is escaped unless it was made here."""

from __future__ import annotations

import html
from collections.abc import Iterable
from typing import TypeAlias

from ..consistency import visible

VOID = frozenset({"meta", "link", "img", "br", "line", "rect", "circle"})


class Html(str):
    """Markup made by `tag`: the only strings that are not escaped."""

    __slots__ = ()


Child: TypeAlias = "str | int | float | Iterable[Child] | None"


def text(value: object) -> Html:
    """Anything as escaped text."""
    return Html(html.escape(visible(value), quote=True))


def join(children: Iterable[Child], between: str = "") -> Html:
    """Children one after the other."""
    return Html(text(between).join(_flat(children)))


def _flat(children: Iterable[Child]) -> Iterable[str]:
    for child in children:
        if child is None:
            continue
        if isinstance(child, Html):
            yield child
        elif isinstance(child, str | int | float):
            yield text(child)
        else:
            yield from _flat(child)


def tag(name: str, /, *children: Child, **attributes: object) -> Html:
    """An element; attributes by keyword: `class_` is class, `data_label` is data-label, None is left out."""
    shown = "".join(
        f' {key.rstrip("_").replace("_", "-")}="{text(value)}"'
        for key, value in attributes.items()
        if value is not None and value is not False
    )
    if name in VOID:
        return Html(f"<{name}{shown}>" if name in ("meta", "link", "img", "br") else f"<{name}{shown}/>")
    return Html(f"<{name}{shown}>{join(children)}</{name}>")


def page(title: str, style: str, body: Iterable[Child]) -> str:
    """A whole document. Its policy forbids all but inline style and images: it loads and runs nothing.

    Args:
        title: Of the window.
        style: Our own style sheet; not escaped.
        body: What stands in it.
    """
    policy = (
        "default-src 'none'; style-src 'unsafe-inline'; img-src data:; base-uri 'none'; form-action 'none'"
    )
    head = tag(
        "head",
        tag("meta", charset="utf-8"),
        tag("meta", http_equiv="Content-Security-Policy", content=policy),
        tag("meta", name="viewport", content="width=device-width, initial-scale=1"),
        tag("meta", name="color-scheme", content="light dark"),
        tag("meta", name="referrer", content="no-referrer"),
        tag("link", rel="icon", href="data:,"),
        tag("title", title),
        tag("style", Html(style)),
    )
    return f"<!DOCTYPE html>\n{tag('html', head, tag('body', *body), lang='en')}\n"
