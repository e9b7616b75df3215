"""Equations as MathML, which browsers draw by themselves: no script, no font and no network is needed.

The translation from LaTeX is that of docutils. A formula that it does not know is a warning, and so an error
in `make docs`.
"""

from __future__ import annotations

from typing import Any

from docutils import nodes
from docutils.utils.math import MathError, latex2mathml
from sphinx.application import Sphinx
from sphinx.util import logging
from sphinx.writers.html5 import HTML5Translator

logger = logging.getLogger(__name__)


def mathml(writer: HTML5Translator, node: Any, display: str) -> str:
    """The formula of a node as a `math` element."""
    text = node.astext()
    try:
        tree = latex2mathml.tex2mathml(text, as_block=display == "block")
    except (MathError, SyntaxError) as error:
        logger.warning("cannot draw the formula %r: %s", text, error, location=node)
        return writer.encode(text)
    return str(tree)


def inline(writer: HTML5Translator, node: nodes.math) -> None:
    """A formula in a line."""
    writer.body.append(mathml(writer, node, "inline"))
    raise nodes.SkipNode


def block(writer: HTML5Translator, node: nodes.math_block) -> None:
    """A formula on lines of its own; with a number where it has a label."""
    number = f'<span class="eqno">({node["number"]})</span>' if node.get("number") else ""
    ids = "".join(f' id="{name}"' for name in node["ids"][:1])
    writer.body.append(f'<div class="math"{ids}>{number}{mathml(writer, node, "block")}</div>\n')
    raise nodes.SkipNode


def setup(app: Sphinx) -> dict[str, Any]:
    """Make it the renderer named "mathml"."""
    app.add_html_math_renderer("mathml", (inline, None), (block, None))
    return {"version": "1", "parallel_read_safe": True, "parallel_write_safe": True}
