"""Messages mend what they refuse: the nearest name, and the table that a field belongs into."""

from __future__ import annotations

import warnings
from pathlib import Path

import pytest
from helpers.commands import assert_refused, command

from pixsim.base.config import checked
from pixsim.base.errors import PixsimError
from pixsim.base.parameters import Layer, Run, Study


@pytest.mark.parametrize(
    ("line", "mended"),
    [
        ("run cfs", "Did you mean 'csf'?"),
        ("plan macbet", "Did you mean 'macbeth'?"),
        ("study chen200", "Did you mean 'chen2000'?"),
        ("run csf --pixel.technology 0.35", "Did you mean '0.35um'?"),
    ],
)
def test_a_misspelt_name_is_answered_with_the_nearest(
    line: str, mended: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    assert_refused(*command(line), [mended])
    assert list(tmp_path.iterdir()) == []


def test_a_name_that_is_near_nothing_is_answered_with_all_of_them() -> None:
    code, _, err = command("run qwertz")
    assert (code, "Did you mean" in err, "still_life" in err) == (2, False, True)


def test_a_field_above_its_table_is_told_where_it_belongs() -> None:
    with pytest.raises(PixsimError, match=r"a\.toml: f_number: unknown name; .* It belongs into \[camera\]\."):
        checked(Run, [Layer({"f_number": 2.8}, "a.toml")])
    with pytest.raises(PixsimError, match=r"min_um: unknown name; .* It belongs into \[pitch\]\."):
        checked(Study, [Layer({"name": "a", "min_um": 2.8}, "a.toml")])
    with pytest.raises(PixsimError, match=r"pixl: unknown name; .* Did you mean 'pixel'\?"):
        checked(Run, [Layer({"pixl": {}})])


def test_a_study_without_a_quick_table_says_that_it_is_done_in_full(tmp_path: Path) -> None:
    small = 'name = "own"\nrepeats = 2\n[pitch]\nvalues_um = [6, 7, 8, 10, 12]\n[display]\ndots = 64\n'
    (tmp_path / "own.toml").write_text(small, encoding="utf-8")
    with warnings.catch_warnings():
        warnings.simplefilter("always")
        film = "-D resolution=64 -D spp=4"
        code, _, err = command(f"study {tmp_path / 'own.toml'} {film} --quick --jobs 1 --out {tmp_path / 'out'}")
    assert code == 0, err
    assert "warning: the study own has no [quick] table: it is done in full" in err
