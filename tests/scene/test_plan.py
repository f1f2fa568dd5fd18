"""The plan: its decisions, and that its bound covers the difference between pruned and full
renders.
"""

from __future__ import annotations

import json
from functools import cache
from typing import NamedTuple

import numpy as np
import pytest
from helpers.chains import imaging_chain
from helpers.commands import assert_refused, command
from helpers.edits import decision, load
from scipy.stats import t as student

import pixsim
from pixsim import optics
from pixsim.base.schema import SCHEMA
from pixsim.scene.charts import siemens_star, write_chart
from pixsim.scene.packaged import packaged_scenes
from pixsim.scene.plan import UNIFORM_RESOLUTION, decide_saturation, make_plan, make_render_plan
from pixsim.scene.renderer import Renderer
from pixsim.sensor.integration import ideal_rate, integrate_pixels
from pixsim.sensor.pixel import derive
from pixsim.sensor.reading import Readout

PIXELS = [pixsim.Pixel(), pixsim.Pixel(technology="4t-bsi", pitch_um=2.8)]
LAMPS = ["d65", "a", "fl11", "led_b3", "laser_532nm"]
CASES = {name: (name, {}) for name in packaged_scenes() if name != "macbeth"}
CASES |= {f"macbeth {lamp}": ("macbeth", {"lamp": f"spectra/{lamp}.spd"}) for lamp in LAMPS}
SLOW = (
    "macbeth a",
    "macbeth fl11",
    "macbeth led_b3",
    "siemens_star",
    "still_life",
    "line_lamp",
    "cornell_box",
    "yard",
)
TOLERANCES = (1e-2, 1e-3, 1e-4)
ONE_PERCENT = 0.01


# --- Pruned and full renders ---


class Sampled(
    NamedTuple
):  # mean electrons of independent renders, (renders, places × pixels), and the bound of the plan
    mean_e: np.ndarray
    bound_e: float


class Effort(
    NamedTuple
):  # samples and renders of the pruned and the full side for a noise below 1 %
    spp: tuple[int, int] = (16, 4)
    renders: tuple[int, int] = (6, 5)
    places: int = 4


# Edges alias on a coarse film, and paths are noisy: there the whole picture is compared.
EFFORT = {
    "csf": Effort((64, 16), (6, 6), 2),
    "siemens_star": Effort((256, 16), (6, 6), 1),
    "slanted_edge": Effort((64, 4), places=1),
    "line_lamp": Effort((64, 16), (6, 4), 1),
    "still_life": Effort((16, 16), (8, 4), 1),
    "cornell_box": Effort((256, 64), (8, 6), 1),
    "yard": Effort((64, 16), (6, 4), 1),
}
FILM = 24


def patches(rate: np.ndarray) -> np.ndarray:
    """Return the means over the centres of the 24 patches of macbeth."""
    rows, columns = (
        [slice(*np.rint((i + np.array([0.3, 0.7])) * FILM / n).astype(int)) for i in range(n)]
        for n in (4, 6)
    )
    return np.array([rate[row, column].mean() for row in rows for column in columns])


def blocks(rate: np.ndarray, count: int) -> np.ndarray:
    side = FILM // count
    return rate.reshape(count, side, count, side).mean(axis=(1, 3)).ravel()


@cache
def sampled(case: str, full: bool) -> Sampled:
    name, parameters = CASES[case]
    effort = EFFORT.get(name, Effort())
    scene = load(name, resolution=FILM, spp=effort.spp[full], **parameters)
    plan = make_plan(scene, full=full)
    job = Renderer(scene, scene.camera(), plan, seed=1)
    renders = []
    for index in range(effort.renders[full]):
        image = job.image(*job.run(index))
        rates = [ideal_rate(image, derive(pixel)) for pixel in PIXELS]
        renders.append(
            np.concatenate(
                [
                    patches(rate) if name == "macbeth" else blocks(rate, effort.places)
                    for rate in rates
                ]
            )
        )
    return Sampled(np.array(renders), plan.bound_e)


