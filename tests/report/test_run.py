"""`pixsim run` by the command line: saved and foreign pictures, files, notes, and what its page
says of them.
"""

from __future__ import annotations

import html
import json
import re
import warnings
from pathlib import Path

import numpy as np
import pytest
from helpers.commands import assert_refused, command
from helpers.looks import text_of
from helpers.runs import run_result
from helpers.sheets import two_sheets

import pixsim
from pixsim.base.errors import PixsimError
from pixsim.light.exr import write_channels
from pixsim.optics.camera import CameraOptions
from pixsim.optics.exchange import read_with_camera, write_npz
from pixsim.optics.lens_options import LensOptions
from pixsim.report.outline import outline_document, run_outline
from pixsim.report.pictures import whole_picture
from pixsim.report.run import colour_rows
from pixsim.report.wording import lens_words
from pixsim.scene.film import PATH_SAMPLES
from pixsim.sensor.pixel import derive
from pixsim.sensor.reading import Readout
from pixsim.sensor.readout import frame_variance_dn2
from pixsim.show.pictures import MAX_PICTURE_DOTS as MAX_DOTS, reduced
from pixsim.studies.run import prepare
from pixsim.viewer.setting import Run

OPTIONS = "--pixel.pitch-um 21.2 --display.dots 64 --seed 3"
LENS = "--camera.f-number 2.8"
RENDERED = f"run csf --variant scalar_spectral --resolution 64 {LENS} {OPTIONS}"


def scored(line: str) -> tuple[dict, str]:
    """score.json, and what was warned of."""
    with warnings.catch_warnings():
        warnings.simplefilter("always")
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
    for name in (
        "mean_delta_e",
        "max_delta_e",
        "mean_electrons_e",
        "integration_s",
        "camera",
        "irradiance",
    ):
        assert after[name] == before[name], name
    for name in ("raw.exr", "delta_e.exr", "image.png", "ideal.png", "irradiance.exr"):
        assert (tmp_path / "again" / name).read_bytes() == (folder / name).read_bytes(), name
    assert not {"render_noise", "plan"} & after.keys()
    assert before["camera"]["f_number"] == 2.8


def test_run_npz_same_score(rendered, tmp_path):
    """Its bands are at their centres: at 400 and 800 nm, where the response begins and ends, that
    is half a band too much.
    """
    folder, before = rendered
    write_npz(tmp_path / "picture.npz", pixsim.read_exr(folder / "irradiance.exr"))
    after, err = scored(
        f"run {tmp_path / 'picture.npz'} {LENS} {OPTIONS} --json --out {tmp_path / 'out'}"
    )
    assert err == ""
    assert after["irradiance"]["luminance_cd_per_m2"] == pytest.approx(
        1000, rel=1e-5
    )  # d65 at the digits of emitter_scale
    electrons = after["mean_electrons_e"] / after["integration_s"]
    assert electrons == pytest.approx(
        before["mean_electrons_e"] / before["integration_s"], rel=1e-2
    )
    # Other noise, and D65 as white, since the file states no lamp.
    assert after["mean_delta_e"] == pytest.approx(before["mean_delta_e"], rel=0.02)


def test_read_with_camera_takes_die_from_file(rendered):
    image, camera = read_with_camera(rendered[0] / "irradiance.exr", CameraOptions())
    assert camera == pixsim.Camera(f_number=2.8)
    assert camera.die_mm == pytest.approx(image.pitch_um * 64 / 1e3)


