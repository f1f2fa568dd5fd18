"""A study of pixels with a stack: its warning, its marks, and light that is prepared once."""

from __future__ import annotations

import warnings
from pathlib import Path

import numpy as np
import pytest
from helpers.tiny import tiny

import pixsim
from pixsim.base.errors import PixsimError
from pixsim.studies.result import curve_table, delta_e_against_pitch

LENS = {"height_um": 100.0, "index": 1.5, "microlens": "square", "shift": "optimal"}
PITCHES_UM = [6.0, 7.0, 9.0, 15.0, 20.0]


def test_study_marks_sizes_where_the_model_is_doubtful(tmp_path: Path) -> None:
    """Fresnel numbers n p²/(4 λ h): one warning, a column, and hollow points; none without microlenses."""
    study = tiny(name="stacked", resolution=96, pitch={"values_um": PITCHES_UM}, pixel={"stack": LENS, "infrared_cut_nm": 650.0})
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        result = pixsim.study(study, tmp_path / "out", jobs=1)
    about = [str(item.message) for item in caught if "Fresnel" in str(item.message)]
    assert len(about) == 1
    assert about[0].startswith("pixel.stack at 6 µm: the microlens has a Fresnel number of 0.2")
    (curve,) = result.curves
    assert curve.fresnel_number is not None
    longest_nm = 1.5 * 36.0 / (4e-3 * 100.0 * curve.fresnel_number[0])
    assert 630.0 < longest_nm <= 655.0  # the last band below the infrared cut
    np.testing.assert_allclose(curve.fresnel_number / curve.fresnel_number[0], np.square(np.array(PITCHES_UM) / 6.0), rtol=1e-12)
    assert curve.doubtful.tolist() == [True, True, True, False, False]
    assert curve.as_dict()["fresnel_number"] == curve_table([curve])["fresnel_number"] == curve.fresnel_number.tolist()
    plate = delta_e_against_pitch(result, [curve])
    assert "Hollow points" in plate.caption
    hollow = [line for line in plate.figure.axes[0].lines if line.get_markerfacecolor() == "white" and len(line.get_xdata()) == 3]
    assert len(hollow) == 1
    np.testing.assert_array_equal(hollow[0].get_xdata(), PITCHES_UM[:3])


def test_study_refuses_a_wrong_stack_before_it_renders(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("pixsim.scene.renderer.render", lambda *_, **__: pytest.fail("rendered"))
    high = {"quantum_efficiency": 0.99, "quantum_efficiency_includes": "microlens"}
    for pixel, message in (
        ({"stack": LENS | {"height_um": 5.0}}, "under microlenses; allowed: at most 8.86"),
        ({"stack": {"microlens": "square"}}, "no height_um and no index"),
        ({"stack": LENS, **high}, "quantum efficiency: got 0.99 at"),
    ):
        with pytest.raises(PixsimError, match=message):
            pixsim.study(tiny(name="wrong", pitch={"values_um": PITCHES_UM}, pixel=pixel), tmp_path / "out", jobs=1)
    assert not (tmp_path / "out").exists()
