"""The packaged cameras: complete, as their licence and their index say."""

from __future__ import annotations

import csv
import re
from pathlib import Path

import numpy as np
import pytest

from pixsim.base.errors import PixsimError
from pixsim.sensor.camera_data import (
    FOLDER,
    TYPICAL,
    camera_channels,
    camera_names,
    camera_sensitivities,
    cameras,
    has_common_scale,
)


def test_all_cameras_of_the_index_are_there_with_licence_and_notice() -> None:
    assert len(camera_names()) == 52
    assert {path.stem for path in FOLDER.glob("*.csv")} == {*camera_names(), "index"}
    assert "Apache License" in (FOLDER / "LICENSE").read_text(encoding="utf-8")
    assert "Academy Software Foundation" in (FOLDER / "NOTICE").read_text(encoding="utf-8")


def test_peaks_are_those_of_the_index() -> None:
    """The index was made from the source: a column or a file that was swapped would have another
    peak or peak wavelength.
    """
    with (FOLDER / "index.csv").open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    for row in rows:
        wavelength_nm, responses = camera_sensitivities(row["file"].removesuffix(".csv"))
        assert (wavelength_nm == np.arange(380.0, 781.0, 5.0)).all()
        assert responses.shape == (81, 3)
        assert responses.min() >= 0
        assert responses.max(axis=0) == pytest.approx(
            [float(row[f"peak_{channel}"]) for channel in "rgb"], rel=1e-5
        )
        assert wavelength_nm[responses.argmax(axis=0)].tolist() == [
            float(nm) for nm in row["peak_nm_rgb"].split("/")
        ]


def test_two_cameras_have_lost_the_ratio_of_their_channels() -> None:
    lost = {name for name in camera_names() if not has_common_scale(name)}
    assert lost == {"ARRI_D21", "Nikon_D5100"}
    for name in lost:
        assert camera_sensitivities(name)[1].max(axis=0).tolist() == [1.0, 1.0, 1.0]


@pytest.mark.parametrize(
    "name", ["Nikon_D5101", "nikon_d5100", "Nikon D5100", "index", "", "../LICENSE"]
)
def test_unknown_camera_raises_with_all_names(name: str) -> None:
    for function in (camera_sensitivities, has_common_scale):
        with pytest.raises(PixsimError, match=r"ARRI_D21.*Sony_ILCE-9") as error:
            function(name)
        assert ("Did you mean 'Nikon_D5100'" in str(error.value)) == name.lower().startswith(
            "nikon"
        )


def test_typical_filters_are_marked_and_peak_where_measured_cameras_do() -> None:
    """Within the 15 nm that they state, of the median of the measured cameras; these have an
    infrared filter, which moves red.
    """
    entries = cameras()
    measured = [entry for entry in entries if entry.kind == "measured"]
    typical = [entry for entry in entries if entry.kind == "typical"]
    assert [entry.name for entry in entries] == [*camera_names(), *TYPICAL]
    assert len(typical) == 3
    medians = np.median([entry.peak_nm for entry in measured], axis=0)
    for entry in typical:
        assert "no measurement" in entry.notes
        assert "Estimated confidence" in entry.notes
        assert np.abs(np.array(entry.peak_nm[1:3]) - medians[1:]).max() <= 15
        assert medians[0] <= entry.peak_nm[0] <= medians[0] + 45
        nm, values = camera_sensitivities(entry.name)
        assert values.shape == (nm.size, len(entry.channels))
        assert values.max() == 1
        assert values.min() > 0
        infrared = values[nm == 900][0]
        assert (
            infrared.max() < 1.25 * infrared.min()
        )  # dyes are clear there: the channels are alike


def test_deep_silicon_has_more_infrared_and_a_dead_layer_less_blue() -> None:
    nm, back = camera_sensitivities("Typical_RGB_BSI")
    front, deep = (camera_sensitivities(f"Typical_RGB_{kind}")[1] for kind in ("FSI", "NIR"))
    for values, at_nm, channel, sign in ((front, 420.0, 2, -1), (deep, 850.0, 0, 1)):
        share, other = (
            each[nm == at_nm, channel] / each[nm == 530.0, 1] for each in (values, back)
        )
        assert sign * (share / other - 1) > 0.15
    assert [camera_channels(name) for name in TYPICAL] == ["RGB", "RGB", "RGBN"]


def test_page_lists_every_camera() -> None:
    page = (
        (Path(__file__).parents[2] / "docs/colour.md")
        .read_text(encoding="utf-8")
        .partition("## The cameras")[2]
    )
    assert re.findall(r"`(\w[\w-]+_[\w-]+)`", page.partition("| maker")[2]) == [
        entry.name for entry in cameras()
    ]