def test_run_notes_reach_score_page_and_json(rendered, tmp_path):
    """What it was warned of is on stderr, too."""
    line = (
        f"run {rendered[0] / 'irradiance.exr'} --camera.f-number 8 {OPTIONS} --json --out"
        f" {tmp_path}"
    )
    score, err = scored(line)
    assert [note["id"] for note in score["notes"]] == [
        "other_camera",
        "white_clipped",
        "black_level",
    ]
    other, bright, dark = (note["text"] for note in score["notes"])
    assert other.startswith("the irradiance was rendered with a camera of different")
    assert "of the ideal image is brighter than display white" in bright
    assert err.startswith(f"warning: {other}")
    assert [err.count(note) for note in (other, bright)] == [1, 1]
    assert dark.startswith("the black level of 0 DN clips dark noise")
    assert (
        json.loads((tmp_path / "score.json").read_text(encoding="utf-8"))["notes"] == score["notes"]
    )
    page = html.unescape(text_of(tmp_path))
    assert all(note["text"][1:] in page for note in score["notes"])  # with a capital letter first


# --- Pictures made elsewhere ---

NM = np.array([450.0, 550.0, 650.0])


def foreign_exr(path: Path, units: str | None, light: float = 0.01) -> Path:
    """A ramp of 4 × 64 × 64 samples in the layout of Fichet et al."""
    ramp = np.tile(np.linspace(0.2, 1, 64, dtype=np.float32) * light, (64, 1))
    header = {"spectralLayoutVersion": "1.0"} | ({"emissiveUnits": units} if units else {})
    write_channels(path, {f"S0.{int(nm)},000000nm": ramp for nm in NM}, header)
    return path


def test_run_missing_units_raises(tmp_path):
    path = foreign_exr(tmp_path / "bare.exr", None)
    out = tmp_path / "out"
    assert_refused(
        *command(f"run {path} {OPTIONS} --out {out}"),
        ["bare.exr", "none in the file", "--units", "W.m^-2.nm^-1"],
    )
    assert not out.exists()
    stated, err = scored(f"run {path} --units W.m^-2.nm^-1 {OPTIONS} --json --out {out}")
    assert "the scene does not define its white" in err
    message, _ = scored(f"run {foreign_exr(path, 'W.m^-2.nm^-1')} {OPTIONS} --json --out {out}")
    assert message["mean_electrons_e"] == stated["mean_electrons_e"]
    micro, _ = scored(
        f"run {foreign_exr(path, None, 1.0)} --units uW/cm^2/nm {OPTIONS} --json --out {out}"
    )
    assert micro["mean_electrons_e"] == pytest.approx(
        stated["mean_electrons_e"], rel=1e-6
    )  # 1 µW/cm² is 0.01 W/m²


def test_run_radiance_passes_lens(tmp_path):
    path = foreign_exr(tmp_path / "seen.exr", "W.m^-2.sr^-1.nm^-1", 0.1)
    exposure = "--exposure.integration-s 1e-4"
    lines = [
        f"run {path} --camera.f-number {n} {exposure} {OPTIONS} --json --out {tmp_path / 'out'}"
        for n in (4, 8)
    ]
    rates = [scored(line)[0]["mean_electrons_e"] for line in lines]
    m = pixsim.Camera().magnification
    # On the axis; 20° off it .5 % more. 4 for 1/N² alone is 1.2 % off.
    expected = (1 + 4 * 64 * (1 + m) ** 2) / (1 + 4 * 16 * (1 + m) ** 2)
    assert rates[0] / rates[1] == pytest.approx(expected, rel=5e-3)


