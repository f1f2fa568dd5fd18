"""Many sensors in one light: the frames of `pixsim.evaluate`, through the evaluations of a
study.
"""

import csv
import sys
from types import SimpleNamespace

import numpy as np
import pytest

from pixsim import Camera, Display, Exposure, Pixel, PixsimError, SpectralImage, evaluate, sweep
from pixsim.sensor.technology import load_technology
from pixsim.studies import evaluate as evaluate_module
from pixsim.studies.run import prepare, run_prepared
from pixsim.viewer.setting import Run

CAMERA = Camera(die_mm=0.64)
DISPLAY = Display(dots=48, white_cd_per_m2=3000.0)
SAME_SIZE = {"paper": Pixel(pitch_um=10.0), "phone": Pixel(technology="4t-bsi", pitch_um=10.0)}
METRICS = ["delta_e", "visual_noise", "information"]
COLOUR = {"sensitivities": "Sony_ILCE-7M4", "peak_quantum_efficiency": 0.65}


def light_of(seed=1):
    data = 1e-3 * (1 + np.random.default_rng(seed).random((64, 64, 3)))
    return SpectralImage(
        [450.0, 550.0, 620.0],
        30.0,
        10.0,
        data=data.astype(np.float32),
        header={"diffraction": False},
    )


@pytest.fixture(scope="module")
def light():
    return light_of()


def mean_image(score):
    return float(score.image.mean())


@pytest.mark.parametrize("raster", ["fixed_size", "one_to_one"])
def test_numbers_of_pixels_of_one_size_are_those_of_evaluate_bit_for_bit(light, raster):
    display = Display(
        raster=raster, white_cd_per_m2=3000.0, **({"dots": 48} if raster == "fixed_size" else {})
    )
    own = {"display": display, "metrics": [*METRICS, "detectability", mean_image], "seed": 5}
    own["without"] = light.with_planes(0.99 * light.planes)
    table = sweep(light, SAME_SIZE, camera=CAMERA, jobs=1, **own)
    assert [row["pixel"] for row in table] == list(SAME_SIZE)
    for row, pixel in zip(table, SAME_SIZE.values(), strict=True):
        score = evaluate(light, CAMERA, pixel, **own)
        assert {name: row[name] for name in score.statistics()} == score.statistics()
        assert score.metrics["detectability"] > 1


def test_repeats_are_the_sensors_of_a_run(light):
    """`pixsim run --repeats 3` scores these frames, each a sensor of its own at its
    registration.
    """
    table = sweep(
        light,
        [SAME_SIZE["paper"]],
        camera=CAMERA,
        display=DISPLAY,
        metrics=METRICS,
        repeats=3,
        seed=2,
        jobs=1,
    )
    tables = {"camera": CAMERA, "pixel": SAME_SIZE["paper"], "display": DISPLAY}
    stated = {name: table.model_dump(exclude_unset=True) for name, table in tables.items()}
    settings = Run.model_validate(stated | {"metrics": METRICS, "seed": 2})
    result = run_prepared(prepare(light, settings, repeats=3))
    for row, expected in zip(table, result.statistics, strict=True):
        assert {name: row[name] for name in expected} == expected


def test_pixels_of_several_sizes_are_scored_on_the_same_dots(light):
    """Dots of 13.3 µm: the border of pixels of 30 µm is four of them wide, that of pixels of 6 µm
    one.
    """
    small, large = Pixel(pitch_um=6.0), Pixel(pitch_um=30.0)
    table = sweep(
        light,
        [small, large],
        camera=CAMERA,
        display=DISPLAY,
        metrics=["delta_e", mean_image],
        jobs=1,
    )
    alone = [evaluate(light, CAMERA, pixel, display=DISPLAY) for pixel in (small, large)]
    assert table[1]["mean_delta_e"] == alone[1].mean_delta_e
    assert table[0]["mean_electrons_e"] == alone[0].statistics()["mean_electrons_e"]
    assert (alone[0].image.shape, alone[1].image.shape) == ((46, 46), (40, 40))
    assert table[0]["mean_image"] == pytest.approx(alone[0].image[3:-3, 3:-3].mean(), rel=1e-12)


