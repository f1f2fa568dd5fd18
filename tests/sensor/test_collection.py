"""The stack in the imaging chain: conservation, limits, shading, double counting, and what is
refused.
"""

from __future__ import annotations

import math
import warnings
from dataclasses import replace
from itertools import product
from typing import Any

import numpy as np
import pytest
from helpers.chains import imaging_chain

from pixsim.base.arrays import Array
from pixsim.base.errors import PixsimError
from pixsim.light.spectral import SpectralImage
from pixsim.measure.experiment import pixel_efficiency
from pixsim.measure.sfr import edge_response
from pixsim.optics.camera import Camera
from pixsim.optics.camera_light import CameraPupil, camera_pupil
from pixsim.optics.diffraction import diffraction_otf
from pixsim.optics.pupil import disc_pupil, numerical_aperture
from pixsim.optics.stack import Stack, collected_shares
from pixsim.sensor.collection import (
    Illumination,
    check_efficiency,
    collected_fraction,
    collection_of,
    emva_illumination,
    half_sizes_um,
    scale_error,
    stack_shares,
)
from pixsim.sensor.correction_options import Correction
from pixsim.sensor.diffusion import absorption_per_um, diffusion_mtf
from pixsim.sensor.exposure import Exposure
from pixsim.sensor.integration import (
    collecting_area_um2,
    illumination_of,
    integrate_pixels,
    mean_signal_rate,
    pixels_on,
)
from pixsim.sensor.pixel import PixelPhysics, derive, smallest_pitch_um
from pixsim.sensor.pixel_options import Pixel
from pixsim.sensor.stack_options import StackOptions
from pixsim.sensor.technology import Technology, load_technology
from pixsim.studies.design import cases_of, physics_of, study_pitches_um
from pixsim.studies.settings import Study
from pixsim.viewer.chain import ImagingChain
from pixsim.viewer.display_options import Display
from pixsim.viewer.merging import merge

CAMERA = Camera(die_mm=0.48, f_number=2.0)
WIDE = Camera(die_mm=0.48, focal_length_mm=0.4, f_number=2.0)  # 40° in the corners
NM = np.arange(420.0, 701.0, 20.0)
LENS: dict[str, Any] = {"height_um": 4.0, "index": 1.5, "microlens": "square"}
STACKS: dict[str, dict[str, Any]] = {
    "bare": {"height_um": 4.0, "index": 1.5},
    "lens": LENS,
    "optimal": LENS | {"shift": "optimal"},
    "fixed shift": LENS | {"shift_um": [0.4, -0.2]},
    "crosstalk": LENS | {"shift": "optimal", "crosstalk": 0.1},
    "diffusion": LENS | {"shift": "optimal", "depletion_um": 1.0, "diffusion_length_um": 10.0},
    "bare, diffusion": {
        "height_um": 4.0,
        "index": 1.5,
        "depletion_um": 1.0,
        "diffusion_length_um": 10.0,
    },
}
QUIET: dict[str, Any] = {"pitch_um": 6.0, "infrared_cut_nm": 720.0, "prnu": 0.0}


def even_picture(side: int = 96, value: float = 1e-3) -> SpectralImage:
    return SpectralImage(
        NM,
        20.0,
        480 / side,
        data=np.full((side, side, NM.size), value),
        header={"diffraction": False},
    )


def detailed_picture(side: int = 96) -> SpectralImage:
    data = np.random.default_rng(5).uniform(0.2, 1.0, (side, side, NM.size))
    return SpectralImage(NM, 20.0, 480 / side, data=1e-3 * data, header={"diffraction": False})


def chain(
    pixel: Pixel, image: SpectralImage | None = None, camera: Camera = CAMERA, **settings: Any
) -> ImagingChain:
    display = Display(white_cd_per_m2=1e4, raster="one_to_one", **settings.pop("display", {}))
    return imaging_chain(image or even_picture(), camera, pixel, Exposure(), display, **settings)


def test_without_a_stack_nothing_changes() -> None:
    """Bit for bit: the light on the photodiodes, and white on their area."""
    pixel, image = Pixel(**QUIET), detailed_picture()
    physics, light = derive(pixel), illumination_of(image, CAMERA, derive(pixel))
    rate = (image.data @ np.ones(NM.size)).astype(float)
    assert collection_of(physics, light, (4, 4)) is None
    assert collecting_area_um2(image, CAMERA, physics) == physics.photodiode_area_um2
    found = chain(pixel, image)
    assert found.development.shading is None
    np.testing.assert_array_equal(found.signal_e_per_s, mean_signal_rate(image, CAMERA, physics))
    assert (
        integrate_pixels(rate, image.pitch_um, 6.0, physics.photodiode_side_um).shape
        == found.signal_e_per_s.shape
    )