def test_run_unknown_white_is_measured(tmp_path):
    path = foreign_exr(tmp_path / "ramp.exr", "W.m^-2.sr^-1.nm^-1")
    message, err = scored(f"run {path} {OPTIONS} --json --out {tmp_path / 'out'}")
    white = message["irradiance"]["luminance_cd_per_m2"]
    assert message["irradiance"]["white_from"] == "99th percentile of the ideal image"
    # D65, in place of its unknown white, that gives the sensor the ramp's electrons behind the
    # lens; even over bands of 100 nm.
    fine_nm = NM[:, None] + np.linspace(-49.5, 49.5, 100)
    electrons, daylight = (
        pixsim.derive(pixsim.Pixel()).quantum_efficiency(fine_nm) * fine_nm,
        pixsim.spectral.d65(fine_nm),
    )
    of_white = pixsim.spectral.photopic_efficiency(fine_nm).mean(axis=1) @ daylight.mean(axis=1)
    expected = (
        683.002
        * 0.01
        * electrons.sum()
        * of_white
        / (electrons.mean(axis=1) @ daylight.mean(axis=1))
    )
    image, camera = read_with_camera(path, CameraOptions())
    lens = camera.image_distance_mm, camera.f_number, camera.magnification
    fall_off = pixsim.optics.field_factor(
        image.shape, image.pitch_um, *lens
    ) / pixsim.optics.irradiance_factor(lens[1], 0.0, lens[2])
    expected *= np.percentile(np.linspace(0.2, 1, 64) * fall_off, 99)
    assert white == pytest.approx(expected, rel=0.04)  # a border that is not scored, and two digits
    wide, guess = err.splitlines()
    assert "bands of up to 100 nm" in wide
    assert (
        guess == f"warning: the scene does not define its white: using {white:g} cd/m², the 99th"
        " percentile of the ideal image in the sensor's response, rounded up; set"
        f" --display.white-cd-per-m2 {white:g} to fix this value"
    )
    kept, err = scored(
        f"run {path} --display.white-cd-per-m2 {white:g} {OPTIONS} --json --out {tmp_path / 'out'}"
    )
    assert err.splitlines() == [wide]
    assert kept["mean_delta_e"] == message["mean_delta_e"]
    assert "white_from" not in kept["irradiance"]


