"""The packaged curves of cameras as files: their index, licence and page, and typical filters beside
measured ones.
"""

import csv
import re
from pathlib import Path

import numpy as np
import pytest

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
        name = row["file"].removesuffix(".csv")
        nm, responses = camera_sensitivities(name)
        np.testing.assert_array_equal(nm, np.arange(380.0, 781.0, 5.0))
        peaks = [float(row[f"peak_{channel}"]) for channel in "rgb"]
        np.testing.assert_allclose(responses.max(axis=0), peaks, rtol=1e-5, err_msg=name)
        peaks_nm = [float(peak_nm) for peak_nm in row["peak_nm_rgb"].split("/")]
        assert nm[responses.argmax(axis=0)].tolist() == peaks_nm, name


def test_two_cameras_have_lost_the_ratio_of_their_channels() -> None:
    separate = {name for name in camera_names() if not has_common_scale(name)}
    assert separate == {"ARRI_D21", "Nikon_D5100"}
    for name in separate:
        assert camera_sensitivities(name)[1].max(axis=0).tolist() == [1.0, 1.0, 1.0]
    assert {entry.name for entry in cameras() if "channels lost" in entry.description} == separate


def test_typical_filters_peak_where_measured_cameras_do() -> None:
    """Within the 15 nm that they state, of the median of the measured cameras; these have an
    infrared filter, which moves red. Dyes are clear at 900 nm: the channels are alike there.
    """
    entries = cameras()
    assert [entry.name for entry in entries] == [*camera_names(), *TYPICAL]
    medians = np.median([entry.peak_nm for entry in entries if entry.kind == "measured"], axis=0)
    for entry in entries[-len(TYPICAL) :]:
        assert "no measurement" in entry.notes
        np.testing.assert_allclose(entry.peak_nm[1:3], medians[1:], atol=15)
        assert medians[0] <= entry.peak_nm[0] <= medians[0] + 45
        nm, values = camera_sensitivities(entry.name)
        assert (values.shape, values.max()) == ((nm.size, len(camera_channels(entry.name))), 1)
        infrared = values[nm == 900][0]
        assert infrared.max() < 1.25 * infrared.min()


@pytest.mark.parametrize(
    ("name", "nm", "channel", "sign"),
    [("Typical_RGB_FSI", 420.0, 2, -1), ("Typical_RGB_NIR", 850.0, 0, 1)],
)
def test_deep_silicon_has_more_infrared_and_a_dead_layer_less_blue(
    name: str, nm: float, channel: int, sign: int
) -> None:
    wavelength_nm, back = camera_sensitivities("Typical_RGB_BSI")
    _, values = camera_sensitivities(name)
    relative = values[wavelength_nm == nm, channel] / values[wavelength_nm == 530.0, 1]
    reference = back[wavelength_nm == nm, channel] / back[wavelength_nm == 530.0, 1]
    assert sign * (relative / reference - 1) > 0.15


def test_page_lists_every_camera() -> None:
    page = (Path(__file__).parents[2] / "docs/colour.md").read_text(encoding="utf-8")
    table = page.partition("## The cameras")[2].partition("| maker")[2]
    assert re.findall(r"`(\w[\w-]+_[\w-]+)`", table) == [entry.name for entry in cameras()]