@pytest.mark.parametrize("name", STACKS)
def test_flat_field_is_conserved(name: str) -> None:
    """Even light times the collection; with the display's correction it is even again, and on axis
    it is display white's.
    """
    pixel, camera = Pixel(**QUIET, stack=STACKS[name]), WIDE
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        found, raw = (
            chain(pixel, camera=camera, display={"shading_correction": on}) for on in (True, False)
        )
    assert found.development.flat_field is not None
    flat = found.signal_e_per_s / found.development.flat_field
    assert np.ptp(flat) <= 1e-12 * flat.max()
    assert raw.development.shading is None
    assert np.ptp(found.development.flat_field) > (
        1e-2 if "shift" not in STACKS[name] else 1e-6
    )  # there is shading
    white = (
        found.white_e_per_s / flat.mean()
    )  # over the picture's light, which is the same at every pixel
    plain = chain(Pixel(**QUIET), camera=camera)
    assert white == pytest.approx(plain.white_e_per_s / plain.signal_e_per_s.mean(), rel=1e-11)


def test_low_opening_is_a_bare_photodiode() -> None:
    """h → 0: a pixel collects the light on its photodiode, from every direction."""
    image = detailed_picture()
    pixel, low = Pixel(**QUIET), Pixel(**QUIET, stack={"height_um": 1e-3, "index": 1.5})
    wanted, found = (mean_signal_rate(image, CAMERA, derive(item)) for item in (pixel, low))
    np.testing.assert_allclose(found, wanted, rtol=1e-3)  # h NA/n w = 5e-5, on each side
    assert np.abs(found / wanted - 1).max() > 1e-6


# Chief ray angles of a phone's lens, which fall again towards the corner.
ANGLES_DEG = (0.0, 4.7, 9.5, 14.2, 18.7, 22.9, 26.6, 29.6, 31.8, 32.9, 32.6)
PHONE = [(0.34 * row / 10, angle_deg) for row, angle_deg in enumerate(ANGLES_DEG)]


@pytest.mark.parametrize(
    ("name", "table"), [*((name, None) for name in STACKS), ("lens", PHONE), ("optimal", PHONE)]
)
def test_shares_between_points_agree_with_the_kernel(name: str, table: Any) -> None:
    """All bands and a direct pupil at places between the nodes: polynomials over the field and the
    spectrum, and linear steps.
    """
    physics = derive(
        Pixel(
            **QUIET,
            stack=STACKS[name]
            | {"crosstalk": None, "depletion_um": None, "diffusion_length_um": None},
        )
    )
    camera, image = (
        Camera(die_mm=0.48, focal_length_mm=0.8, f_number=2.0, chief_ray_angle=table),
        even_picture(),
    )
    light, shape = illumination_of(image, camera, physics), (81, 81)
    collection = collection_of(physics, light, shape)
    assert collection is not None
    assert physics.stack is not None
    even = collection.relative(shape) * collection.on_axis
    weight = np.array(light.weight) / np.sum(light.weight)
    for row, column in ((40, 40), (3, 77), (22, 51), (80, 80), (60, 13)):
        y, x = (6e-3 * (at - 40) for at in (row, column))
        pupil = camera_pupil(camera).at(1e3 * x, 1e3 * y)
        wanted = weight @ collected_shares(physics.stack, pupil, NM).sum(axis=(-2, -1))
        assert even[row, column] == pytest.approx(wanted, abs=2e-3 if table else 1e-3), (
            row,
            column,
        )


def test_directions_of_a_table_reach_signal_shading_and_plan() -> None:
    """A telecentric table leaves no shading in a fast lens; steep angles shade more than those of
    the thin lens.
    """
    flat, steep = (
        WIDE.model_copy(update={"chief_ray_angle": table})
        for table in (((0.0, 0.0), (1.0, 0.0)), ((0.0, 0.0), (0.34, 50.0)))
    )
    pixel = Pixel(**QUIET, stack=LENS)
    thin, even, shaded = (
        chain(pixel, camera=camera).development.flat_field for camera in (WIDE, flat, steep)
    )
    assert thin is not None
    assert even is not None
    assert shaded is not None
    np.testing.assert_allclose(even, 1.0, atol=1e-9)
    assert shaded.min() < thin.min() - 0.02 < 0.95
    physics = derive(pixel)
    (_, wide), (axis, corner), (_, worst) = (
        stack_shares(physics, camera, 550.0) for camera in (WIDE, flat, steep)
    )
    assert axis == pytest.approx(corner, abs=1e-12)
    assert worst < wide < corner
    with pytest.warns(
        UserWarning,
        match=r"the optimal shift reaches [34]\.\d+ µm, more than half of the pitch of 6 µm",
    ):
        chain(Pixel(**QUIET, stack=LENS | {"shift": "optimal", "height_um": 8.0}), camera=steep)


