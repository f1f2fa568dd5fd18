"""`pixsim run` and `pixsim lens` by the command line and in Python; commands that are refused before
anything is written.
"""

import csv
import io
import json
import shutil
import warnings
from pathlib import Path

import numpy as np
import pytest
from helpers.commands import assert_refused, command, output_of
from helpers.lenses import triplet
from helpers.looks import lines_without_rows
from helpers.runs import run_result
from helpers.sheets import two_sheets
from helpers.tiny import rows

import pixsim
from pixsim.base.schema import SCHEMA
from pixsim.light.exr import write_channels
from pixsim.measure.lens import lens_data
from pixsim.report.lens import lens_document
from pixsim.report.pictures import whole_picture
from pixsim.report.run import run_page
from pixsim.sensor.pixel import derive
from pixsim.sensor.reading import Readout
from pixsim.sensor.readout import frame_variance_dn2
from pixsim.show.document import Slider, Tiles
from pixsim.show.pictures import MAX_PICTURE_DOTS as MAX_DOTS, reduced

OPTIONS = "--pixel.pitch-um 21.2 --display.dots 64 --seed 3"
LENS = "--camera.f-number 2.8"
RENDERED = f"run csf --variant scalar_spectral --resolution 64 {LENS} {OPTIONS}"
SAME = ("mean_delta_e", "max_delta_e", "mean_electrons_e", "integration_s", "camera", "irradiance")


def scored(line: str) -> tuple[dict, str]:
    """score.json, and what was warned of."""
    with warnings.catch_warnings(action="always"):
        code, out, err = command(line)
    assert code == 0, err
    return json.loads(out), err


@pytest.fixture(scope="module")
def rendered(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict]:
    """A run's folder and its score."""
    out = tmp_path_factory.mktemp("rendered")
    return out, scored(f"{RENDERED} --json --out {out}")[0]


@pytest.mark.parametrize("lens", ["", LENS])
def test_run_saved_irradiance_same_score(rendered, lens, tmp_path):
    folder, before = rendered
    after, err = scored(
        f"run {folder / 'irradiance.exr'} {lens} {OPTIONS} --json --out {tmp_path / 'again'}"
    )
    assert err == ""
    assert {name: after[name] for name in SAME} == {name: before[name] for name in SAME}
    for name in ("raw.exr", "delta_e.exr", "image.png", "ideal.png", "irradiance.exr"):
        assert (tmp_path / "again" / name).read_bytes() == (folder / name).read_bytes(), name
    assert not {"render_noise", "plan"} & after.keys()
    assert before["camera"]["f_number"] == 2.8


# --- Pictures made elsewhere ---

NM = np.array([450.0, 550.0, 650.0])


def foreign_exr(path: Path, units: str | None, light: float = 0.01) -> Path:
    """A ramp of 4 × 64 × 64 samples in the layout of Fichet et al."""
    ramp = np.tile(np.linspace(0.2, 1, 64, dtype=np.float32) * light, (64, 1))
    header = {"spectralLayoutVersion": "1.0"} | ({"emissiveUnits": units} if units else {})
    write_channels(path, {f"S0.{int(nm)},000000nm": ramp for nm in NM}, header)
    return path


@pytest.mark.parametrize(
    ("units", "light", "option"),
    [(None, 0.01, "--units W.m^-2.nm^-1"), (None, 1.0, "--units uW/cm^2/nm")],
)
def test_units_of_the_file_and_of_the_option_are_the_same(units, light, option, tmp_path):
    """1 µW/cm² is 0.01 W/m²."""
    end = f"{OPTIONS} --json --out {tmp_path / 'out'}"
    stated, _ = scored(f"run {foreign_exr(tmp_path / 'stated.exr', 'W.m^-2.nm^-1')} {end}")
    score, _ = scored(f"run {foreign_exr(tmp_path / 'bare.exr', units, light)} {option} {end}")
    assert score["mean_electrons_e"] == pytest.approx(stated["mean_electrons_e"], rel=1e-6)


def test_run_of_radiance_measures_its_white_and_says_so(tmp_path):
    """A run in which it is stated has the same score."""
    path = foreign_exr(tmp_path / "ramp.exr", "W.m^-2.sr^-1.nm^-1")
    line = f"run {path} {OPTIONS} --json --out {tmp_path / 'out'}"
    measured, err = scored(line)
    white = measured["irradiance"]["luminance_cd_per_m2"]
    assert measured["irradiance"]["white_from"] == "99th percentile of the ideal image"
    assert f"using {white:g} cd/m²" in err

    stated, err = scored(f"{line} --display.white-cd-per-m2 {white:g}")
    assert "using" not in err
    assert stated["mean_delta_e"] == measured["mean_delta_e"]
    assert "white_from" not in stated["irradiance"]


