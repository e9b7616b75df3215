"""How Sphinx builds these pages: `make docs`. Nothing is fetched, neither to build nor to read them."""

from __future__ import annotations

import re
import sys
from importlib.metadata import version as installed
from pathlib import Path
from typing import Any

from sphinx.application import Sphinx
from sphinx.util.inspect import TypeAliasForwardRef

sys.path.insert(0, str(Path(__file__).parent / "_ext"))

project = "rangefix"
author = "The rangefix developers"
copyright = author
version = release = installed("rangefix")

extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon", "mathml"]
exclude_patterns = ["_build", "_ext", "demo"]
nitpicky = True
# Types without a page here: those of other libraries, and those of ours that no user names.
nitpick_ignore_regex = [
    (
        r"py:.*",
        r"(numpy|np|matplotlib|pandas|pd|xarray|xr|pydantic|annotated_types|pytest)\..*",
    ),
    (r"py:exc", r"\w+"),  # exceptions of ours that a docstring names by their own name alone
    (r"py:.*", r"(collections|pathlib|typing|datetime|types|os)\..*"),
    (
        r"py:.*",
        r"(NDArray|ArrayLike|Array|BoolArray|IntArray|Average|Place|BeliefScores|NullDistribution|Builder|Factory|Belief|FieldInfo|MinLen|NoneType|OneRun|Path|_\w+)",
    ),
    (r"py:.*", r"rangefix\.(maps|filters|evaluation)(\.[a-z_0-9]+)+\.\w+"),
]

# Markdown
myst_enable_extensions = ["dollarmath", "amsmath", "deflist", "colon_fence"]
myst_heading_anchors = 3
myst_links_external_new_tab = False
html_math_renderer = "mathml"
math_number_all = False

# The reference, from docstrings
default_role = "code"  # docstrings write `names` as Markdown does
autodoc_member_order = "groupwise"
autodoc_typehints_format = "short"
autodoc_preserve_defaults = True
TypeAliasForwardRef.__repr__ = lambda self: self.name  # type: ignore[method-assign]
autodoc_type_aliases = {
    name: name for name in ("Array", "ArrayLike", "BoolArray", "IntArray", "Builder", "Factory")
}
python_use_unqualified_type_names = True
python_maximum_signature_line_length = 88
napoleon_numpy_docstring = False
napoleon_use_rtype = False
napoleon_use_ivar = True

# The pages
html_theme = "furo"
html_title = f"rangefix {release}"
html_static_path = ["_static"]
html_css_files = ["site.css"]
html_copy_source = False
html_theme_options = {"navigation_with_keys": True}
highlight_language = "none"
pygments_style = "a11y-high-contrast-light"
pygments_dark_style = "monokai"


COLON = "\N{PRESENTATION FORM FOR VERTICAL COLON}"  # stands for a colon while napoleon reads
FORMULA = 4  # columns by which docstrings indent a formula below the text before it


def name_fields(app: Sphinx, what: str, name: str, obj: Any, options: Any, lines: list[str]) -> None:
    """Lines `field: meaning` of a record are its attributes; a colon in a property's line is just that."""
    if what in ("property", "attribute", "data"):
        lines[:1] = [lines[0].replace(":", COLON)] if lines else []
        return
    fields = getattr(obj, "__annotations__", {}) if what == "class" else {}
    starts = [
        i for i, line in enumerate(lines)
        if (match := re.match(r"(\w+(?:, \w+)*): ", line)) and set(match[1].split(", ")) <= set(fields)
    ]  # fmt: skip
    if not starts:
        return
    end = next((i for i in range(starts[-1], len(lines)) if not lines[i].strip()), len(lines))
    lines[starts[0] : end] = ["Attributes:", *("    " + line for line in lines[starts[0] : end])]


def keep_formulas(app: Sphinx, what: str, name: str, obj: Any, options: Any, lines: list[str]) -> None:
    """Formulas stand indented below a paragraph and stay line by line; elsewhere bars and stars are plain."""
    kept: list[str] = []
    above: str | None = None  # the last line of text, while what follows may be a formula
    inside = 0  # the formula's indent
    for line in (each.replace(COLON, ":") for each in lines):
        indent = len(line) - len(line.lstrip())
        if inside and line.strip() and indent < inside:
            inside = 0
        if inside:
            kept.append(line)
            continue
        below = above is not None and indent == len(above) - len(above.lstrip()) + FORMULA
        if below and line.strip() and not kept[-1].strip():
            kept += [" " * (indent - FORMULA) + "::", "", line]
            inside = indent
            continue
        if line.strip():
            above = None if re.match(r"\s*(:|\.\. |[-*] )", line) else line
        line = re.sub(r"^(\s*:ivar )(\w+(?:, \w+)+):", lambda m: m[1] + m[2].replace(" ", "") + ":", line)
        kept.append(re.sub(r"(?<!\\)([|*])(?=[^`]*(?:`[^`]*`[^`]*)*$)", r"\\\1", line))
    lines[:] = kept


def plain_signature(
    app: Sphinx, what: str, name: str, obj: Any, options: Any, signature: str | None, returned: str | None
) -> tuple[str | None, str | None]:
    """Defaults that are made anew for each object are written as dots, which Sphinx can read."""
    return signature and signature.replace("<factory>", "..."), returned


def skip_fields(app: Sphinx, what: str, name: str, obj: Any, skip: bool, options: Any) -> bool | None:
    """The fields of a named tuple are told of in its docstring, not as "Alias for field number 0"."""
    return True if type(obj).__name__ == "_tuplegetter" else None


def leave_out_gallery(app: Sphinx, name: str, source: list[str]) -> None:
    """The gallery is made by `make docs` and not kept with the code: without it there is no page to list."""
    if name == "index" and not (Path(app.srcdir) / "gallery" / "index.md").is_file():
        source[0] = source[0].replace("\ngallery/index\n", "\n")


def setup(app: Sphinx) -> None:
    """Hook in what is above: before and after napoleon, which has priority 500."""
    app.connect("autodoc-process-docstring", name_fields, priority=400)
    app.connect("autodoc-process-docstring", keep_formulas, priority=900)
    app.connect("source-read", leave_out_gallery)
    app.connect("autodoc-process-signature", plain_signature)
    app.connect("autodoc-skip-member", skip_fields)