# Nothing is lost but on the way: a slow lens whose chief rays land on the centres; and a wide pixel
# under its microlens.
SLOW = Camera(die_mm=0.48, f_number=16.0)
SCALES: list[tuple[dict[str, Any], float]] = [
    ({"stack": STACKS["bare"] | {"shift": "optimal"}}, 1e-3),
    (
        {
            "stack": LENS | {"height_um": 8.5, "shift": "optimal"},
            "pitch_um": 15.0,
            "fill_factor": 0.7,
        },
        1e-2,
    ),
]


@pytest.mark.filterwarnings("ignore:100 % of the ideal image")
@pytest.mark.parametrize(("fields", "tolerance"), SCALES)
def test_stack_that_loses_nothing_is_left_out_within_its_bound(
    fields: dict[str, Any], tolerance: float
) -> None:
    """The error of the mean electrons, over those of the brightest pixel, is at most the bound;
    without tolerance there is none.
    """
    pixel, image = Pixel(**QUIET | fields), detailed_picture()
    physics = derive(pixel)
    bound = scale_error(
        physics,
        camera_pupil(SLOW),
        half_sizes_um(physics, pixels_on(SLOW.die_um, pixel.pitch_um)),
        tolerance,
    )
    assert bound is not None
    assert 1e-6 < bound <= tolerance
    assert scale_error(physics, camera_pupil(SLOW), (200.0, 200.0), bound / 2) is None
    image.header["spare_e"] = tolerance
    found, whole = chain(pixel, image, SLOW), chain(pixel, image, SLOW, without_shortcuts=True)
    assert found.collection is not None
    assert whole.collection is not None
    assert found.collection.is_scale
    assert not whole.collection.is_scale
    assert found.development.shading is None
    assert whole.development.shading is not None
    assert found.white_e_per_s == pytest.approx(whole.white_e_per_s, rel=1e-12)
    error = np.abs(found.signal_e_per_s - whole.signal_e_per_s).max() / whole.signal_e_per_s.max()
    assert bound / 100 < error <= bound
    for stated in (0.0, -1.0, 2.0, "1e-2", None, True):  # files may state anything
        image.header["spare_e"] = stated
        np.testing.assert_array_equal(
            chain(pixel, image, SLOW).signal_e_per_s, whole.signal_e_per_s
        )


def test_nodes_of_wavelengths_keep_the_moments_of_the_spectrum() -> None:
    weight = np.random.default_rng(1).uniform(0, 1, 300)
    nm = np.linspace(400, 1000, 300)
    node, share = Illumination(tuple(nm), tuple(weight), CameraPupil(2.0, 1e3)).nodes(4)
    assert node.size == 4
    for power in range(4):  # exact for a cubic
        assert share @ node**power == pytest.approx(weight @ nm**power / weight.sum(), rel=1e-12)
    few = Illumination((500.0, 600.0, 700.0), (1.0, 0.0, 3.0), CameraPupil(2.0, 1e3)).nodes(4)
    np.testing.assert_array_equal(few, [[500.0, 700.0], [0.25, 0.75]])


def test_shading_correction_divides_frame_and_noise() -> None:
    pixel = Pixel(**QUIET, stack=STACKS["lens"])
    camera = WIDE
    on, off = (
        chain(pixel, camera=camera, display={"shading_correction": flag}) for flag in (True, False)
    )
    frame = off.capture("x")
    np.testing.assert_array_equal(frame.dn, on.capture("x").dn)
    assert off.development.flat_field is not None
    shown, raw = (item.development.light(frame) for item in (on, off))
    np.testing.assert_allclose(shown, raw / off.development.flat_field, rtol=1e-6)
    assert off.development.flat_field.min() < 0.9


def test_flat_frames_remove_the_shading_instead() -> None:
    """Many flat frames leave the same even picture as the display's numbers, and are not divided
    twice.
    """
    pixel = Pixel(
        **QUIET, dsnu=0.0, offset_fpn=0.0, column_fpn=0.0, black_level_dn=50.0, stack=STACKS["lens"]
    )
    camera = WIDE
    found = chain(pixel, camera=camera, correction=Correction(flat_frames=100, dark_frames=100))
    assert found.development.shading is None
    assert found.development.flat_field is not None
    frame = found.capture("flat")
    shown = frame.estimate_e / frame.integration_s / found.white_e_per_s
    even = float((found.signal_e_per_s / found.development.flat_field).mean() / found.white_e_per_s)
    spread = shown.std() / math.sqrt(shown.size)
    assert (
        abs(shown.mean() - even) < 5 * spread + 1e-4 * even
    )  # the mean of the flat frames, 640 000 values of 1 %
    edge = found.development.flat_field < np.quantile(found.development.flat_field, 0.2)
    assert (
        abs(shown[edge].mean() / shown[~edge].mean() - 1) < 5e-3
    )  # their collections differ by more than 10 %
    assert (
        found.development.flat_field[edge].mean() / found.development.flat_field[~edge].mean() < 0.9
    )