def test_metric_without_a_number_for_one_of_the_sensors_is_nan(light):
    """The deep well shows its surfaces, the shallow one is full of the brighter one."""
    sheet = {
        "technology": "none",
        "pitch_um": 10.0,
        "quantum_efficiency": 0.5,
        "read_noise_e": 2.0,
        "dark_current_e_per_s": 0.0,
    }
    pixels = {
        name: Pixel(full_well_e=well_e, **sheet)
        for name, well_e in (("shallow", 300.0), ("deep", 1e6))
    }
    own = {
        "camera": CAMERA,
        "display": DISPLAY,
        "exposure": Exposure(integration_s=0.01),
        "metrics": ["delta_e", "niirs"],
    }
    with pytest.warns(UserWarning, match="pixel shallow: the metric niirs: got .* full at 300 e-"):
        table = sweep(light, pixels, **own, jobs=1)
    assert [np.isnan(row["niirs"]) for row in table] == [True, False]
    assert all(row["mean_delta_e"] > 0 for row in table)
    assert "<td>–</td>" in table._repr_html_().replace(' class="number"', "")


def test_jobs_change_no_number_and_another_light_does():
    """Two lights whose headers say the same, in the workers of one another: their chains are not
    mixed up.
    """
    own = {"camera": CAMERA, "display": DISPLAY, "metrics": ["delta_e", mean_image], "repeats": 2}
    lights = [light_of(1), light_of(2)]
    alone, together = (
        [list(sweep(light, SAME_SIZE, **own, jobs=jobs)) for light in lights] for jobs in (1, 2)
    )
    assert alone == together
    assert alone[0][0]["mean_delta_e"] != alone[1][0]["mean_delta_e"]


def test_white_that_nobody_states_is_one_for_all():
    """That of the sensor which sees the picture brightest; each alone would have its own."""
    light = light_of(9)  # whose whites differ after rounding
    with pytest.warns(UserWarning, match="the largest of these sensors'"):
        table = sweep(
            light, SAME_SIZE, camera=CAMERA, display=Display(dots=48), metrics=[mean_image], jobs=1
        )
    with pytest.warns(UserWarning, match="the scene does not define its white") as notes:
        alone = [
            evaluate(light, CAMERA, pixel, display=Display(dots=48)) for pixel in SAME_SIZE.values()
        ]
    whites = [
        float(str(note.message).split("using ")[1].split(" cd")[0])
        for note in notes
        if "using" in str(note.message)
    ]
    brightest = int(np.argmax(whites))
    assert whites[0] != whites[1]
    assert table[brightest]["mean_image"] == mean_image(alone[brightest])
    assert table[1 - brightest]["mean_image"] < mean_image(alone[1 - brightest])


def test_table_is_rows_csv_and_frame(light, tmp_path, monkeypatch):
    table = sweep(
        light,
        {"007": SAME_SIZE["paper"]},
        camera=CAMERA,
        display=DISPLAY,
        metrics=[mean_image],
        repeats=2,
        jobs=1,
    )
    text = table.to_csv(tmp_path / "table.csv")
    assert (tmp_path / "table.csv").read_text() == text.replace("\r\n", "\n")
    rows = list(csv.DictReader(text.splitlines()))
    assert rows == [{name: str(value) for name, value in row.items()} for row in table]
    assert (len(table), table[-1]["repeat"], table[:1][0]["pixel"]) == (2, 1, "007")
    assert "mean_delta_e" not in table[0], "which nobody asks for"
    mean = np.mean([row["mean_image"] for row in table])
    assert f"<td>0.35um</td><td>007</td><td>10</td><td>{mean:.4g}</td>" in table._repr_html_()
    monkeypatch.setitem(sys.modules, "pandas", SimpleNamespace(DataFrame=list, read_csv=None))
    assert table.to_dataframe() == list(table)
    monkeypatch.setitem(sys.modules, "pandas", None)
    with pytest.raises(PixsimError, match="pip install pandas"):
        table.to_dataframe()


