"""Names of technologies: no path of a machine, no two curves or files of one name."""

import pytest

from pixsim.base.errors import LONGEST_LABEL as LONGEST
from pixsim.sensor.technology import file_label, label_of, labels_of

STUDIES = [
    (["0.35um", "0.25um"], ["0.35um", "0.25um"]),
    (["/home/me/mine.toml", "b/mine.toml", "c.d/mine.toml"], ["mine", "mine-2", "mine-3"]),
    # mine-2 is another one's own name; a file system may not tell Mine from mine
    (["a/mine.toml", "b/mine.toml", "mine-2.toml"], ["mine", "mine-3", "mine-2"]),
    (["a/Mine.toml", "b/mine.toml"], ["Mine", "mine-2"]),
    (["none", "data sheet.toml"], ["data sheet", "data sheet-2"]),
    (["0.35um", "mine/0.35um.toml"], ["0.35um", "0.35um-2"]),
    ([f"a/{'n' * 100}1.toml", f"a/{'n' * 100}2.toml"], [f"{'n' * (LONGEST - 1)}…", f"{'n' * (LONGEST - 1)}…-2"]),
]


@pytest.mark.parametrize(("technologies", "labels"), STUDIES)
def test_labels_are_names_and_no_two_are_alike(technologies: list[str], labels: list[str]) -> None:
    assert list(labels_of(technologies)) == labels
    assert len({file_label(each).casefold() for each in labels}) == len(labels)


def test_a_label_is_one_line_that_steers_no_terminal() -> None:
    assert label_of("x/two\nlines\t \x1b[31m.toml") == r"two lines \x1b[31m"
    assert label_of("none") == "data sheet"
    assert file_label("data sheet") == "data_sheet"