def test_efficiency_of_the_whole_pixel_is_not_counted_twice() -> None:
    """In the light of its measurement a whole pixel has the stated number; in faster light, the
    ratio of the collections.
    """
    given = {"quantum_efficiency": 0.5, "quantum_efficiency_includes": "microlens"}
    physics, plain = (
        derive(Pixel(**QUIET, **more, stack=STACKS["lens"]))
        for more in (given, {"quantum_efficiency": 0.5})
    )
    assert pixel_efficiency(physics, 550.0) == pytest.approx(0.5, rel=1e-12)
    share = collected_shares(plain.stack, disc_pupil(numerical_aperture(8.0)), [550.0]).sum()
    assert pixel_efficiency(plain, 550.0) == pytest.approx(0.5 * share, rel=1e-12)
    assert 0.9 < share < 0.99  # what counting twice would lose
    fast = derive(Pixel(**QUIET, **given, quantum_efficiency_f_number=2.0, stack=STACKS["lens"]))
    ratio = (
        collected_shares(plain.stack, disc_pupil(numerical_aperture(2.0)), [550.0]).sum() / share
    )
    assert pixel_efficiency(physics, 550.0) / pixel_efficiency(fast, 550.0) == pytest.approx(
        ratio, rel=1e-12
    )
    bare = derive(Pixel(**QUIET, **given, stack=STACKS["lens"] | {"microlens": "none"}))
    light = emva_illumination(np.array([550.0]), np.ones(1))
    assert collected_fraction(bare, light) < 0.4 * collected_fraction(
        physics, light
    )  # a fill factor of .28, where the lens has 1


def test_efficiency_was_measured_at_its_own_pitch() -> None:
    """The photodiode's efficiency is the same at every pitch: that of the measured pixel over what
    its own lens passes.

    So a pixel of the stated pitch has the stated number in the light of the measurement, and a
    smaller one less, by the ratio of what the lenses pass. A data sheet's pitch is
    data_sheet_pitch_um, a technology's its own, and the pixel's word goes first.
    """
    light, pupil = (
        emva_illumination(np.array([550.0]), np.ones(1)),
        disc_pupil(numerical_aperture(8.0)),
    )

    def passed(pitch_um: float) -> float:
        return float(
            collected_shares(
                Stack(pitch_um, pitch_um * math.sqrt(0.4), 4.0, 1.5), pupil, [550.0]
            ).sum()
        )

    measured = measured_at(3.0)
    lens = {"height_um": 4.0, "index": 1.5, "microlens": "square"}
    sheet = {
        "full_well_e": 1e4,
        "read_noise_e": 2.0,
        "dark_current_e_per_s": 1.0,
        "quantum_efficiency": 0.5,
        "stack": lens,
    }
    plain = {"fill_factor": 0.4, "infrared_cut_nm": 720.0}
    for pitch_um in (1.2, 3.0, 6.0):
        wanted = pytest.approx(passed(pitch_um) / passed(3.0), rel=1e-10)
        assert (
            collected_fraction(derive(Pixel(pitch_um=pitch_um, **plain), measured), light) == wanted
        )
        assert (
            collected_fraction(
                derive(Pixel(pitch_um=pitch_um, data_sheet_pitch_um=3.0, **plain, **sheet)), light
            )
            == wanted
        )
    own = Pixel(pitch_um=1.2, quantum_efficiency_pitch_um=6.0, **plain)
    assert collected_fraction(derive(own, measured), light) == pytest.approx(
        passed(1.2) / passed(6.0), rel=1e-10
    )
    assert collected_fraction(derive(Pixel(pitch_um=1.2, **plain), LENSED), light) == pytest.approx(
        1.0, rel=1e-10
    )
    assert passed(1.2) < 0.7 * passed(
        6.0
    )  # what would be missing: light that small lenses lose by diffraction
    layout = derive(Pixel(pitch_um=6.0), measured_at(6.5))  # a fill factor of its own
    assert layout.efficiency_stack is not None
    assert layout.efficiency_stack.fill_factor == pytest.approx(
        derive(Pixel(pitch_um=6.5)).fill_factor, rel=1e-12
    )
    with pytest.raises(
        PixsimError, match=r"quantum_efficiency_pitch_um: got 4; allowed: above 5\.13"
    ):
        collected_fraction(derive(Pixel(pitch_um=6.0), measured_at(4.0)), light)


def test_efficiency_beyond_the_stack_raises() -> None:
    sheet = {
        "full_well_e": 1e4,
        "read_noise_e": 2.0,
        "dark_current_e_per_s": 1.0,
        "fill_factor": 0.2,
        "bits": 12,
    }
    pixel = Pixel(pitch_um=2.0, quantum_efficiency=0.9, **sheet, stack=LENS)
    message = (
        r"quantum efficiency.*0\.9 at .*of 2 µm.*at most 0\.\d+.*f/8.*quantum_efficiency_pitch_um"
        r" or quantum_efficiency_f_number"
    )
    with pytest.raises(PixsimError, match=message):
        collected_fraction(derive(pixel), emva_illumination(NM, np.ones(NM.size)))
    on_photodiode = pixel.model_copy(update={"quantum_efficiency_includes": "photodiode"})
    assert collected_fraction(derive(on_photodiode), emva_illumination(NM, np.ones(NM.size))) < 0.9


