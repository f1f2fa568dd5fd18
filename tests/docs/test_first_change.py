"""The changes of docs/first_change.md fit the files that they name;
tests/references/test_pages.py makes them.
"""

from types import SimpleNamespace

from helpers.documents import ROOT
from references.pages import blocks_of, differences

from pixsim.studies.design import cases_of
from pixsim.studies.files import load_study
from pixsim.studies.settings import Study

PAGE = ROOT / "docs/first_change.md"


def test_lines_before_are_there_once() -> None:
    blocks = [(name, before) for name, before, _ in differences(PAGE.read_text(encoding="utf-8"))]
    assert len(blocks) > 6
    for name, before in blocks:
        assert (ROOT / name).read_text(encoding="utf-8").count(before) == 1, f"{name}:\n{before}"


def test_axis_in_python_has_a_case_of_each_value() -> None:
    (block,) = (
        block for block in blocks_of(PAGE.read_text(encoding="utf-8")) if block.language == "python"
    )
    studies: list[Study] = []
    exec(
        block.text,
        {
            "pixsim": SimpleNamespace(
                study=lambda name, out, quick, **more: studies.append(load_study(name, **more))
            )
        },
    )
    assert [case.settings.pixel.row_noise_e for case in cases_of(studies[0])] == [0.0, 3.0, 10.0]