def gates(pruned: Sampled, full: Sampled) -> tuple[np.ndarray, np.ndarray]:
    """Return each place's (relative difference, limit from bound and noise); Student's t, false
    alarm 1e-3 in total.
    """
    n, m = len(pruned.mean_e), len(full.mean_e)
    mean = full.mean_e.mean(axis=0)
    ours, theirs = (side.mean_e.var(axis=0, ddof=1) for side in (pruned, full))
    error = np.sqrt(ours / n + theirs / m) / mean
    freedom = (ours / n + theirs / m) ** 2 / np.maximum(
        (ours / n) ** 2 / (n - 1) + (theirs / m) ** 2 / (m - 1), 1e-300
    )
    level = 1 - (1 - 1e-3) ** (1 / mean.size)
    quantile = student.ppf(1 - level / 2, np.maximum(freedom, 1.0))
    float32 = 1e-6
    return (
        pruned.mean_e.mean(axis=0) / mean - 1,
        pruned.bound_e + full.bound_e + float32 + quantile * error,
    )


# test_monte_carlo_judge compares the pictures of csf, flat has one luminance, and test_scenes has
# the patches under smooth lamps.
RENDERED_ELSEWHERE = ("csf", "flat", "slanted_edge", "macbeth d65")


@pytest.mark.parametrize(
    "case",
    [
        pytest.param(case, marks=pytest.mark.slow) if case in (*SLOW, *RENDERED_ELSEWHERE) else case
        for case in CASES
    ],
)
def test_plan_pruned_and_full_agree_within_bound(case):
    pruned, full = sampled(case, False), sampled(case, True)
    difference, allowed = gates(pruned, full)
    assert np.all(np.abs(difference) <= allowed), (difference, allowed)
    # And an error of 1 % would be noticed, at most of the places.
    for wrong in (1 + ONE_PERCENT, 1 - ONE_PERCENT):
        difference, allowed = gates(Sampled(pruned.mean_e * wrong, pruned.bound_e), full)
        assert np.mean(np.abs(difference) > allowed) > 0.5, (difference, allowed)


@pytest.mark.parametrize(
    "case",
    [pytest.param(case, marks=pytest.mark.slow) if case in SLOW[:3] else case for case in CASES],
)
def test_plan_bound_is_within_tolerance(case):
    name, parameters = CASES[case]
    scene = load(name, resolution=64, **parameters)
    plans = [make_plan(scene, tolerance_e=tolerance) for tolerance in TOLERANCES]
    for plan, tolerance in zip(plans, TOLERANCES, strict=True):
        assert 0 <= plan.bound_e <= tolerance
        assert plan.bound_e == sum(line.bound_e for line in plan.decisions)
        assert min(item.bound_e for item in plan.decisions) >= 0
        assert not plan.warnings
    passes, bands = (
        [plan.light.passes for plan in plans],
        [plan.light.bands.width_nm.size for plan in plans],
    )
    assert passes == sorted(passes)
    assert bands == sorted(bands)
    if name in ("macbeth", "still_life") and "laser" not in case:
        assert passes[-1] > passes[0]


def test_plan_line_lamp_needs_one_pulse():
    plan = make_render_plan(load("macbeth", lamp="spectra/laser_532nm.spd"), tolerance_e=1e-4)
    assert plan.bound_e <= 1e-4
    assert plan.light.passes == 1 < plan.light.full_passes


def test_plan_unreachable_tolerance_warns():
    plan = make_plan(load("still_life"), tolerance_e=1e-6)
    assert plan.bound_e > 1e-6
    (message,) = plan.warnings
    assert f"{plan.bound_e:.1e}" in message
    assert "1e-06" in message


def test_plan_flat_field_coarse_film_keeps_fall_off():
    """Mean electrons of every pixel from 64 and from 1024 samples across, with the closed form of
    the fall-off.
    """
    for camera in (pixsim.Camera(), pixsim.Camera(focal_length_mm=2.0)):
        lens = camera.image_distance_mm, camera.f_number, camera.magnification
        pitches = [(n, 1e3 * camera.die_mm / n) for n in (UNIFORM_RESOLUTION, 1024)]
        coarse, fine = (
            integrate_pixels(optics.field_factor((n, n), um, *lens), um, 53.0, 40.0)
            for n, um in pitches
        )
        bound = decision(make_plan(load("flat"), camera), "oversampling").bound_e
        assert 0.5 * bound < np.abs(coarse / fine - 1).max() < bound
    # Where that is too much, the film stays as it is.
    assert make_plan(load("flat"), tolerance_e=1e-5).film.resolution is None


# --- Decisions ---

SUBJECTS = [
    "wavelength bands",
    "spectral rank",
    "spectrum tables",
    "bounces",
    "lens samples",
    "texture samples",
    "diffraction",
]
SUBJECTS += ["oversampling", "pixel stack", "saturation"]