EDGE_DEG, CELLS = 5.0, 6


def slanted_edge(pixel_um: float) -> SpectralImage:
    """An edge of 96 × 96 pixels whose cells are means across it."""
    side = 96 * CELLS
    y, x = np.indices((side, side)) + 0.5 - side / 2
    turn = math.radians(EDGE_DEG)
    part = np.clip(0.5 + (x * math.cos(turn) + y * math.sin(turn)), 0.0, 1.0)
    return SpectralImage(
        [550.0], 10.0, pixel_um / CELLS, data=1e-3 * (0.3 + 0.7 * part)[:, :, None]
    )


@pytest.mark.parametrize(
    ("pitch_um", "more"), [(2.0, {}), (4.0, {"crosstalk": 0.3}), (4.0, {"height_um": 7.0})]
)
def test_mtf_of_microlensed_pixels_is_sinc_times_transform_of_the_kernel(
    pitch_um: float, more: dict[str, Any]
) -> None:
    """By the e-SFR judge, ± .01: the aperture is the pitch, whatever the fill factor; a
    photodiode's would be far off.

    The judge's own error is .008. It is the same for bare pixels as wide as the pitch, so that the
    ratio shows the kernel alone.
    """
    pixel = Pixel(
        pitch_um=pitch_um, fill_factor=0.4, prnu=0.0, infrared_cut_nm=700.0, stack=LENS | more
    )
    camera, physics = (
        Camera(die_mm=96e-3 * pitch_um, focal_length_mm=50.0, object_distance_m=10.0, f_number=4.0),
        derive(pixel),
    )
    image = slanted_edge(pitch_um)
    edge = edge_response(mean_signal_rate(image, camera, physics))
    below = edge.frequency_cy_per_px <= 0.5
    frequency, turn = edge.frequency_cy_per_px[below], math.radians(EDGE_DEG)
    along, across = frequency * math.cos(turn), frequency * math.sin(turn)
    collection = collection_of(physics, illumination_of(image, camera, physics), (1, 1))
    assert collection is not None
    offsets = np.arange(-2.0, 3.0)
    wave = np.exp(
        -2j * np.pi * (along[:, None, None] * offsets + across[:, None, None] * offsets[:, None])
    )
    kernel = np.abs((collection.shares[0, 0] * wave).sum(axis=(1, 2))) / collection.on_axis
    lens = np.sinc(frequency / CELLS) * diffraction_otf(
        1e3 * frequency / pitch_um, 550.0, camera.effective_f_number
    )
    wanted = np.sinc(along) * np.sinc(across) * kernel * lens
    np.testing.assert_allclose(edge.sfr[below], wanted, atol=0.01)
    photodiode = np.sinc(along * math.sqrt(0.4)) * np.sinc(across * math.sqrt(0.4)) * lens
    assert np.abs(edge.sfr[below] - photodiode).max() > 0.06
    whole = Pixel(pitch_um=pitch_um, fill_factor=1.0, prnu=0.0, infrared_cut_nm=700.0)
    same = edge_response(mean_signal_rate(image, camera, derive(whole))).sfr[below]
    np.testing.assert_allclose(edge.sfr[below] / same, kernel, atol=2e-3)


