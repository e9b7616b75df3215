"""docs/studies.md: every example is a study or a part of one, and every key of a study stands on the page."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path

import pytest
from pydantic import BaseModel

from rangefix.evaluation import Study, parse_study, study_names
from rangefix.evaluation.study.sections.base import kinds_of
from rangefix.evaluation.study.sections.sensor import SensorSection

PAGE = Path(__file__).parents[3] / "docs" / "studies.md"
if not PAGE.is_file():  # a source distribution has it, an installed package has not
    pytest.skip("the page is not there", allow_module_level=True)
TEXT = PAGE.read_text(encoding="utf-8")
EXAMPLES = re.findall(r"```toml\n(.*?)```", TEXT, re.S)
REST = {
    "map": '[map]\nkind = "rectangle"\nwidth_m = 4.0\nlength_m = 6.0\n',
    "sensor": "[sensor]\nbearings_deg = [0, 60, 120]\nstd_m = 0.05\n",
    "estimators": '[[estimators]]\nname = "ekf"\n',
}


def whole(example: str) -> str:
    """The example with the sections that it lacks."""
    return example + "".join(text for name, text in REST.items() if name not in tomllib.loads(example))


@pytest.mark.parametrize("example", EXAMPLES)
def test_examples_are_sound(example: str) -> None:
    """Each is read and built without a mistake."""
    made = parse_study(whole(example)).experiment()
    assert made.runs > 0


def test_there_are_examples() -> None:
    assert len(EXAMPLES) > 20
    assert [example for example in EXAMPLES if whole(example) == example]


def models() -> list[type[BaseModel]]:
    """All sections, of every kind."""
    fields = [*Study.model_fields.values(), SensorSection.model_fields["noise"]]
    return [Study, *(model for field in fields for model in kinds_of(field).values())]


@pytest.mark.parametrize("model", models(), ids=lambda model: model.__name__)
def test_every_key_stands_on_the_page(model: type[BaseModel]) -> None:
    for name, field in model.model_fields.items():
        key = field.alias or name
        assert re.search(rf"[`\[.]{key}\b|^{key} =|, {key}\b|{{ {key} =", TEXT, re.M), (
            f"{model.__name__}.{key}"
        )
    kind = model.model_fields.get("kind")
    if kind is not None:
        (name,) = kinds_of(model)
        assert f'"{name}"' in TEXT


@pytest.mark.parametrize("name", study_names())
def test_every_study_stands_on_the_page(name: str) -> None:
    assert re.search(rf"^\|.*\b{name}\b", TEXT, re.M)