@pytest.mark.parametrize("full", [False, True])
@pytest.mark.parametrize(
    "name", [case for case in CASES if case not in SLOW[:3]]
)  # one smooth lamp, and the line
def test_make_plan_decisions_have_reasons(name, full):
    scene, parameters = CASES[name]
    plan = make_plan(load(scene, resolution=64, **parameters), full=full)
    assert [item.subject for item in plan.decisions] == SUBJECTS
    for line in plan.decisions:
        assert line.reason
        assert bool(line.saved) == (not line.kept), line
    table = plan.as_dict()
    assert json.loads(json.dumps(table, allow_nan=False)) == table
    assert (
        len(table["wavelength_nm"]) == len(table["band_width_nm"]) == plan.light.bands.width_nm.size
    )
    assert sum(table["band_width_nm"]) == pytest.approx(470)
    assert (
        table["passes"]
        == sum(len(light.fit.passes) for light in plan.light.lamps)
        <= table["passes_full"]
    )


BARE = {"height_um": 8.0, "index": 1.5, "shift": "optimal"}


def test_decide_stack_names_the_height() -> None:
    """A wide lens of a technology lies at p/√π."""
    scene = load("csf", resolution=64)
    for pitch_um, words in ((6.5, "microlens 3.667 µm above"), (1.4, "microlens 2.4 µm above")):
        plan = make_plan(
            scene, pixsim.Camera(), pixsim.Pixel(technology="4t-bsi", pitch_um=pitch_um)
        )
        assert words in decision(plan, "pixel stack").reason


def test_decide_stack_says_what_it_left_out_and_the_evaluation_does_it() -> None:
    """A slow lens, whose narrow cones of light meet photodiodes alike everywhere; not a fast one, a
    small tolerance, or --full.
    """
    scene, slow, pixel = (
        load("csf", resolution=32),
        pixsim.Camera(f_number=45.0),
        pixsim.Pixel(pitch_um=10.0, stack=BARE),
    )
    plan = make_plan(scene, slow, pixel)
    line = decision(plan, "pixel stack")
    assert not line.kept
    assert 0 < line.bound_e < plan.bound_e < plan.tolerance_e
    assert "opening 8 µm above the photodiode" in line.reason
    assert "one scale for all pixels" in line.reason
    for camera, options in (
        (pixsim.Camera(f_number=1.4), {}),
        (slow, {"tolerance_e": 1e-5}),
        (slow, {"full": True}),
    ):
        other = make_plan(scene, camera, pixel, **options)
        assert decision(other, "pixel stack").kept
        assert decision(other, "pixel stack").bound_e == 0
    assert make_plan(scene, slow, pixel, full=True).spare_e == 0
    for stack in (None, {"enabled": False}):
        without = decision(make_plan(scene, slow, pixsim.Pixel(stack=stack)), "pixel stack")
        assert (without.kept, without.bound_e, without.reason.partition(":")[0]) == (
            False,
            0,
            "none, or switched off",
        )
    image = pixsim.render(scene, slow, plan=plan)
    assert image.header["spare_e"] == plan.spare_e
    for left, light in ((True, image), (False, pixsim.render(scene, slow, full=True))):
        made = imaging_chain(light, slow, pixel, pixsim.Exposure(), pixsim.Display())
        assert made.collection is not None
        assert made.collection.is_scale == left


def test_decide_oversampling_states_the_samples_of_a_photodiode():
    pixel = pixsim.Pixel(pitch_um=8.0, fill_factor=0.25)
    reason = decision(
        make_plan(load("csf", resolution=512), pixsim.Camera(), pixel), "oversampling"
    ).reason
    pitch_um = 2713.6 / 512
    assert (
        reason == f"512 samples of {pitch_um:.3g} µm across, {4 / pitch_um:.2g} per photodiode or"
        " microlens"
    )


def test_decide_saturation_states_law():
    hard = decide_saturation(Readout.of(derive(pixsim.Pixel())), 0.1)
    assert (hard.kept, hard.bound_e) == (True, 0.0)
    assert "hard clip" in hard.reason
    soft = decide_saturation(Readout.of(derive(pixsim.Pixel(well_limit="diode"))), 0.1)
    assert not soft.kept
    assert "178000 e- in 0.1 s (86 % of the well)" in soft.reason
    assert soft.bound_e == pytest.approx(1e-6 / 0.857, rel=1e-2)
    bent = decide_saturation(
        Readout.of(derive(pixsim.Pixel(well_limit="diode", conversion="junction"))), 0.1
    )
    assert bent.kept
    assert "the diode turns forward above 178000 e-" in bent.reason
    assert (
        "hard clip"
        in decide_saturation(
            Readout.of(derive(pixsim.Pixel(technology="4t-bsi", pitch_um=2.8))), 0.1
        ).reason
    )


