"""Labels of technologies: unique, and one printable line."""

from __future__ import annotations

import pytest

from pixsim.base.errors import MAX_LABEL
from pixsim.sensor.labels import file_label, label_of, labels_of

STUDIES = [
    (["0.35um", "0.25um"], ["0.35um", "0.25um"]),
    (["/home/me/mine.toml", "b/mine.toml", "c.d/mine.toml"], ["mine", "mine-2", "mine-3"]),
    # mine-2 is the plain label of another technology; some file systems ignore case
    (["a/mine.toml", "b/mine.toml", "mine-2.toml"], ["mine", "mine-3", "mine-2"]),
    (["a/Mine.toml", "b/mine.toml"], ["Mine", "mine-2"]),
    (["none", "data sheet.toml"], ["data sheet", "data sheet-2"]),
    (["0.35um", "mine/0.35um.toml"], ["0.35um", "0.35um-2"]),
    (
        [f"a/{'n' * 100}1.toml", f"a/{'n' * 100}2.toml"],
        [f"{'n' * (MAX_LABEL - 1)}…", f"{'n' * (MAX_LABEL - 1)}…-2"],
    ),
]


@pytest.mark.parametrize(("technologies", "labels"), STUDIES)
def test_labels_of_are_unique(technologies: list[str], labels: list[str]) -> None:
    assert list(labels_of(technologies)) == labels
    assert len({file_label(label).casefold() for label in labels}) == len(labels)


def test_label_of_is_one_printable_line() -> None:
    assert label_of("x/two\nlines\t \x1b[31m.toml") == r"two lines \x1b[31m"
    assert label_of("none") == "data sheet"
    assert file_label("data sheet") == "data_sheet"
