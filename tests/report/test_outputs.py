"""`pixsim run` on pictures made before or elsewhere, through the command."""

from __future__ import annotations

import json
import warnings
from pathlib import Path

import numpy as np
import pytest
from helpers.commands import assert_refused, command

import pixsim
from pixsim.base.parameters import CameraOptions
from pixsim.light.exr import write_channels
from pixsim.optics.exchange import read_with_camera, write_npz

OPTIONS = "--pixel.pitch-um 21.2 --display.dots 64 --seed 3"
LENS = "--camera.f-number 2.8"


def scored(line: str) -> tuple[dict, str]:
    """score.json, and what was warned of."""
    with warnings.catch_warnings():
        warnings.simplefilter("always")
        code, out, err = command(line)
    assert code == 0, err
    return json.loads(out), err


@pytest.fixture(scope="module")
def ran(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict]:
    """A run's folder and its score."""
    out = tmp_path_factory.mktemp("ran")
    line = f"run csf --variant scalar_spectral -D resolution=64 {LENS} {OPTIONS} --json --out {out}"
    return out, scored(line)[0]


@pytest.mark.parametrize("lens", ["", LENS])
def test_a_runs_irradiance_gives_its_score_again(ran, lens, tmp_path):
    folder, before = ran
    after, err = scored(f"run {folder / 'irradiance.exr'} {lens} {OPTIONS} --json --out {tmp_path / 'again'}")
    assert err == ""
    for name in ("mean_delta_e", "max_delta_e", "mean_electrons_e", "integration_s", "camera", "irradiance"):
        assert after[name] == before[name], name
    for name in ("raw.exr", "delta_e.exr", "image.png", "ideal.png", "irradiance.exr"):
        assert (tmp_path / "again" / name).read_bytes() == (folder / name).read_bytes(), name
    assert "render_noise" not in after
    assert "plan" not in after
    assert before["camera"]["f_number"] == 2.8


def test_another_pixel_or_seed_gives_another_score(ran, tmp_path):
    folder, before = ran
    for option, other in (("--seed 3", "--seed 4"), ("--pixel.pitch-um 21.2", "--pixel.pitch-um 42.4")):
        after, _ = scored(f"run {folder / 'irradiance.exr'} {OPTIONS.replace(option, other)} --json --out {tmp_path}")
        assert after["mean_delta_e"] != before["mean_delta_e"]


def test_an_npz_gives_the_same_score(ran, tmp_path):
    """Its bands are at their centres: at 400 and 800 nm, where the response begins and ends, that is half a band too much."""
    folder, before = ran
    write_npz(tmp_path / "picture.npz", pixsim.read_exr(folder / "irradiance.exr"))
    after, err = scored(f"run {tmp_path / 'picture.npz'} {LENS} {OPTIONS} --json --out {tmp_path / 'out'}")
    assert err == ""
    assert after["irradiance"]["luminance_cd_per_m2"] == pytest.approx(1000, rel=1e-5)  # d65 at the digits of emitter_scale
    electrons = after["mean_electrons_e"] / after["integration_s"]
    assert electrons == pytest.approx(before["mean_electrons_e"] / before["integration_s"], rel=1e-2)
    # Other noise, and D65 as white where the file tells no lamp.
    assert after["mean_delta_e"] == pytest.approx(before["mean_delta_e"], rel=0.02)


def test_a_camera_from_the_file_has_the_pictures_die(ran):
    folder, _ = ran
    image, camera = read_with_camera(folder / "irradiance.exr", CameraOptions())
    assert camera == pixsim.Camera(f_number=2.8)
    assert camera.die_mm == pytest.approx(image.pitch_um * 64 / 1e3)


def test_another_lens_than_the_files_is_warned_of(ran, tmp_path):
    folder, _ = ran
    _, err = scored(f"run {folder / 'irradiance.exr'} --camera.f-number 8 {OPTIONS} --json --out {tmp_path}")
    assert err.startswith("warning: the irradiance was rendered with another camera")


# --- Pictures made elsewhere ---

NM = np.array([450.0, 550.0, 650.0])


def foreign_exr(path: Path, units: str | None, light: float = 0.01) -> Path:
    """A ramp of 4 × 64 × 64 samples in the layout of Fichet et al."""
    ramp = np.tile(np.linspace(0.2, 1, 64, dtype=np.float32) * light, (64, 1))
    header = {"spectralLayoutVersion": "1.0"} | ({"emissiveUnits": units} if units else {})
    write_channels(path, {f"S0.{int(nm)},000000nm": ramp for nm in NM}, header)
    return path