def test_diffusion_of_bare_pixels_is_in_the_light() -> None:
    """A grating's contrast on the sensor falls by Seib's MTF at the wavelength's absorption."""
    side, order = 96, 30
    stack = STACKS["bare, diffusion"]

    def contrast(values: dict[str, Any]) -> Array:
        x = (np.arange(side) + 0.5) / side
        data = np.broadcast_to(
            1e-3 * (1 + 0.5 * np.cos(np.pi * order * x))[None, :, None], (side, side, 1)
        )
        image = SpectralImage([650.0], 10.0, 5.0, data=data, header={"diffraction": False})
        signal = mean_signal_rate(
            image,
            CAMERA,
            derive(
                Pixel(pitch_um=5.0, infrared_cut_nm=700.0, prnu=0.0, fill_factor=0.5, stack=values)
            ),
        )
        along = signal[signal.shape[0] // 2]
        return np.asarray(2 * (along / along.mean() * np.cos(np.pi * order * x)).mean())

    ratio = contrast(stack) / contrast(STACKS["bare"])
    wanted = diffusion_mtf(1e3 * order / (2 * 480.0), absorption_per_um(650.0), 1.0, 10.0)
    assert ratio == pytest.approx(float(wanted), abs=2e-4)
    assert wanted < 0.95


def test_published_crosstalk_is_what_four_neighbours_collect() -> None:
    with_it, without = (
        derive(Pixel(**QUIET, stack=STACKS[name])) for name in ("crosstalk", "optimal")
    )
    light = emva_illumination(NM, np.ones(NM.size))
    shares, plain = (collection_of(physics, light, (1, 1)) for physics in (with_it, without))
    assert shares is not None
    assert plain is not None
    centre = plain.shares[0, 0]
    wanted = 0.9 * centre[2, 2] + 0.025 * (
        centre[1, 2] + centre[3, 2] + centre[2, 1] + centre[2, 3]
    )
    assert shares.shares[0, 0, 2, 2] == pytest.approx(
        wanted, abs=1e-4
    )  # shares below 1e-5 are left to the pixel


def test_stack_merges_with_that_of_the_technology_field_by_field() -> None:
    base = derive(Pixel()).technology
    process = base.model_copy(
        update={
            "stack_height_um": 8.0,
            "stack_index": 1.5,
            "stack_microlens": "square",
            "stack_crosstalk": 0.2,
        }
    )
    assert (stack := derive(Pixel(), process).stack) is not None
    assert (stack.height_um, stack.microlens) == (8.0, True)
    physics = derive(
        Pixel(stack={"microlens": "none", "depletion_um": 1.0, "diffusion_length_um": 5.0}), process
    )
    assert physics.stack is not None
    assert physics.charge is not None
    assert (physics.stack.height_um, physics.stack.microlens, physics.charge.crosstalk) == (
        8.0,
        False,
        None,
    )
    assert derive(Pixel()).stack is None


# A process whose quantum efficiency was measured on whole pixels under microlenses, as those of 4T
# pixels are.
LENSED = load_technology("0.35um").model_copy(
    update={
        "stack_height_um": 4.0,
        "stack_index": 1.5,
        "stack_microlens": "square",
        "quantum_efficiency_includes": "microlens",
    }
)


def measured_at(pitch_um: float) -> Technology:
    return LENSED.model_copy(update={"quantum_efficiency_pitch_um": pitch_um})


def test_microlens_of_a_technology_is_switched_off_by_the_pixel() -> None:
    """The photodiode's efficiency is that of the whole pixel over what a microlens passes of light
    at f/8, for a bare pixel too.

    So a bare pixel has the bare share of even light over that, whatever its own shift, and loses
    light against the lens.
    """
    lens, bare = (
        derive(Pixel(**QUIET, stack=stack), LENSED)
        for stack in (None, {"microlens": "none", "shift_um": [0.1, 0.0]})
    )
    light = emva_illumination(np.array([550.0]), np.ones(1))
    assert bare.stack is not None
    pupil = disc_pupil(numerical_aperture(8.0))
    of_lens = collected_shares(lens.stack, pupil, [550.0]).sum()
    assert collected_fraction(lens, light) == pytest.approx(1.0, rel=1e-12)
    assert collected_fraction(bare, light) == pytest.approx(
        collected_shares(bare.stack, pupil).sum() / of_lens, rel=1e-12
    )
    assert bare.fill_factor * 0.9 < collected_fraction(bare, light) < bare.fill_factor / of_lens
    assert 0.9 < of_lens < 0.99


PINNED = {"4t-bsi": 1.4, "4t-fsi": 6.0}  # pitches of the sensors behind the packaged 4T processes


@pytest.mark.parametrize(("name", "pitch_um"), PINNED.items())
def test_packaged_stacks_pass_the_stated_efficiency(name: str, pitch_um: float) -> None:
    """A whole pixel of the sensor behind the file has the stated efficiency at f/8; so it must have
    at all ends of all ranges.

    The photodiode's is larger by what the lens loses, which is little there: 0.9 to 1 as makers
    state it for lenses over fill factors of 0.3 and more.
    """
    technology = load_technology(name)
    pixel = Pixel(technology=name, pitch_um=pitch_um)
    assert technology.quantum_efficiency_pitch_um == pitch_um
    for nm in (450.0, 550.0, 650.0):
        stated = float(derive(pixel).quantum_efficiency(nm))
        assert pixel_efficiency(derive(pixel), nm) == pytest.approx(stated, rel=1e-10)
        assert stated < stated / passed_by_lens(derive(pixel), nm) < stated / 0.9
    numbers = (
        "peak_quantum_efficiency",
        "stack_height_um",
        "stack_index",
        "fill_factor_limit",
        "fill_factor_zero_pitch_features",
    )
    for ends in product(*(technology.ranges[number] for number in numbers)):
        check_efficiency(
            derive(pixel, technology.with_numbers(dict(zip(numbers, ends, strict=True)), "ends"))
        )


def passed_by_lens(physics: PixelPhysics, nm: float) -> float:
    """Share of even light at f/8 that a pixel's own stack passes to photodiodes."""
    assert physics.stack is not None
    return float(collected_shares(physics.stack, disc_pupil(numerical_aperture(8.0)), [nm]).sum())


@pytest.mark.parametrize("name", PINNED)
def test_packaged_stacks_lose_light_as_published_pixels_do(name: str) -> None:
    """Effective fill factors at f/2.8: lenses make 90 % or more of 30 to 60 % (data sheets); bare
    pixels keep below it.

    On the way to the wavelength lenses no longer help.
    """
    light = Illumination((550.0,), (1.0,), CameraPupil(2.8, math.inf))

    def effective(pitch_um: float, microlens: str) -> float:
        given = {"quantum_efficiency_includes": "photodiode", "stack": {"microlens": microlens}}
        return collected_fraction(derive(Pixel(technology=name, pitch_um=pitch_um, **given)), light)

    for pitch_um in (3.0, 6.0):
        fill_factor = derive(Pixel(technology=name, pitch_um=pitch_um)).fill_factor
        assert 0.9 < effective(pitch_um, "square") < 1.0
        assert 0.7 * fill_factor < effective(pitch_um, "none") < fill_factor
    small_um = smallest_pitch_um(load_technology(name)) * 1.4
    assert effective(small_um, "square") < 0.8


@pytest.mark.parametrize("name", PINNED)
def test_microlens_of_a_technology_is_as_high_as_it_must_be(name: str) -> None:
    """Its height is that of small pixels; the lens of a wide one lies at p/√π, its lowest place. A
    pixel's own height is kept.
    """
    technology = load_technology(name)
    height_um = technology.numbers["stack_height_um"]
    widest_um = height_um * math.sqrt(math.pi)

    def stack(pitch_um: float, **given: Any) -> Stack:
        found = derive(Pixel(technology=name, pitch_um=pitch_um, stack=given)).stack
        assert found is not None
        return found

    assert stack(0.99 * widest_um).height_um == height_um
    assert stack(15.0).height_um == pytest.approx(15.0 / math.sqrt(math.pi), rel=1e-12)
    assert stack(15.0, microlens="none").height_um == height_um
    assert stack(15.0, height_um=9.0).height_um == 9.0
    measured = [
        derive(Pixel(technology=name, pitch_um=pitch_um)).efficiency_stack
        for pitch_um in (1.7, 15.0)
    ]
    assert measured[0] == measured[1], "the sensor behind the file is the same one"
    with pytest.raises(
        PixsimError, match=r"pixel\.stack\.height_um: got 4; allowed: at least p/√π = 8\.46"
    ):
        stack(15.0, height_um=4.0)
    study = Study(name="x", technologies=[name])
    assert study_pitches_um(study, name).max() == study.pitch.max_um == 15.0


def test_bare_pixel_may_be_wider_than_a_microlens() -> None:
    """The light of a measurement at f/8 passes the lowest ideal lens but for 1 to 2 %, so there is
    no step at its pitch.
    """
    bare = {"microlens": "none"}
    widths = 7.08, 7.1, 12.0  # an ideal lens at 4 µm may be 7.09 µm wide
    light = emva_illumination(np.array([550.0]), np.ones(1))
    pixels = [
        derive(Pixel(pitch_um=um, fill_factor=0.4, infrared_cut_nm=720.0, stack=bare), LENSED)
        for um in widths
    ]
    plain = [replace(pixel, technology=load_technology("0.35um")) for pixel in pixels]
    passed = [
        collected_fraction(one, light) / collected_fraction(other, light)
        for one, other in zip(plain, pixels, strict=True)
    ]
    assert passed[0] == pytest.approx(passed[1], rel=1e-3)
    assert passed[1] < passed[2]
    assert all(0.98 < part < 1 for part in passed)


def test_stack_of_a_technology_is_switched_off_by_the_pixel() -> None:
    """Bit for bit as the same technology without a stack, from Python, a file's table and a study's
    axis.
    """
    image, plain = detailed_picture(), load_technology("0.35um")
    off = derive(Pixel(**QUIET, stack={"enabled": False, "microlens": "square"}), LENSED)
    assert off.stack is off.charge is off.efficiency_f_number is None
    wanted = mean_signal_rate(image, CAMERA, derive(Pixel(**QUIET), plain))
    np.testing.assert_array_equal(mean_signal_rate(image, CAMERA, off), wanted)
    assert derive(Pixel(**QUIET, stack={"enabled": True}), LENSED) != off
    values = [
        {"label": "microlens", "set": {"pixel": {"stack": {"microlens": "square"}}}},
        {"label": "bare", "set": {"pixel": {"stack": {"microlens": "none"}}}},
        {"label": "no stack", "set": {"pixel": {"stack": {"enabled": False}}}},
    ]
    study = Study(name="x", axis=[{"name": "aperture", "values": values}])
    found = [physics_of(case.settings, "0.35um", 6.0, LENSED).stack for case in cases_of(study)]
    assert [stack.microlens if stack else None for stack in found] == [True, False, None]


def test_later_layers_restate_a_stack_in_another_word() -> None:
    base = {
        "pixel": {
            "stack": {
                "height_um": 4.0,
                "shift": "optimal",
                "depletion_um": 1.0,
                "diffusion_length_um": 9.0,
            }
        }
    }
    over = {"pixel": {"stack": {"shift_um": [0.1, 0.0], "crosstalk": 0.1}}}
    assert merge(base, over)["pixel"]["stack"] == {
        "height_um": 4.0,
        "shift_um": [0.1, 0.0],
        "crosstalk": 0.1,
    }
    assert merge(over, base)["pixel"]["stack"] == base["pixel"]["stack"]
    both = {"pixel": {"stack": {"shift": "none", "shift_um": [0.1, 0.0]}}}
    assert merge(base, both)["pixel"]["stack"].keys() >= {
        "shift",
        "shift_um",
    }  # one layer that states both is refused


@pytest.mark.parametrize(
    ("stack", "message"),
    [
        ({"microlens": "square"}, r"no height_um and no index.*\[pixel\.stack\]"),
        ({"height_um": 4.0, "index": 1.5, "depletion_um": 1.0}, "depletion_um alone"),
        (
            {"height_um": 3.0, "index": 1.5, "microlens": "square"},
            r"^pixel\.stack\.height_um: got 3; allowed: at least p/√π = 3.38",
        ),
        (
            {"height_um": 4.0, "index": 1.5, "shift_um": [4.0, 0.0]},
            r"^pixel\.stack\.shift_um: .*at most half of pitch_um = 6",
        ),
    ],
)
def test_impossible_stacks_raise(stack: dict[str, Any], message: str) -> None:
    with pytest.raises(PixsimError, match=message):
        derive(Pixel(**QUIET, stack=stack))


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"height_um": 0.0}, "height_um.*greater than or equal to 0.001"),
        ({"index": 0.9}, "index.*greater than or equal to 1"),
        ({"shift": "none", "shift_um": [0, 0]}, "shift and shift_um state the same quantity"),
        (
            {"crosstalk": 0.1, "depletion_um": 1.0},
            "crosstalk and depletion_um state the same quantity",
        ),
        ({"microlens": "round"}, "microlens.*'none' or 'square'"),
    ],
)
def test_stack_options_out_of_range_raise(fields: dict[str, Any], message: str) -> None:
    with pytest.raises(PixsimError, match=message):
        StackOptions(**fields)


