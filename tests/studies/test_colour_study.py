"""Studies of colour filters: the monochrome case is that of a study without them, what the errors
are made of adds up, and sizes whose colours mix are left out.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.tiny import COARSE, rows

import pixsim
from pixsim.base.errors import PixsimError
from pixsim.studies.design import cases_of, physics_of
from pixsim.studies.files import load_study
from pixsim.studies.merit import noise_budgets
from pixsim.studies.settings import Study
from pixsim.viewer.merging import merge

pytestmark = pytest.mark.filterwarnings(
    "ignore:.*black level", "ignore:.*Fresnel", "ignore:.*, lens .*left out"
)
SMALL: dict[str, Any] = {
    "name": "filters",
    "technologies": ["4t-bsi"],
    "repeats": 2,
    "resolution": COARSE,
    "camera": {"die_mm": 0.2},
    "pixel": {"stack": {"enabled": False}},
    "display": {"dots": 24},
    "pitch": {"values_um": [2.0, 2.5, 3.0, 4.0, 6.0]},
}
CAMERA = {"sensitivities": "Sony_ILCE-7M4", "peak_quantum_efficiency": 0.65}
FILTERS = {
    "name": "filters",
    "values": [
        {"label": "none", "set": {"pixel": {"bits": 10}}},
        {"label": "RGGB", "set": {"pixel": {"colour": CAMERA}}},
        {
            "label": "quad",
            "set": {"pixel": {"colour": CAMERA | {"pattern": "quad_rggb", "binning": True}}},
        },
    ],
}
STACKED: dict[str, Any] = {"colour": CAMERA, "stack": {"enabled": True}}
TOO_SMALL_UM = [0.45, 0.5, 0.55, 0.6]  # for these filters
STACKS = {
    "name": "stack",
    "values": [
        {"label": "open", "set": {"pixel": {"stack": {"enabled": False}}}},
        {"label": "deep", "set": {"pixel": {"stack": {"enabled": True}}}},
    ],
}


def small(**over: Any) -> Study:
    return Study.model_validate(merge(SMALL, over))


def rows_of(folder: Path, filters: str = "") -> list[dict[str, str]]:
    return [
        {name: value for name, value in row.items() if name not in ("key", "filters", "check")}
        for row in rows(folder)
        if row.get("filters", "") == filters
    ]


def test_study_of_filters(tmp_path: Path) -> None:
    """The chart is grey in colour, too: to a code of the display."""
    pixsim.study(small(), out=tmp_path / "plain", jobs=1)
    study = small(axis=[FILTERS], noise_budget=True)
    result = pixsim.study(study, out=tmp_path / "filters", jobs=1)
    assert rows_of(tmp_path / "filters", "none") == rows_of(tmp_path / "plain")
    budgets = list(noise_budgets(result).values())
    assert ["mosaic" in budget.delta_e for budget in budgets] == [False, True, True]
    for budget in budgets:
        assert sum(budget.parts.values()) == pytest.approx(budget.mean_delta_e, abs=1e-9)

    score = result.case(filters="RGGB").scores("4t-bsi", 2.5, 1)[0]
    assert score.image.shape == (*score.delta_e.shape, 3)
    assert np.ptp(score.ideal, axis=2).max() < 0.02


def test_sizes_whose_colours_mix_are_left_out(tmp_path: Path) -> None:
    """With the reason; the other sizes have the rows of a study that never had them, also when it
    is resumed.
    """
    sizes_um = [1.2, 2.0, 2.5, 3.0, 4.0]
    few = {"pixel": STACKED, "camera": {"die_mm": 0.1}}
    pixsim.study(small(pitch={"values_um": sizes_um}, **few), out=tmp_path / "possible", jobs=1)
    study = small(pitch={"values_um": [0.45, 0.6, *sizes_um]}, **few)
    for _ in range(2):
        with pytest.warns(UserWarning, match=r"0.45, 0.6 µm left out: .*noise gains of"):
            result = pixsim.study(study, out=tmp_path / "all", jobs=1)
        assert result.curves[0].pitch_um.tolist() == sizes_um
        assert list(result.as_dict()["curves"][0]["left_out"]) == ["0.45", "0.6"]
        assert rows_of(tmp_path / "all") == rows_of(tmp_path / "possible")


def test_case_without_possible_sizes_is_left_out_with_the_reason(tmp_path: Path) -> None:
    """The others have their curves; a study of no other case is refused."""
    sizes = {"pitch": {"values_um": [*TOO_SMALL_UM, 0.65]}, "camera": {"die_mm": 0.1}}
    study = small(pixel={"colour": CAMERA}, axis=[STACKS], **sizes)
    with pytest.warns(UserWarning, match="a case is left out: 4t-bsi, deep: 0 of 5 pixel sizes"):
        result = pixsim.study(study, out=tmp_path / "out", jobs=1)
    assert [curve.at for curve in result.curves] == [{"stack": "open"}]
    assert result.as_dict()["left_out"] == list(result.left_out)
    assert result.left_out[0].startswith("4t-bsi, deep: ")

    deep = STACKS | {"values": STACKS["values"][1:]}
    study = small(pixel={"colour": CAMERA}, axis=[deep], resolution=64, **sizes)
    with pytest.raises(PixsimError, match=r"4t-bsi, deep: none of its.*noise gains"):
        pixsim.study(study, out=tmp_path / "none", jobs=1)


def test_packaged_study_of_filters_is_possible() -> None:
    """All cases have possible pixels, of files beside the study."""
    cases = cases_of(load_study("colour"))
    channels = [len(physics_of(case.settings, "4t-bsi", 2.0).channels) for case in cases]
    assert channels == [1, 1, 3, 3, 3, 3, 3, 3, 3, 3]