@pytest.mark.parametrize(
    ("pixels", "more", "message"),
    [
        ([], {}, "pixels: got none; allowed: at least one Pixel"),
        ({"=1+1": Pixel()}, {}, "pixels: got a name that begins with ="),
        ({"": Pixel()}, {}, "pixels: got a name that is empty"),
        ([3.0], {}, r"pixels\[0\]: got 3.0; allowed: a Pixel"),
        ({"b": "imx477"}, {}, r"pixels\['b'\]: got 'imx477'; allowed: a Pixel"),
        ([Pixel(), Pixel(pitch_um=5.0)], {}, "pixel 1: .*pitch_um"),
        ([Pixel(), Pixel(pitch_um=400.0)], {}, "pixel 1: pixel.pitch_um: got pixels whose border"),
        (
            [Pixel()],
            {"metrics": ["detectability"]},
            "pixel 0: metrics: got 'detectability'; allowed: light of the scene without",
        ),
        (
            [Pixel(), Pixel(colour=COLOUR)],
            {"metrics": ["acutance"]},
            "pixel 1: metrics: got 'acutance'",
        ),
        (
            [Pixel(pitch_um=20.0), Pixel(pitch_um=20.0, colour=COLOUR)],
            {},
            "one ideal image for all",
        ),
        ([Pixel()], {"repeats": 0}, "repeats: got 0"),
        ([Pixel()], {"jobs": 0}, "jobs: got 0"),
    ],
)
def test_what_cannot_be_swept_says_why(light, pixels, more, message):
    with pytest.raises(PixsimError, match=message):
        sweep(light, pixels, camera=CAMERA, display=DISPLAY, **more)


# --- what a study takes
# -------------------------------------------------------------------------------------------------------


def without_labels(rows, *labels):
    return [{name: value for name, value in row.items() if name not in labels} for row in rows]


def test_rows_of_axes_and_conditions_are_those_of_sweeps_with_their_settings(light):
    own = {"camera": CAMERA, "display": DISPLAY, "seed": 3, "jobs": 1}
    axis = {"name": "bits", "set": "pixel.bits", "values": [6, 10]}
    condition = {"name": "short", "set": {"exposure": {"integration_s": 1e-4}}}
    table = sweep(light, SAME_SIZE, axis=[axis], condition=[condition], **own)
    assert [(row["pixel"], row["bits"], row["condition"]) for row in table] == [
        (name, bits, "short") for bits in (6, 10) for name in SAME_SIZE
    ]
    for bits, rows in ((6, table[:2]), (10, table[2:])):
        alone = sweep(
            light, SAME_SIZE, pixel={"bits": bits}, exposure=Exposure(integration_s=1e-4), **own
        )
        assert without_labels(rows, "bits", "condition") == list(alone)


def test_tables_and_files_state_what_records_state(light, tmp_path):
    """Bit for bit; an argument takes precedence over a file."""
    own = {"camera": CAMERA, "jobs": 1}
    file = tmp_path / "settings.toml"
    file.write_text(
        "[display]\ndots = 48\nwhite_cd_per_m2 = 3000.0\n[exposure]\nwell_target = 0.5\n",
        encoding="utf-8",
    )
    of_records = sweep(light, SAME_SIZE, display=DISPLAY, exposure=Exposure(well_target=0.8), **own)
    of_tables = sweep(light, SAME_SIZE, config=file, exposure={"well_target": 0.8}, **own)
    assert list(of_tables) == list(of_records)


def test_sensor_types_are_further_rows_within_the_ranges_of_the_technology(light):
    own = {"camera": CAMERA, "display": DISPLAY, "seed": 3, "jobs": 1}
    pixels = {"old": SAME_SIZE["paper"]}
    table, plain = sweep(light, pixels, uncertainty=8, **own), sweep(light, pixels, **own)
    technology = load_technology("0.35um")
    numbers = {f"old {name}" for name in technology.ranges}
    as_is, types = (
        [row for row in table if row["draw"] == "base"],
        [row for row in table if row["draw"] != "base"],
    )
    assert without_labels(as_is, "draw", *numbers) == list(plain)
    assert [row["draw"] for row in types] == list(range(8))
    for name, (low, high) in technology.ranges.items():
        assert as_is[0][f"old {name}"] == technology.numbers[name]
        drawn = [row[f"old {name}"] for row in types]
        assert low <= min(drawn) < max(drawn) <= high
    assert len({row["mean_delta_e"] for row in types}) == 8


def test_interrupted_sweep_goes_on(light, tmp_path, monkeypatch):
    """With a results.csv of all rows no frame is made."""
    own = {"camera": CAMERA, "display": DISPLAY, "out": tmp_path / "rows", "jobs": 1}
    first = list(sweep(light, SAME_SIZE, **own))
    monkeypatch.setattr(evaluate_module, "evaluate_task", lambda *_: pytest.fail("a frame"))
    assert list(sweep(light, SAME_SIZE, **own)) == first