@pytest.fixture(scope="module")
def three_frames(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict, dict]:
    """A folder with runs of 1, 2 and 3 frames of a uniform light; scores and codes by number."""
    folder = tmp_path_factory.mktemp("frames")
    uniform = np.full((32, 32, 3), 0.002)
    light = pixsim.SpectralImage([450.0, 550.0, 650.0], 100.0, 84.8, data=uniform)
    pixsim.write_npz(folder / "uniform.npz", light)
    # No code clips
    pixel = "--pixel.pitch-um 10 --pixel.bits 14 --pixel.black-level-dn 500 --pixel.prnu 0.02"
    line = f"run {folder / 'uniform.npz'} {pixel} --exposure.well-target 0.5 --display.dots 32"
    scores, frames = {}, {}
    for count in (1, 2, 3):
        out = folder / str(count)
        scores[count], _ = scored(f"{line} --raw npz --json --frames {count} --out {out}")
        frames[count] = np.array(
            [pixsim.read_frame(path).dn for path in sorted(out.glob("raw*.npz"))]
        )
    return folder, scores, frames


def test_frames_do_not_depend_on_their_number(three_frames):
    folder, scores, frames = three_frames
    three = frames[3]
    for count in (1, 2):
        np.testing.assert_array_equal(frames[count], three[:count])
    exr = [pixsim.read_frame(path).dn for path in sorted((folder / "3").glob("raw*.exr"))]
    np.testing.assert_array_equal(exr, three)
    assert [score.pop("frames", 1) for score in scores.values()] == [1, 2, 3]
    assert scores[1] == scores[2] == scores[3]
    assert "--frames 2" in (folder / "2/settings.toml").read_text(encoding="utf-8")


def test_frames_share_the_fixed_pattern_and_have_noise_of_their_own(three_frames):
    """Covariance of frames is the fixed pattern, half the variance of differences the temporal
    noise.
    """
    _, scores, frames = three_frames
    dn = frames[3].astype(float)
    pixel = pixsim.Pixel.model_validate(scores[1]["pixel"])
    readout = Readout.of(derive(pixel))
    time_s = scores[1]["integration_s"]
    dark_e = readout.dark_current_e_per_s * time_s
    signal_e = (dn.mean() - pixel.black_level_dn) / readout.dn_per_e - dark_e
    temporal_dn2 = float(frame_variance_dn2(signal_e, time_s, readout, False))
    total_dn2 = float(frame_variance_dn2(signal_e, time_s, readout, True))

    # Of 271² pixels: a standard error of 0.37 % for three frames' temporal variance, and of 0.52 %
    # for a fixed pattern; the gates are four and five of them.
    pairs = ((0, 1), (0, 2), (1, 2))
    half_variances = [(dn[i] - dn[j]).var() / 2 for i, j in pairs]
    assert np.mean(half_variances) == pytest.approx(temporal_dn2, rel=0.015)
    covariances = [np.cov(dn[i].ravel(), dn[j].ravel())[0, 1] for i, j in pairs]
    assert covariances == pytest.approx([total_dn2 - temporal_dn2] * 3, rel=0.025)


