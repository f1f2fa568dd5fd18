"""The packaged cameras: complete, as their licence and their index say."""

from __future__ import annotations

import csv

import numpy as np
import pytest

from pixsim.base.errors import PixsimError
from pixsim.sensor.camera_data import FOLDER, camera_names, camera_sensitivities, has_common_scale


def test_all_cameras_of_the_index_are_there_with_licence_and_notice() -> None:
    assert len(camera_names()) == 52
    assert {path.stem for path in FOLDER.glob("*.csv")} == {*camera_names(), "index"}
    assert "Apache License" in (FOLDER / "LICENSE").read_text(encoding="utf-8")
    assert "Academy Software Foundation" in (FOLDER / "NOTICE").read_text(encoding="utf-8")


def test_peaks_are_those_of_the_index() -> None:
    """The index was made from the source: a column or a file that was swapped would have another peak or peak wavelength."""
    with (FOLDER / "index.csv").open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    for row in rows:
        wavelength_nm, responses = camera_sensitivities(row["file"].removesuffix(".csv"))
        assert (wavelength_nm == np.arange(380.0, 781.0, 5.0)).all()
        assert responses.shape == (81, 3)
        assert responses.min() >= 0
        assert responses.max(axis=0) == pytest.approx([float(row[f"peak_{channel}"]) for channel in "rgb"], rel=1e-5)
        assert wavelength_nm[responses.argmax(axis=0)].tolist() == [float(nm) for nm in row["peak_nm_rgb"].split("/")]


def test_two_cameras_have_lost_the_ratio_of_their_channels() -> None:
    lost = {name for name in camera_names() if not has_common_scale(name)}
    assert lost == {"ARRI_D21", "Nikon_D5100"}
    for name in lost:
        assert camera_sensitivities(name)[1].max(axis=0).tolist() == [1.0, 1.0, 1.0]


@pytest.mark.parametrize("name", ["Nikon_D5101", "nikon_d5100", "Nikon D5100", "index", "", "../LICENSE"])
def test_unknown_camera_raises_with_all_names(name: str) -> None:
    for function in (camera_sensitivities, has_common_scale):
        with pytest.raises(PixsimError, match=r"ARRI_D21.*Sony_ILCE-9") as error:
            function(name)
        assert ("Did you mean 'Nikon_D5100'" in str(error.value)) == name.lower().startswith("nikon")