def test_make_plan_uses_longest_exposure():
    long = {"in 1 s (83 %": {"max_integration_s": 1.0}, "in 3600 s (73 %": {"integration_s": 3600}}
    for part, exposure in {
        "in 0.1 s (86 %": None,
        **{part: pixsim.Exposure(**times) for part, times in long.items()},
    }.items():
        plan = pixsim.make_plan(
            load("flat"), pixel=pixsim.Pixel(well_limit="diode"), exposure=exposure
        )
        assert part in decision(plan, "saturation").reason


# --- The command ---


def test_plan_command_prints_table(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "160")
    code, out, err = command("plan csf --variant scalar_spectral -D resolution=64")
    assert (code, err) == (0, "")
    planned = make_plan(load("csf", resolution=64), display=pixsim.Display())
    for subject, line_of_plan in zip(SUBJECTS, planned.decisions, strict=True):
        (line,) = (line for line in out.splitlines() if line.startswith(subject))
        assert line[len(subject) :].split()[0] == ("kept" if line_of_plan.kept else "left"), line
        assert line_of_plan.saved in line
    assert "bound on e-" in out
    assert "1 of 12 passes" in out
    assert "tolerance 0.001" in out
    assert not list(tmp_path.iterdir())


def test_plan_command_prints_json():
    code, out, err = command(
        "plan macbeth --variant scalar_spectral --json --tolerance-e 1e-4 -D resolution=64"
    )
    assert (code, err) == (0, "")
    table = json.loads(out)
    made = make_plan(load("macbeth", resolution=64), tolerance_e=1e-4, display=pixsim.Display())
    expected = json.loads(json.dumps(made.as_dict())) | {"assumption": "", "schema": SCHEMA}
    assert {name: table[name] for name in expected} == expected
    assert table["tolerance_e"] == 1e-4
    full = json.loads(command("plan macbeth --variant scalar_spectral --json --full")[1])
    assert all(item["kept"] for item in full["decisions"])
    assert full["passes"] == full["passes_full"] > table["passes_full"] / 10


def test_plan_command_warns_above_tolerance():
    code, out, _ = command("plan still_life --variant scalar_spectral --tolerance-e 1e-6")
    assert code == 0
    assert "warning: the error of mean electrons" in out


@pytest.mark.parametrize(
    ("line", "wanted"),
    [
        ("plan nowhere", ["nowhere", "csf, flat"]),
        ("plan csf --tolerance-e 0", ["tolerance_e", "0", "greater than or equal to 1e-09"]),
        ("plan csf --tolerance-e -1e-3", ["tolerance_e", "-1e-3", "greater than or equal to 1e-09"]),
        ("plan csf --tolerance-e 1", ["tolerance_e", "1", "less than 1"]),
        ("plan csf --tolerance-e nan", ["tolerance_e", "nan"]),
        ("plan csf --tolerance-e little", ["tolerance_e", "little", "number"]),
        ("plan csf --sensor third", ["third", "'camera'"]),
        ("plan csf -D resolutoin=3", ["Did you mean 'resolution'?"]),
        ("plan csf --pixel.pitch-um 1", ["pitch_um", "1"]),
        ("plan", ["SCENE"]),
    ],
)  # fmt: skip
def test_plan_command_error_is_one_line(line, wanted):
    assert_refused(*command(line), wanted)


@pytest.mark.parametrize("tolerance", [0.0, -1e-3, 1.0, float("nan"), float("inf")])
def test_make_plan_invalid_tolerance_raises(tolerance):
    with pytest.raises(
        pixsim.PixsimError, match=r"tolerance_e: got .*allowed: above 0 and below 1"
    ):
        make_render_plan(load("flat"), tolerance_e=tolerance)


def test_make_plan_chart_of_working_directory_is_a_known_chart(tmp_path, monkeypatch):
    """A relative name counts from the scene's folder or the working directory, as for Mitsuba: the
    plan knows its texels.
    """
    write_chart(tmp_path / "star.exr", siemens_star(64, 64))
    monkeypatch.chdir(tmp_path)
    relative, whole = (
        make_plan(load("csf", resolution=64, chart=name))
        for name in ("star.exr", str(tmp_path / "star.exr"))
    )
    assert relative.film.chart is not None
    assert relative.as_dict() == whole.as_dict()