@pytest.mark.parametrize(
    ("line", "wanted"),
    [
        ("csf --units W.m^-2.nm^-1", ["--units", "csf", "a picture"]),
        ("{exr} -D resolution=64", ["-D", "irradiance.exr", "a Mitsuba scene"]),
        ("{exr} --sensor camera", ["--sensor", "irradiance.exr"]),
        ("{exr} --variant scalar_spectral", ["--variant", "irradiance.exr"]),
        ("{exr} --units W.m^-2.sr^-1.nm^-1", ["units", "W.m^-2.nm^-1 in the file"]),
        ("{exr} --camera.die-mm 5", ["pitch", "die_mm"]),
        ("{exr} --pixel.pitch-um 3000", ["pitch_um", "3000", "2713.6"]),
        ("gone.exr", ["gone.exr", "does not exist"]),
        ("gone.npz", ["gone.npz"]),
    ],
)
def test_run_conflicting_options_raise(rendered, line, wanted, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert_refused(
        *command("run " + line.format(exr=rendered[0] / "irradiance.exr") + " --out out"), wanted
    )
    assert not list(tmp_path.iterdir())


def test_files_of_an_earlier_run_and_of_the_user_stay(rendered, tmp_path):
    folder, _ = rendered
    (tmp_path / "raw.npz").write_bytes(b"mine")
    here = f"{OPTIONS} --json --out {tmp_path}"
    scored(f"run {folder / 'irradiance.exr'} {here} --raw tiff")
    assert {"irradiance.exr", "raw.tiff", "report.html"} <= {
        path.name for path in tmp_path.iterdir()
    }
    scored(f"run {tmp_path / 'irradiance.exr'} {here} --irradiance none")
    assert "irradiance.exr" in {path.name for path in tmp_path.iterdir()}
    assert (tmp_path / "raw.npz").read_bytes() == b"mine"


def test_run_frames_share_the_sensor_and_have_noise_of_their_own(tmp_path):
    """Under even light: covariance of frames is the fixed pattern, half the variance of differences
    the temporal noise.
    """
    even = pixsim.SpectralImage(
        [450.0, 550.0, 650.0], 100.0, 84.8, data=np.full((32, 32, 3), 0.002)
    )
    pixsim.write_npz(tmp_path / "even.npz", even)
    pixel = "--pixel.pitch-um 10 --pixel.bits 14 --pixel.black-level-dn 500 --pixel.prnu 0.02"
    half = "--exposure.well-target 0.5"  # nothing clips
    line = (
        f"run {tmp_path / 'even.npz'} {pixel} {half} --display.dots 32 --raw npz --json --out"
        f" {tmp_path}"
    )
    summaries = {}
    frames: dict[int, list] = {}
    for count in (1, 3, 2):
        folder = tmp_path / f"out{count}"
        summaries[count] = scored(f"{line}/out{count} --frames {count}")[0]
        names = [f"raw{number}" for number in ("", "_002", "_003")[:count]]
        assert sorted(path.stem for path in folder.glob("raw*.npz")) == names
        frames[count] = [pixsim.read_frame(folder / f"{name}.npz") for name in names]
        for name, frame in zip(names, frames[count], strict=True):
            np.testing.assert_array_equal(pixsim.read_frame(folder / f"{name}.exr").dn, frame.dn)
    assert summaries[3].pop("frames") == 3
    assert summaries[2].pop("frames") == 2
    assert summaries[1] == summaries[2] == summaries[3]
    for few in (1, 2):
        for frame, same in zip(frames[few], frames[3], strict=False):
            np.testing.assert_array_equal(frame.dn, same.dn)
    settings = (tmp_path / "out2/settings.toml").read_text(encoding="utf-8")
    assert "--frames 2" in settings.splitlines()[1]

    pixel = pixsim.Pixel.model_validate(summaries[1]["pixel"])
    readout, time_s = Readout.of(derive(pixel)), summaries[1]["integration_s"]
    dn = np.array([frame.dn for frame in frames[3]], float)
    signal_e = (
        dn.mean() - pixel.black_level_dn
    ) / readout.dn_per_e - readout.dark_current_e_per_s * time_s
    temporal, total = (
        float(frame_variance_dn2(signal_e, time_s, readout, fixed)) for fixed in (False, True)
    )
    # Of 271² pixels: a standard error of 0.37 % for three frames' temporal variance, and of 0.52 %
    # for a fixed pattern.
    assert np.mean(
        [(dn[i] - dn[j]).var() / 2 for i, j in ((0, 1), (0, 2), (1, 2))]
    ) == pytest.approx(temporal, rel=0.015)
    across = [np.cov(dn[i].ravel(), dn[j].ravel())[0, 1] for i, j in ((0, 1), (0, 2), (1, 2))]
    assert across == pytest.approx([total - temporal] * 3, rel=0.025)


@pytest.mark.parametrize("more", ["", "--dry-run"])
@pytest.mark.parametrize("frames", ["0", "-1", "1000"])
def test_run_of_no_or_too_many_frames_raises(frames, more, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert_refused(
        *command(f"run csf --frames={frames} {more}"), [f"--frames: got {frames}", "1 to 999"]
    )
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("line", "name"),
    [
        ("run {exr} --raw png", "raw.png"),
        ("run {exr} --frames 2", "raw_002.exr"),
        ("run {exr}", "report.html"),
        ("run csf -D resolution=64", "score.json"),
        ("study pixel-size --quick", "figures/light_against_detail.svg"),
        ("study pixel-size --quick --pitch.count 5", "results.csv"),
        (
            "study pixel-size --quick --axis pixel.prnu=0.01,0.02",
            "figures/optimum_by_pixel.prnu.csv",
        ),
        ("accuracy csf --quick", "ladder.csv"),
        ("compare '{here}/quiet.toml' '{here}/noisy one.toml'", "pictures/image_quiet.png"),
        ("datasheet 0.35um", "figures/snr.svg"),
        ("sfr {exr}/../raw.exr", "summary.json"),
    ],
)
def test_command_other_file_of_the_same_name_raises(rendered, line, name, tmp_path):
    """Before anything is rendered or measured."""
    path = tmp_path / name
    path.parent.mkdir(exist_ok=True)
    path.write_text("my own")
    if line.startswith("sfr"):  # a chart of the run is no edge
        edge = np.full((128, 128), 100, np.uint16) + 500 * (
            np.arange(128) + np.arange(128)[:, None] / 12 > 70
        )
        np.save(tmp_path / "edge.npy", edge.astype(np.uint16))
        line = f"sfr {tmp_path / 'edge.npy'}"
    two_sheets(tmp_path)
    before = sorted(tmp_path.rglob("*"))
    line = line.format(exr=rendered[0] / "irradiance.exr", here=tmp_path)
    assert_refused(*command(f"{line} --out {tmp_path}"), [path.name, "not written by", "--out"])
    assert path.read_text() == "my own"
    assert sorted(tmp_path.rglob("*")) == before


def test_run_irradiance_option_sets_contents(tmp_path):
    """The result is the same, but for the frame of a file whose samples are larger."""
    y, x = np.indices((64, 2048))
    light = light_file(tmp_path / "wide.npz", 1.0 + (x // 3 + y) % 2, 1.0)
    line = f"run {light} --camera.die-mm 2.048 --pixel.pitch-um 10 --display.dots 128 --json"
    scores = {}
    for content in ("full", "factors", "none", "reduced"):
        file = tmp_path / content / "irradiance.exr"
        score, err = scored(f"{line} --irradiance {content} --out {tmp_path / content}")
        scores[content] = {
            name: score[name] for name in ("mean_delta_e", "mean_electrons_e", "irradiance")
        }
        assert ("holds its bands in full" in err) == (
            content == "factors"
        )  # a cube of another program has no factors
        assert file.exists() == (content != "none")
        if content != "none":
            assert pixsim.read_exr(file).shape == (
                (32, 1024) if content == "reduced" else (64, 2048)
            )
    assert all(score == scores["full"] for score in scores.values())
    again, err = scored(
        f"run {file} --pixel.pitch-um 10 --display.dots 128 --json --out {tmp_path / 'again'}"
    )
    assert "'irradiance.exr' holds means over 2 × 2 samples of the render, 2 µm wide" in err
    assert again["irradiance"]["reduced"] == {"samples": [64, 2048], "factor": 2.0}
    assert again["mean_electrons_e"] == pytest.approx(scores["full"]["mean_electrons_e"], rel=1e-3)


# --- The page of one picture ---


@pytest.mark.parametrize(
    ("more", "rays"),
    [
        ({}, PATH_SAMPLES / 64**2),
        ({"max_seconds": 5.0}, None),
        ({"tolerance_delta_e": 0.1, "render_noise": 0.5}, PATH_SAMPLES / 64**2),
    ],
)
def test_dry_run_says_what_limits_the_render_noise(more, rays):
    run = Run.model_validate(
        {"camera": {"die_mm": 0.64}, "pixel": {"pitch_um": 10.0}, "resolution": 32, **more}
    )
    outline = run_outline(prepare("macbeth", run))
    assert outline["errors"]["rays_a_pixel"] == (rays and pytest.approx(rays))
    line = next(
        line
        for line in map(str, outline_document("run", outline, Path("out")).terminal)
        if line.startswith("errors")
    )
    assert "of mean ΔE from the film alone" in line


@pytest.mark.parametrize(
    ("given", "assumed"),
    [
        ({"die_mm": 8.4}, True),
        ({"die_mm": 8.4, "focal_length_mm": 3.86}, False),
        ({}, False),
        ({"focal_length_mm": 6.0}, False),
    ],
)
def test_focal_length_of_a_given_die_is_assumed(given, assumed):
    """3.86 mm was chosen for the small die of the scene: on a large one it is a wide-angle lens, 2
    atan(8.4/(2·3.875)).
    """
    run = Run.model_validate({"camera": given, "pixel": {"pitch_um": 20.0}, "resolution": 32})
    camera = pixsim.load_scene("csf").camera(run.camera)
    words = run.camera.assumption(camera)
    assert words == (
        "focal length 3.86 mm assumed, that of the scene: a field of 94.6° × 94.6°"
        if assumed
        else ""
    )
    _, line, *_ = map(
        str, outline_document("run", run_outline(prepare("csf", run)), Path("out")).terminal
    )
    assert line.startswith("camera")
    assert ("assumed" in line) == assumed


def test_lens_is_named_with_its_scale():
    camera = pixsim.load_scene("csf").camera(
        CameraOptions(die_mm=4.0), LensOptions(file="phone", focal_length_mm=5.0)
    )
    assert lens_words(camera).startswith("lens phone scaled to 5 mm, f/")
    assert not lens_words(pixsim.Camera())
    assert not CameraOptions(die_mm=4.0).assumption(camera), "the lens has its own"


def test_pictures_are_written_to_no_pdf(tmp_path):
    with pytest.raises(
        PixsimError,
        match="figures: got 'pdf' for a RunResult; allowed: 'svg', since it has pictures",
    ):
        pixsim.write_report(run_result([1.0], {}), tmp_path, figures="pdf")


def light_file(path: Path, steps: np.ndarray, pitch_um: float) -> Path:
    """Irradiance as another program wrote it: a picture of ones and twos, these about half as
    bright as white.
    """
    nm = np.arange(400.0, 701.0, 20.0)
    data = 5e-5 * steps[:, :, None] * np.ones(nm.size)
    np.savez(
        path,
        data=data,
        wavelength_nm=nm,
        units="W m^-2 nm^-1",
        pitch_um=pitch_um,
        white_cd_per_m2=300.0,
    )
    return path


SHEET = (
    "--pixel.full-well-e 8000 --pixel.read-noise-e 5 --pixel.dark-current-e-per-s 10"
    " --pixel.quantum-efficiency 0.6"
)


def test_run_page_foreign_picture_and_data_sheet(tmp_path: Path) -> None:
    """The page names the file, and lists no setting of a process, nor a fill factor, which was not
    given.
    """
    y, x = np.indices((6, 3000))
    light_file(tmp_path / "mine.npz", 1 + (x // 50 + y) % 2, 1.5)
    sensor = f"--pixel.technology none {SHEET} --pixel.pitch-um 1.5 --display.dots 4096"
    code, _, err = command(
        f"run {tmp_path / 'mine.npz'} {sensor} --camera.die-mm 4.5 --out {tmp_path / 'out'}"
    )
    assert code == 0, err
    page = " ".join(text_of(tmp_path / "out").split())
    assert "<h1>mine with 1.5 µm pixels</h1>" in page
    assert ">read from mine.npz<" in page
    assert str(tmp_path) not in page
    assert "mm, data sheet<" in page
    assert "Noise and non-uniformities that the data sheet does not state are zero." in page
    rows = set(re.findall(r'<tr><th scope="row">([^<]+)</th>', page))
    assert {"pixel.full_well_e", "pixel.technology"} <= rows
    assert (
        not {
            "capacitance",
            "well_limit",
            "conversion",
            "response",
            "fill_factor_law",
            "photodiode area over pixel area",
        }
        & rows
    )
    assert "Each dot of the whole pictures is the mean of 4 × 4 dots of the display." in page


def test_run_page_enlarges_small_picture(rendered):
    page = text_of(rendered[0])
    assert "--dots: 496px" in page  # 62 of 64 dots are shown, at least 480 px wide
    assert "each dot enlarged 8 ×" in page


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


def test_colour_rows_are_those_of_score_json() -> None:
    """Noise gains, SMI, error of the patches and shares out of gamut; none for a monochrome
    sensor.
    """
    facts = {
        "layout": "RG/CB",
        "white_spectrum": "D65",
        "noise_gains": [1.58, 1.27, 1.13],
        "patches_mean_delta_e": 1.64,
        "sensitivity_metamerism_index": 90.98,
    }
    rows = dict(colour_rows(facts, (0.036, 0.05)))
    assert rows["noise gains of the matrix in red, green, blue"] == "1.58, 1.27, 1.13"
    assert {"RG/CB", "D65", "90.98", "1.64", "3.60 %", "5.00 %"} < set(rows.values())
    assert colour_rows(None, None) == []