def test_irradiance_option_changes_the_file_and_no_number(tmp_path):
    """Factors of a cube that has none are its bands in full; 2048 samples are reduced to 1024."""
    y, x = np.indices((64, 2048))
    nm = np.arange(400.0, 701.0, 20.0)
    stripes = 5e-5 * (1.0 + (x // 3 + y) % 2)[:, :, None] * np.ones(nm.size)
    light = tmp_path / "wide.npz"
    header = {"units": "W m^-2 nm^-1", "pitch_um": 1.0, "white_cd_per_m2": 300.0}
    np.savez(light, data=stripes, wavelength_nm=nm, **header)
    settings = "--pixel.pitch-um 10 --display.dots 128 --json"
    shapes = {"full": (64, 2048), "factors": (64, 2048), "none": None, "reduced": (32, 1024)}
    scores = []
    for content, shape in shapes.items():
        out = tmp_path / content
        line = f"run {light} {settings} --camera.die-mm 2.048 --irradiance {content} --out {out}"
        score, err = scored(line)
        file = out / "irradiance.exr"
        assert (pixsim.read_exr(file).shape if file.exists() else None) == shape
        assert ("holds its bands in full" in err) == (content == "factors")
        scores.append([score[name] for name in ("mean_delta_e", "mean_electrons_e", "irradiance")])
    assert all(score == scores[0] for score in scores)

    again, err = scored(f"run {file} {settings} --out {tmp_path / 'again'}")
    assert "holds means over 2 × 2 samples" in err
    assert again["irradiance"]["reduced"] == {"samples": [64, 2048], "factor": 2.0}
    assert again["mean_electrons_e"] == pytest.approx(scores[0][1], rel=1e-3)


@pytest.mark.parametrize(
    ("shape", "small"),
    [((1024, 1024), (1024, 1024)), ((1025, 8), (512, 4)), ((700, 3000), (233, 1000)),
     # thinner than a block
     ((2, 4096), (1, 1024)), ((4096, 1), (1024, 1)), ((2, 3000), (1, 1000))],
)  # fmt: skip
def test_large_picture_is_reduced_to_means_of_whole_blocks(
    shape: tuple[int, int], small: tuple[int, int]
) -> None:
    whole = np.random.default_rng(3).random(shape)
    down, across = (n // m for n, m in zip(shape, small, strict=True))
    blocks = whole[: down * small[0], : across * small[1]].reshape(small[0], down, small[1], across)
    np.testing.assert_allclose(reduced(whole), blocks.mean(axis=(1, 3)))
    assert max(small) <= MAX_DOTS
    picture = whole_picture(whole, "a name")
    assert (picture.height, picture.width) == small


def test_figures_show_lines_of_their_tables_and_texts_inside() -> None:
    """With labels of three decimals."""
    data = lens_data(pixsim.load_lens("double_gauss").scaled(0.005), [486.1, 656.3])
    for plate in (plot.draw() for plot in lens_document(data).plots):
        assert lines_without_rows(plate) == [], plate.name
        plate.figure.canvas.draw()
        width, height = plate.figure.canvas.get_width_height()
        inside = plate.figure.get_tightbbox().transformed(plate.figure.dpi_scale_trans)
        assert min(inside.x0, inside.y0, width - inside.x1, height - inside.y1) >= 0, plate.name


def test_csv_has_a_row_for_each_field() -> None:
    data = triplet()
    columns = ("rms_spot_um", "mtf_sagittal_30_lp_per_mm")
    assert [
        [float(row[name]) for name in columns] for row in csv.DictReader(io.StringIO(data.to_csv()))
    ] == [[field["rms_spot_um"], field["mtf"][1]["sagittal"]] for field in data.as_dict()["fields"]]


def test_command_and_python_write_the_same_files(tmp_path: Path) -> None:
    """Byte for byte; JSON without NaN, also for a lens whose only field is the axis."""
    options = "--object-distance-m 1 --field-deg 0 --wavelength-nm 500 --wavelength-nm 600"
    out = output_of(f"lens singlet {options} --json --out", tmp_path / "out")
    assert "NaN" not in out
    data = pixsim.lens(
        "singlet", object_distance_m=1.0, field_deg=0.0, wavelength_nm=[500.0, 600.0]
    )
    content = {"schema": SCHEMA} | json.loads(json.dumps(data.as_dict()))
    assert json.loads(out) == content
    pixsim.write_report(data, tmp_path / "python")
    from_command, from_python = (
        {
            path.relative_to(folder).as_posix(): path.read_bytes()
            for path in folder.rglob("*")
            if path.is_file() and path.name != "pixsim.json"  # it states times
        }
        for folder in (tmp_path / "out", tmp_path / "python")
    )
    assert len(from_command) > 10
    assert from_python == from_command

    # Newton: f²/(s − f) farther from the lens than for an object at infinity
    focal_mm = pixsim.load_lens("singlet").first_order(587.5618).focal_length_mm
    expected_mm = 47.67 + focal_mm**2 / (1000 - focal_mm)
    assert content["image_distance_mm"] == pytest.approx(expected_mm, abs=1.0), "refocused"


@pytest.fixture(scope="module")
def desk(rendered: tuple[Path, dict], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with two sensors, the light of a run, and a frame with an edge."""
    folder = tmp_path_factory.mktemp("desk")
    two_sheets(folder)
    shutil.copy(rendered[0] / "irradiance.exr", folder / "light.exr")
    y, x = np.indices((128, 128))
    np.save(folder / "edge.npy", (100 + 500 * (x + y / 12 > 70)).astype(np.uint16))
    return folder


PAIR = "compare quiet.toml 'noisy one.toml'"


@pytest.mark.parametrize(
    ("line", "texts"),
    [
        ("run csf --units W.m^-2.nm^-1", ["--units", "csf"]),
        ("run light.exr -D resolution=64", ["-D", "light.exr", "a Mitsuba scene"]),
        ("run light.exr --sensor camera", ["--sensor", "light.exr"]),
        ("run light.exr --variant scalar_spectral", ["--variant", "light.exr"]),
        ("run light.exr --units W.m^-2.sr^-1.nm^-1", ["units", "W.m^-2.nm^-1 in the file"]),
        ("run light.exr --camera.die-mm 5", ["pitch", "die_mm"]),
        ("run light.exr --pixel.pitch-um 3000", ["pitch_um", "3000", "2713.6"]),
        ("run gone.exr", ["gone.exr", "does not exist"]),
        ("run gone.npz", ["gone.npz"]),
        ("run csf --frames=1000", ["--frames", "1 to 999"]),
        ("compare", ["sensors", "none"]),
        (f"{PAIR} -D colour=1", ["colour"]),
        (f"{PAIR} --study cheng2000", ["cheng2000", "chen2000"]),
        (f"{PAIR} --study chen2000-sensitivity", ["set.process", "from their own files"]),
    ],
)
def test_command_is_refused_and_writes_nothing(
    line: str, texts: list[str], desk: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(desk)
    assert_refused(*command(f"{line} --out out"), texts)
    assert not Path("out").exists()


@pytest.mark.parametrize(
    ("line", "name"),
    [
        ("run light.exr --raw png", "raw.png"),
        ("run light.exr --frames 2", "raw_002.exr"),
        ("run csf -D resolution=64", "score.json"),
        ("study pixel-size --quick", "figures/light_against_detail.svg"),
        ("study pixel-size --quick --pitch.count 5", "results.csv"),
        ("study pixel-size --axis pixel.prnu=0.01,0.02", "figures/optimum_by_pixel.prnu.csv"),
        ("accuracy csf --quick", "ladder.csv"),
        (PAIR, "pictures/image_quiet.png"),
        ("datasheet 0.35um", "figures/snr.svg"),
        ("sfr edge.npy", "summary.json"),
    ],
)
def test_file_that_pixsim_did_not_write_is_not_replaced(
    line: str, name: str, desk: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(desk)
    path = tmp_path / name
    path.parent.mkdir(exist_ok=True)
    path.write_text("my own")
    assert_refused(*command(f"{line} --out '{tmp_path}'"), [path.name, "not written by", "--out"])
    files = [file for file in tmp_path.rglob("*") if file.is_file()]
    assert {file: file.read_text() for file in files} == {path: "my own"}


def test_pictures_are_written_to_no_pdf(tmp_path: Path) -> None:
    with pytest.raises(pixsim.PixsimError, match="figures: got 'pdf' for a RunResult"):
        pixsim.write_report(run_result([1.0], {}), tmp_path, figures="pdf")


def test_written_noise_budget_adds_up(tmp_path: Path) -> None:
    """Variances of causes add up to that of all; parts of ΔE, with the remainder, to the mean."""
    settings = {"pixel": {"pitch_um": 21.2}, "display": {"dots": 64}, "noise_budget": True}
    result = pixsim.run("csf", resolution=64, **settings)
    result.write(tmp_path)
    table = {row["cause"]: row for row in rows(tmp_path / "figures/noise_budget.csv")}
    causes = [row for row in table.values() if row["part"]]
    total_e = np.sqrt(np.nansum([float(row["noise_e"] or "nan") ** 2 for row in causes]))
    assert total_e == pytest.approx(float(table["all causes"]["noise_e"]), rel=1e-6)
    parts_delta_e = sum(float(row["delta_e"]) for row in causes)
    assert parts_delta_e == pytest.approx(result.mean_delta_e, rel=1e-6)
    assert "Noise" in (tmp_path / "report.html").read_text(encoding="utf-8")


def test_page_marks_a_target_and_shows_its_pixels_enlarged() -> None:
    """A black bar of 4 × 12 pixels: in the enlarged square it alone is dark; the frame in the whole
    picture lies around it, as far from all of its sides.
    """
    bar = {"shape": "bar", "size_um": 40, "length_um": 120, "contrast": -1}
    options: dict = {
        "camera": {"die_mm": 1.0},
        "pixel": {"pitch_um": 10.0},
        "display": {"dots": 100},
    }
    lead = list(run_page(pixsim.run("target", parameters=bar, resolution=200, **options)).lead)
    (tiles,) = (block for block in lead if isinstance(block, Tiles))
    enlarged = tiles.pictures[0].codes
    dark = np.argwhere(enlarged < 128)
    times = enlarged.shape[0] // 28  # 12 pixels, and 8 on each side
    np.testing.assert_array_equal(dark.min(axis=0), np.array([8, 12]) * times)
    np.testing.assert_array_equal(dark.max(axis=0) + 1, np.array([20, 16]) * times)

    (slider,) = (block for block in lead if isinstance(block, Slider))
    whole = slider.left.codes
    frame = np.argwhere(whole == 0) - (np.array(whole.shape) - 1) / 2
    np.testing.assert_allclose(np.abs(frame).max(axis=0), [14, 10], atol=1)
    np.testing.assert_allclose(frame.mean(axis=0), 0, atol=0.6)