def test_light_without_units_is_refused_with_the_way_to_state_them(tmp_path):
    path = foreign_exr(tmp_path / "bare.exr", None)
    out = tmp_path / "out"
    assert_refused(*command(f"run {path} {OPTIONS} --out {out}"), ["bare.exr", "none in the file", "--units", "W.m^-2.nm^-1"])
    assert not out.exists()
    stated, err = scored(f"run {path} --units W.m^-2.nm^-1 {OPTIONS} --json --out {out}")
    assert "the scene does not tell its white" in err
    told, _ = scored(f"run {foreign_exr(path, 'W.m^-2.nm^-1')} {OPTIONS} --json --out {out}")
    assert told["mean_electrons_e"] == stated["mean_electrons_e"]
    micro, _ = scored(f"run {foreign_exr(path, None, 1.0)} --units uW/cm^2/nm {OPTIONS} --json --out {out}")
    assert micro["mean_electrons_e"] == pytest.approx(stated["mean_electrons_e"], rel=1e-6)  # 1 µW/cm² is 0.01 W/m²


def test_radiance_is_seen_through_the_lens(tmp_path):
    path = foreign_exr(tmp_path / "seen.exr", "W.m^-2.sr^-1.nm^-1", 0.1)
    exposure = "--exposure.integration-s 1e-4"
    rates = [
        scored(f"run {path} --camera.f-number {n} {exposure} {OPTIONS} --json --out {tmp_path / 'out'}")[0]["mean_electrons_e"]
        for n in (4, 8)
    ]
    m = pixsim.Camera().magnification
    # On the axis; 20° off it .5 % more. 4 for 1/N² alone is 1.2 % off.
    expected = (1 + 4 * 64 * (1 + m) ** 2) / (1 + 4 * 16 * (1 + m) ** 2)
    assert rates[0] / rates[1] == pytest.approx(expected, rel=5e-3)


def test_the_white_of_a_picture_that_tells_none_is_measured(tmp_path):
    path = foreign_exr(tmp_path / "ramp.exr", "W.m^-2.sr^-1.nm^-1")
    told, err = scored(f"run {path} {OPTIONS} --json --out {tmp_path / 'out'}")
    image, camera = read_with_camera(path, CameraOptions())
    lens = camera.image_distance_mm, camera.f_number, camera.magnification
    luminance = image.illuminance_lx() / pixsim.optics.field_factor(image.shape, image.pitch_um, *lens)
    white = float(f"{np.percentile(luminance, 99):.2g}")
    assert told["irradiance"]["luminance_cd_per_m2"] == white
    assert told["irradiance"]["white_from"] == "99th percentile"
    # 683.002 ∫ ȳ L of the ramp's light end, even over bands of 100 nm, within the two digits.
    fine_nm = NM[:, None] + np.linspace(-49.5, 49.5, 100)
    bands = 683.002 * 0.01 * float(pixsim.spectral.photopic_efficiency(fine_nm).sum())
    assert white == pytest.approx(bands, rel=0.06)
    assert err == (
        f"warning: the scene does not tell its white: {white:g} cd/m² is taken, the 99th percentile of its luminance; "
        f"set --display.white-cd-per-m2 {white:g} to keep it\n"
    )
    kept, err = scored(f"run {path} --display.white-cd-per-m2 {white:g} {OPTIONS} --json --out {tmp_path / 'out'}")
    assert err == ""
    assert kept["mean_delta_e"] == told["mean_delta_e"]
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
def test_what_does_not_go_together_is_refused(ran, line, wanted, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert_refused(*command("run " + line.format(exr=ran[0] / "irradiance.exr") + " --out out"), wanted)
    assert not list(tmp_path.iterdir())


def test_a_folder_holds_one_run(ran, tmp_path):
    """What an earlier run wrote and this one leaves out is not of these pictures; the light that they are of stays."""
    folder, _ = ran
    light = tmp_path / "irradiance.exr"
    light.write_bytes((folder / "irradiance.exr").read_bytes())
    here = f"--no-irradiance {OPTIONS} --json --out {tmp_path}"
    scored(f"run {light} {here} --raw tiff")
    assert {"irradiance.exr", "raw.tiff", "report.html"} <= {path.name for path in tmp_path.iterdir()}
    assert "irradiance.exr" not in (tmp_path / "report.html").read_text(encoding="utf-8")
    scored(f"run {folder / 'irradiance.exr'} {here}")
    assert not {"irradiance.exr", "raw.tiff"} & {path.name for path in tmp_path.iterdir()}
    page = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert {name for name in ("raw.tiff", "raw.exr", "score.json") if f'href="{name}"' in page} == {"raw.exr", "score.json"}