def test_study_has_no_pitches_without_a_microlens() -> None:
    """√π times 4 µm: a range ends there, given pitches beyond are refused, and so is a range that
    begins there.
    """
    ends = study_pitches_um(Study(name="x", pixel={"stack": LENS}, pitch={"max_um": 9.0}), "0.35um")
    assert (ends.max(), ends.size) == (7.0898, 24)
    possible = study_pitches_um(
        Study(name="x", pixel={"stack": LENS}, pitch={"max_um": 7.0}), "0.35um"
    )
    assert possible.max() == 7.0
    bare = Study(name="x", pixel={"stack": LENS | {"microlens": "none"}}, pitch={"max_um": 9.0})
    assert study_pitches_um(bare, "0.35um").max() == 9.0
    given = Study(name="x", pixel={"stack": LENS}, pitch={"values_um": [6.0, 6.5, 7.0, 8.0, 9.0]})
    with pytest.raises(
        PixsimError,
        match=r"values_um: got pixels up to 9 µm under microlenses; allowed: at most 7\.0898 µm",
    ):
        study_pitches_um(given, "0.35um")
    for pitch, source in (
        ({"min_um": 8.0}, "8 µm, pitch.min_um"),
        ({"min_fill_factor": 0.5}, "8.173 µm, where 0.35um has"),
    ):
        with pytest.raises(
            PixsimError,
            match=rf"pitch: got sizes from {source}.*below 7\.0898 µm.*microlens = 'none'",
        ):
            study_pitches_um(Study(name="x", pixel={"stack": LENS}, pitch=pitch), "0.35um")


def test_doubtful_model_warns_with_numbers() -> None:
    pixel = Pixel(pitch_um=2.0, fill_factor=0.4, infrared_cut_nm=700.0, stack=LENS)
    with pytest.warns(
        UserWarning,
        match=r"pixel\.stack at 2 µm: the microlens has a Fresnel number of 0\.5\d at 700 nm",
    ):
        chain(pixel)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        chain(Pixel(**QUIET, stack=LENS), display={})


def test_corner_collects_less_without_a_shift() -> None:
    camera = WIDE
    axis, corner = stack_shares(derive(Pixel(**QUIET, stack=LENS)), camera, 550.0)
    _, optimal = stack_shares(derive(Pixel(**QUIET, stack=STACKS["optimal"])), camera, 550.0)
    assert corner < 0.8 * axis
    assert optimal == pytest.approx(axis, abs=0.02)
