"""What every page has: templates that escape, and one script that the page's policy knows by its hash."""

from __future__ import annotations

import base64
import hashlib
import shlex
from pathlib import Path

from jinja2 import Environment, FileSystemLoader, StrictUndefined
from markupsafe import Markup

from ..consistency.formatting import beams_in_words, capital, format_interval, format_number, visible
from ..consistency.null_distribution import LARGE_FACTOR
from ..consistency.verdict import ALARMS
from ..results import FAILURES
from .data import MAX_REASONS_SHOWN, Badge

SCRIPT = Path(__file__).with_name("script.js").read_text(encoding="utf-8")  # the same on every page
SCRIPT_HASH = f"sha256-{base64.b64encode(hashlib.sha256(SCRIPT.encode()).digest()).decode()}"


def environment() -> Environment:
    """Templates that escape whatever is not their own text, and show what could hide or turn text as such."""
    made = Environment(
        loader=FileSystemLoader(Path(__file__).parent),
        autoescape=True,
        undefined=StrictUndefined,
        finalize=lambda value: value if isinstance(value, Markup) else visible(value),
        trim_blocks=True,
        lstrip_blocks=True,
    )
    made.filters |= {"badge": Badge.of, "beams": beams_in_words, "capital": capital}
    made.filters |= {"interval": format_interval, "number": format_number, "shell": shlex.join}
    made.globals |= {"ALARMS": ALARMS, "LARGE_FACTOR": LARGE_FACTOR, "FAILURES": FAILURES}
    made.globals |= {"MAX_REASONS_SHOWN": MAX_REASONS_SHOWN, "SCRIPT_HASH": SCRIPT_HASH}
    made.globals["SCRIPT"] = Markup(SCRIPT)  # ours, and nothing enters it
    return made
