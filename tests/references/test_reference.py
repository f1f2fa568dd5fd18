"""The reference in docs/ says what the code says, and can be read without a site."""

import inspect
import re
import sys
from pathlib import Path

import pytest
from helpers.public_names import CLASSES, PUBLIC

DOCS = Path(__file__).parents[2] / "docs"
if not (DOCS / "conf.py").is_file():
    pytest.skip("the tests are installed without the pages' sources", allow_module_level=True)
sys.path.insert(0, str(DOCS))

import reference_text  # noqa: E402

PAGES = reference_text.pages()


@pytest.mark.parametrize("path", PAGES, ids=lambda path: path.relative_to(DOCS).as_posix())
def test_text_is_up_to_date(path: Path) -> None:
    page = path.read_text(encoding="utf-8")
    assert page == reference_text.updated(page), "run python docs/reference_text.py"


def test_text_has_every_public_name() -> None:
    """The site's own test looks for the same names there, and for the fields of records."""
    headings = {
        name
        for path in PAGES
        for name in re.findall(r"^#+ `([\w.]+)`$", path.read_text(encoding="utf-8"), re.MULTILINE)
    }
    described = [reference_text.thing_of(name) for name in headings if name.startswith("pixsim.")]
    for name, thing in PUBLIC.items():
        owner, _, member = name.rpartition(".")
        if owner in CLASSES:  # a method stands under its class, or under one that it comes from
            assert {f"{kind.__name__}.{member}" for kind in CLASSES[owner].__mro__} & headings, name
        else:
            function = (
                inspect.unwrap(thing) if inspect.isfunction(thing) else thing
            )  # without the checks of its arguments
            assert any(function is described_thing for described_thing in described), name


def test_site_has_a_directive_for_each_text() -> None:
    for path in PAGES:
        page = path.read_text(encoding="utf-8")
        names = [name for name, _ in reference_text.SPAN.findall(page) if name != "commands"]
        made = reference_text.with_directives(page)
        assert re.findall(r"^\.\. auto\w+:: (.+)$", made, re.MULTILINE) == names
        assert "### `" not in made
