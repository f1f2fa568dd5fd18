"""The stack in the imaging chain, crosstalk and diffusion of charge: conservation, limits, shading,
and efficiencies of whole pixels.
"""

import math
from itertools import product

import numpy as np
import pytest
from helpers.chains import imaging_chain
from helpers.claims import Claim, check
from hypothesis import given, settings, strategies as st
from scipy.integrate import quad
from scipy.signal import convolve

from pixsim import Camera, Correction, Display, Exposure, Pixel, SpectralImage
from pixsim.measure.experiment import pixel_efficiency
from pixsim.optics.camera_light import CameraPupil, camera_pupil
from pixsim.optics.pupil import disc_pupil, numerical_aperture
from pixsim.optics.stack import Stack, collected_shares
from pixsim.sensor.collection import (
    ColourCollection,
    Illumination,
    _charge_shares,
    bin_pixels,
    check_efficiency,
    collected_fraction,
    collected_signal,
    collection_of,
    collections_of,
    emva_illumination,
    half_sizes_um,
    kernel_on_axis,
    min_fresnel_number,
    scale_error,
    shading_of,
    stack_shares,
)
from pixsim.sensor.colour import Layout
from pixsim.sensor.crosstalk import share_with_neighbours, shares_sum
from pixsim.sensor.diffusion import absorption_per_um, diffused_shares, diffusion_mtf, spread_shares
from pixsim.sensor.integration import (
    collecting_area_um2,
    electrons_per_joule,
    illumination_of,
    mean_signal_rate,
    pixels_on,
)
from pixsim.sensor.pixel import PixelPhysics, derive, largest_pitch_um
from pixsim.sensor.technology import Technology, load_technology
from pixsim.viewer.chain import ImagingChain

CAMERA = Camera(die_mm=0.48, f_number=2.0)
WIDE = Camera(die_mm=0.48, focal_length_mm=0.4, f_number=2.0)  # 40° in the corners
SLOW = Camera(die_mm=0.48, f_number=16.0)
OBLONG = Camera(die_mm=0.4, die_height_mm=0.3, focal_length_mm=0.4, f_number=2.0)
NM = np.arange(420.0, 701.0, 20.0)
BARE = {"height_um": 4.0, "index": 1.5}
LENS = BARE | {"microlens": "square"}
DIFFUSION = {"depletion_um": 1.0, "diffusion_length_um": 10.0}
STACKS: dict[str, dict] = {
    "bare": BARE,
    "lens": LENS,
    "optimal": LENS | {"shift": "optimal"},
    "fixed shift": LENS | {"shift_um": [0.4, -0.2]},
    "crosstalk": LENS | {"shift": "optimal", "crosstalk": 0.1},
    "diffusion": LENS | {"shift": "optimal"} | DIFFUSION,
    "bare, diffusion": BARE | DIFFUSION,
    "bare, crosstalk": BARE | {"crosstalk": 0.1},
}
QUIET = {"pitch_um": 6.0, "infrared_cut_nm": 720.0, "prnu": 0.0}
# A process whose quantum efficiency was measured on whole pixels under microlenses.
LENSED = load_technology("0.35um").model_copy(
    update={
        "stack_height_um": 4.0,
        "stack_index": 1.5,
        "stack_microlens": "square",
        "quantum_efficiency_includes": "microlens",
    }
)
EMVA = emva_illumination(np.array([550.0]), np.ones(1))


def physics(technology: Technology | None = None, **over) -> PixelPhysics:
    return derive(Pixel(**QUIET | over), technology)


def picture(values, side: int = 96) -> SpectralImage:
    data = 1e-3 * np.broadcast_to(values, (side, side, NM.size))
    return SpectralImage(NM, 20.0, 480 / side, data=data, header={"diffraction": False})


UNIFORM = picture(1.0)
DETAIL = picture(np.random.default_rng(5).uniform(0.2, 1.0, (96, 96, NM.size)))


def chain(
    pixel: PixelPhysics,
    camera: Camera = CAMERA,
    image: SpectralImage = UNIFORM,
    *,
    is_corrected: bool = True,
    **settings,
) -> ImagingChain:
    display = Display(white_cd_per_m2=1e4, raster="one_to_one", shading_correction=is_corrected)
    return imaging_chain(image, camera, pixel.pixel, Exposure(), display, **settings)


@pytest.mark.filterwarnings("ignore::UserWarning")
@pytest.mark.parametrize("name", STACKS)
def test_flat_field_is_conserved(name: str) -> None:
    """Uniform light times the collection; with the display's correction it is uniform again, and on
    axis it is display white's.
    """
    imaged = chain(physics(stack=STACKS[name]), WIDE)
    flat = imaged.signal_e_per_s / imaged.development.flat_field
    np.testing.assert_allclose(flat, flat.mean(), rtol=1e-12)
    assert np.ptp(imaged.development.flat_field) > (1e-2 if "shift" not in STACKS[name] else 1e-6)
    plain = chain(physics(), WIDE)
    white = plain.white_e_per_s / plain.signal_e_per_s.mean()
    assert imaged.white_e_per_s / flat.mean() == pytest.approx(white, rel=1e-11)


# Chief ray angles of a phone's lens, which fall again towards the corner.
PHONE = [
    (0.034 * row, angle_deg)
    for row, angle_deg in enumerate((0, 4.7, 9.5, 14.2, 18.7, 22.9, 26.6, 29.6, 31.8, 32.9, 32.6))
]


@pytest.mark.parametrize(
    ("name", "table", "tolerance"),
    [
        ("bare", None, 1e-3),
        ("lens", None, 1e-3),
        ("fixed shift", None, 1e-3),
        ("lens", PHONE, 2e-3),
        ("optimal", PHONE, 2e-3),
    ],
)
def test_shares_between_points_agree_with_the_kernel(name: str, table, tolerance: float) -> None:
    """All bands and a direct pupil at places between the nodes: polynomials over the field and the
    spectrum, and linear steps.
    """
    pixel = physics(stack=STACKS[name])
    camera = Camera(die_mm=0.48, focal_length_mm=0.8, f_number=2.0, chief_ray_angle=table)
    light = illumination_of(UNIFORM, camera, pixel)
    collection = collection_of(pixel, light, (81, 81))
    total = collection.relative((81, 81)) * collection.on_axis
    weight = np.array(light.weight) / np.sum(light.weight)
    for row, column in ((40, 40), (3, 77), (22, 51), (80, 80)):
        pupil = camera_pupil(camera).at(6.0 * (column - 40), 6.0 * (row - 40))
        expected = weight @ collected_shares(pixel.stack, pupil, NM).sum(axis=(-2, -1))
        check(f"{row}, {column}", total[row, column], expected, atol=tolerance, why="polynomials")


# Nothing is lost but on the way: a slow lens whose chief rays land on the centres, and a wide pixel
# under its microlens.
@pytest.mark.filterwarnings("ignore:100 % of the ideal image")
@pytest.mark.parametrize(
    ("fields", "tolerance"),
    [
        ({"stack": BARE | {"shift": "optimal"}}, 1e-3),
        (
            {
                "stack": LENS | {"height_um": 8.5, "shift": "optimal"},
                "pitch_um": 15.0,
                "fill_factor": 0.7,
            },
            1e-2,
        ),
    ],
)
def test_stack_that_loses_nothing_is_left_out_within_its_bound(
    fields: dict, tolerance: float
) -> None:
    """The error of the mean electrons, over those of the brightest pixel, is at most the bound;
    without tolerance there is none.
    """
    pixel = physics(**fields)
    half_um = half_sizes_um(pixel, pixels_on(SLOW.die_um, pixel.pitch_um))
    bound = scale_error(pixel, camera_pupil(SLOW), half_um, tolerance)
    assert 1e-6 < bound <= tolerance
    assert scale_error(pixel, camera_pupil(SLOW), (200.0, 200.0), bound / 2) is None
    image = SpectralImage(
        NM, 20.0, 5.0, data=DETAIL.data, header={"diffraction": False, "spare_e": tolerance}
    )
    scaled = chain(pixel, SLOW, image)
    whole = chain(pixel, SLOW, image, without_shortcuts=True)
    assert scaled.collection.is_scale
    assert scaled.development.shading is None
    assert scaled.white_e_per_s == pytest.approx(whole.white_e_per_s, rel=1e-12)
    error = np.abs(scaled.signal_e_per_s - whole.signal_e_per_s).max() / whole.signal_e_per_s.max()
    assert bound / 100 < error <= bound
    for stated in (-1.0, 2.0, "1e-2", True):  # files may state anything
        image.header["spare_e"] = stated
        np.testing.assert_array_equal(
            chain(pixel, SLOW, image).signal_e_per_s, whole.signal_e_per_s
        )


def passed(pitch_um: float, f_number: float = 8.0, fill_factor: float = 0.4) -> float:
    """Share of uniform light that the microlens of a pixel passes to its photodiode."""
    stack = Stack(pitch_um, pitch_um * math.sqrt(fill_factor), 4.0, 1.5)
    return float(collected_shares(stack, disc_pupil(numerical_aperture(f_number)), [550.0]).sum())


def of_lens(pixel: PixelPhysics) -> float:
    return float(collected_shares(pixel.stack, disc_pupil(numerical_aperture(8.0)), [550.0]).sum())


def measured(pitch_um: float, at_um: float | None = None, **over) -> float:
    """Collected fraction of a pixel of the process, whose efficiency was measured at a pitch."""
    process = LENSED.model_copy(update={"quantum_efficiency_pitch_um": at_um})
    return collected_fraction(physics(process, pitch_um=pitch_um, fill_factor=0.4, **over), EMVA)


PINNED = {"4t-bsi": 1.4, "4t-fsi": 6.0}  # pitches of the sensors behind the packaged 4T processes


def fill_factor(name: str, pitch_um: float) -> float:
    return derive(Pixel(technology=name, pitch_um=pitch_um)).fill_factor


def effective_fill_factor(name: str, pitch_um: float, microlens: str) -> float:
    options = {"quantum_efficiency_includes": "photodiode", "stack": {"microlens": microlens}}
    light = Illumination((550.0,), (1.0,), CameraPupil(2.8, math.inf))
    return collected_fraction(derive(Pixel(technology=name, pitch_um=pitch_um, **options)), light)


MANY_NM = Illumination(
    tuple(np.linspace(400, 1000, 300)),
    tuple(np.random.default_rng(1).uniform(0, 1, 300)),
    CameraPupil(2.0, 1e3),
)
POWERS = np.arange(4)[:, None]
WHOLE = {"quantum_efficiency": 0.5, "quantum_efficiency_includes": "microlens", "stack": LENS}
SHEET = {
    "full_well_e": 1e4,
    "read_noise_e": 2.0,
    "dark_current_e_per_s": 1.0,
    "quantum_efficiency": 0.5,
    "fill_factor": 0.4,
    "stack": LENS,
}
PLAIN = physics(**WHOLE | {"quantum_efficiency_includes": "photodiode"})
BARE_LENSED = physics(LENSED, stack={"microlens": "none", "shift_um": [0.1, 0.0]})
DIFFUSING = physics(stack=STACKS["diffusion"])
F2_RAYS = disc_pupil(numerical_aperture(2.0)).directions(3, 8)
CROSSTALK = kernel_on_axis(physics(stack=STACKS["optimal"]), EMVA)
# k of silicon at 295 K by C. Schinke et al., AIP Advances 5 (2015) 067168, as in
# refractiveindex.info (CC0); 11 % at 600 nm.
SCHINKE_K = {
    450: 0.095362,
    500: 0.048542,
    550: 0.028038,
    600: 0.018521,
    650: 0.014447,
    700: 0.010623,
    750: 0.0076156,
}
SCHINKE_NM = np.array(list(SCHINKE_K))
OVER_SCHINKE = (
    absorption_per_um(SCHINKE_NM)
    * SCHINKE_NM
    / (4e3 * math.pi * np.array(list(SCHINKE_K.values())))
)
COLOURED = diffused_shares(2.2, 1.3, np.array([2.4, 0.64, 0.19]), 1.0, 20.0)
EFFICIENCIES = [
    Claim(
        "absorption over another measurement",
        lambda: OVER_SCHINKE,
        np.ones(7),
        atol=0.11,
        why="its error at 600 nm",
    ),
    Claim(
        "and its mean",
        lambda: OVER_SCHINKE.mean(),
        1.0,
        atol=0.04,
        why="not one scale that is wrong",
    ),
    Claim(
        "no wavelength of 370-1200 nm is absorbed more than a shorter one",
        lambda: np.diff(absorption_per_um(np.arange(370.0, 1201.0))).max(initial=0.0),
        0.0,
    ),
    Claim("diffused charge, mirrored", lambda: COLOURED[:, ::-1, ::-1], COLOURED, atol=1e-15),
    Claim("and turned", lambda: np.swapaxes(COLOURED, 1, 2), COLOURED, atol=1e-15),
    Claim(
        "it spreads more the deeper light goes, into all pixels",
        lambda: [np.argsort(-COLOURED[:, 2, 2]), np.sum(COLOURED > 0, axis=(1, 2))],
        [[0, 1, 2], [25, 25, 25]],
    ),
    Claim(
        "a whole pixel has its stated efficiency in the light of the measurement",
        lambda: pixel_efficiency(physics(**WHOLE), 550.0),
        0.5,
        rtol=1e-12,
    ),
    Claim(
        "a photodiode what its lens passes of it",
        lambda: pixel_efficiency(PLAIN, 550.0),
        0.5 * of_lens(PLAIN),
        rtol=1e-12,
    ),
    Claim(
        "measured in faster light, the ratio of what the lens passes",
        lambda: (
            pixel_efficiency(physics(**WHOLE), 550.0)
            / pixel_efficiency(physics(**WHOLE, quantum_efficiency_f_number=2.0), 550.0)
        ),
        passed(6.0, 2.0, PLAIN.fill_factor) / passed(6.0, 8.0, PLAIN.fill_factor),
        rtol=1e-12,
    ),
    *(
        Claim(
            f"of {pitch_um:g} µm, measured at 3 µm",
            lambda pitch_um=pitch_um: [
                measured(pitch_um, 3.0),
                collected_fraction(
                    derive(Pixel(pitch_um=pitch_um, data_sheet_pitch_um=3.0, **SHEET)), EMVA
                ),
            ],
            [passed(pitch_um) / passed(3.0)] * 2,
            rtol=1e-10,
        )
        for pitch_um in (1.2, 3.0, 6.0)
    ),
    Claim(
        "the pixel's word goes first",
        lambda: measured(1.2, 3.0, quantum_efficiency_pitch_um=6.0),
        passed(1.2) / passed(6.0),
        rtol=1e-10,
    ),
    Claim("without one it is of each pixel", lambda: measured(1.2), 1.0, rtol=1e-10),
    Claim(
        "a bare pixel: its share over what a lens passes, whatever its shift",
        lambda: collected_fraction(BARE_LENSED, EMVA),
        of_lens(BARE_LENSED) / of_lens(physics(LENSED)),
        rtol=1e-12,
    ),
    Claim(
        "a bare pixel wider than an ideal lens at its height, 7.09 µm: no step",
        lambda: measured(7.08, stack={"microlens": "none"}),
        measured(7.1, stack={"microlens": "none"}),
        rtol=2e-3,
        why="the fill factor's share of light",
    ),
    Claim(
        "the area of a collected fraction",
        lambda: collecting_area_um2(UNIFORM, CAMERA, physics(stack=LENS)),
        collected_fraction(
            physics(stack=LENS), illumination_of(UNIFORM, CAMERA, physics(stack=LENS))
        )
        * 36.0,
        rtol=1e-12,
    ),
    Claim(
        "published crosstalk is what four neighbours collect together",
        lambda: kernel_on_axis(physics(stack=STACKS["crosstalk"]), EMVA)[2, 2],
        0.9 * CROSSTALK[2, 2] + 0.025 * (CROSSTALK[[1, 3, 2, 2], [2, 2, 1, 3]]).sum(),
        atol=1e-4,
        why="shares below 1e-5 are left to the pixel",
    ),
    Claim(
        "charge under a lens starts in a square with the variance of its spot, a disc of h sin α/n",
        lambda: _charge_shares(
            DIFFUSING.stack, DIFFUSING.charge, numerical_aperture(2.0), np.array([850.0])
        ),
        diffused_shares(
            6.0,
            math.sqrt(12 * (4.0 / 1.5) ** 2 * (F2_RAYS.cosines[:, 0] ** 2 @ F2_RAYS.shares)),
            absorption_per_um([850.0], DIFFUSING.charge.silicon_k),
            1.0,
            10.0,
        ),
        atol=1e-9,
    ),
    Claim(
        "shares on axis and in the corner under an optimal shift",
        lambda: stack_shares(physics(stack=STACKS["optimal"]), WIDE, 550.0),
        [stack_shares(physics(stack=LENS), WIDE, 550.0)[0]] * 2,
        atol=0.02,
        why="the oblique pupil",
    ),
    Claim(
        "share in the corner of half the die",
        lambda: stack_shares(physics(stack=LENS), OBLONG, 550.0)[1],
        collected_shares(
            physics(stack=LENS).stack, camera_pupil(OBLONG).at([200.0], [150.0]), [550.0]
        )[0, 0, 2, 2],
        rtol=1e-8,
    ),
    Claim(
        "a black picture counts as one of equal light in all bands",
        lambda: illumination_of(picture(0.0), CAMERA, PLAIN).weight,
        electrons_per_joule(PLAIN, UNIFORM),
        rtol=1e-12,
    ),
    Claim(
        "without a stack a pixel collects on its photodiode",
        lambda: collecting_area_um2(UNIFORM, CAMERA, physics()),
        physics().photodiode_area_um2,
    ),
    Claim("no stack loses nothing", lambda: stack_shares(physics(), WIDE, 550.0), [1.0, 1.0]),
    Claim(
        "Fresnel number n (p/2)²/(λ h) at the longest wavelength that is seen",
        lambda: min_fresnel_number(physics(stack=LENS), np.array([500.0, 700.0, 900.0])),
        1.5 * 9.0 / (0.7 * 4.0),
        rtol=1e-12,
    ),
    Claim(
        "the widest pixel under a lens of 4 µm",
        lambda: [
            largest_pitch_um(Pixel(**QUIET, stack=stack), LENSED)
            for stack in (LENS, LENS | {"microlens": "none"})
        ],
        [4 * math.sqrt(math.pi), math.inf],
        rtol=1e-12,
    ),
    Claim(
        "a low opening is a bare photodiode, from every direction",
        lambda: mean_signal_rate(DETAIL, CAMERA, physics(stack={"height_um": 1e-3, "index": 1.5})),
        mean_signal_rate(DETAIL, CAMERA, physics()),
        rtol=1e-3,
        why="h NA/n w = 5e-5 on each side",
    ),
    *(
        Claim(
            f"height of the lens of {name}, of {pitch_um:g} µm with {stack}",
            lambda name=name, pitch_um=pitch_um, stack=stack: (
                derive(Pixel(technology=name, pitch_um=pitch_um, stack=stack)).stack.height_um
            ),
            height_um,
            rtol=1e-12,
        )
        for name, height_of_file_um in (("4t-bsi", 2.4), ("4t-fsi", 4.9))
        for pitch_um, stack, height_um in (
            (3.0, {}, height_of_file_um),
            (15.0, {}, 15.0 / math.sqrt(math.pi)),
            (15.0, {"microlens": "none"}, height_of_file_um),
            (15.0, {"height_um": 9.0}, 9.0),
        )
    ),
    # Effective fill factors at f/2.8: lenses make 90 % or more of 30 to 60 %, as data sheets have it;
    # bare pixels stay below their fill factor.
    *(
        Claim(
            f"{name} at {pitch_um:g} µm and f/2.8 with microlens '{microlens}'",
            lambda name=name, pitch_um=pitch_um, microlens=microlens: effective_fill_factor(
                name, pitch_um, microlens
            ),
            expected,
            atol=tolerance,
            why="what published pixels have",
        )
        for name in PINNED
        for pitch_um in (3.0, 6.0)
        for microlens, expected, tolerance in (
            ("square", 0.95, 0.05),
            ("none", 0.85 * fill_factor(name, pitch_um), 0.15 * fill_factor(name, pitch_um)),
        )
    ),
    Claim(
        "moments of many wavelengths, exact for a cubic",
        lambda: MANY_NM.nodes(4)[0] ** POWERS @ MANY_NM.nodes(4)[1],
        np.array(MANY_NM.wavelength_nm) ** POWERS
        @ np.array(MANY_NM.weight)
        / np.sum(MANY_NM.weight),
        rtol=1e-12,
    ),
    Claim(
        "few wavelengths stand for themselves, those without light left out",
        lambda: Illumination((500.0, 600.0, 700.0), (1.0, 0.0, 3.0), CameraPupil(2.0, 1e3)).nodes(
            4
        ),
        [[500.0, 700.0], [0.25, 0.75]],
    ),
]


WAVE = np.cos(np.pi * 30 * (np.arange(96) + 0.5) / 96)  # of 32 µm on the die of 480 µm
GRATING = SpectralImage(
    [650.0],
    10.0,
    5.0,
    data=1e-3 * np.broadcast_to((1 + 0.5 * WAVE)[None, :, None], (96, 96, 1)),
    header={"diffraction": False},
)
HALF = {"pitch_um": 5.0, "fill_factor": 0.5}


def contrast(**over) -> float:
    line = mean_signal_rate(GRATING, SLOW, physics(**over))[48]
    return float(2 * (line / line.mean() * WAVE).mean())


def kernel_transform(stack: dict) -> float:
    """Of the shares of a pixel at the frequency of the grating."""
    pixel = physics(**HALF, stack=stack)
    kernel = kernel_on_axis(pixel, illumination_of(GRATING, SLOW, pixel))
    return float(kernel.sum(axis=0) @ np.cos(np.pi * 30 / 96 * np.arange(-2, 3)) / kernel.sum())


CONTRASTS = [
    Claim(
        "diffusion of bare pixels is Seib's MTF in the light",
        lambda: contrast(**HALF, stack=STACKS["bare, diffusion"]) / contrast(**HALF, stack=BARE),
        float(diffusion_mtf(1e3 * 30 / 960, absorption_per_um(650.0), 1.0, 10.0)),
        atol=2e-4,
        why="the grating's phase in the last pixels",
    ),
    *(
        Claim(
            f"under a lens the aperture is the pitch, times the transform of the kernel, {name}",
            lambda stack=stack: (
                contrast(**HALF, stack=stack) / contrast(pitch_um=5.0, fill_factor=1.0)
            ),
            kernel_transform(stack),
            atol=2e-3,
            why="shares that vary over the field",
        )
        for name, stack in (("plain", LENS), ("crosstalk", LENS | {"crosstalk": 0.3}))
    ),
]


@pytest.mark.parametrize(
    "cell",
    [
        {"pattern": "rggb"},
        {"pattern": "stacked"},
        {"pattern": "quad_rggb", "binning": True},
        {"matrix": ["RGB", "GBR"]},
    ],
    ids=lambda cell: str(next(iter(cell.values()))),
)
def test_white_of_a_colour_sensor_is_what_its_channels_collect_of_uniform_light(cell: dict) -> None:
    """A channel's mean on axis is its mixing matrix times the light of each channel; without a
    stack's crosstalk that matrix is diagonal.
    """
    colour = cell | {"sensitivities": "Canon_EOS_R5", "peak_quantum_efficiency": 0.5}
    pixel = derive(Pixel(technology="4t-bsi", pitch_um=3.0, colour=colour))
    layout = Layout.unbinned(pixel.pixel)
    lights = [illumination_of(UNIFORM, SLOW, channel) for channel in pixel.channels]
    collections = collections_of(pixel, lights, (32, 36))
    bin_side = pixel.pixel.bin_side
    white = ColourCollection(layout, collections, (1.0, 2.0, 4.0), pixel.pitch_um, bin_side)
    mixing_um2 = white.mixing_um2
    # All light on the pixels of a value of the frame is collected by some pixel.
    expected = 9.0 * bin_side**2 * np.array([c.on_axis for c in collections])
    shares = np.ones(3) if layout.is_stacked else layout.shares
    np.testing.assert_allclose(shares @ mixing_um2, shares * expected, rtol=1e-4)
    np.testing.assert_allclose(white.white_e_per_s, mixing_um2 @ [1.0, 2.0, 4.0], rtol=1e-12)
    relative = white.relative((8 * layout.planes, 12))
    assert relative[4 * layout.planes, 6] == pytest.approx(1.0, abs=0.02)
    np.testing.assert_array_equal(shading_of(white, relative.shape, Correction()), relative)
    assert shading_of(white, relative.shape, Correction(flat_frames=1)) is None


def test_stack_of_a_pixel_goes_before_that_of_the_technology() -> None:
    """Field by field, and switched off as a whole: bit for bit as without one."""
    process = LENSED.model_copy(update={"stack_crosstalk": 0.2})
    bare = physics(process, stack={"microlens": "none"} | DIFFUSION)
    assert (bare.stack.height_um, bare.stack.microlens) == (4.0, False)
    assert (bare.charge.crosstalk, bare.charge.diffusion_um) == (None, (1.0, 10.0))
    off = physics(LENSED, stack={"enabled": False, "microlens": "square"})
    assert off.stack is off.charge is off.efficiency_f_number is None
    np.testing.assert_array_equal(
        mean_signal_rate(DETAIL, CAMERA, off),
        mean_signal_rate(DETAIL, CAMERA, physics(load_technology("0.35um"))),
    )


@pytest.mark.parametrize(("name", "pitch_um"), PINNED.items())
def test_packaged_stacks_pass_the_stated_efficiency(name: str, pitch_um: float) -> None:
    """A whole pixel of the sensor behind the file has the stated efficiency at f/8; so it must have
    at all ends of all ranges. A lens loses 0 to 10 %, as makers state it.
    """
    technology = load_technology(name)
    pixel = Pixel(technology=name, pitch_um=pitch_um)
    stated = float(derive(pixel).quantum_efficiency(550.0))
    assert pixel_efficiency(derive(pixel), 550.0) == pytest.approx(stated, rel=1e-10)
    assert 0.9 < of_lens(derive(pixel)) < 1
    numbers = (
        "peak_quantum_efficiency",
        "stack_height_um",
        "stack_index",
        "fill_factor_limit",
        "fill_factor_zero_pitch_features",
    )
    for ends in product(*(technology.ranges[number] for number in numbers)):
        extreme = technology.with_numbers(dict(zip(numbers, ends, strict=True)), "ends")
        check_efficiency(derive(pixel, extreme))


KERNEL = np.random.default_rng(1).uniform(0, 0.04, (5, 5))
FIELD = np.random.default_rng(2).uniform(0, 0.04, (3, 2, 5, 5))


SIGNAL = np.random.default_rng(3).uniform(0, 1, (9, 5))
OPTICAL = np.random.default_rng(5).uniform(0, 0.04, (3, 5, 5))
SHARES = [
    Claim(
        "light of one pixel lands as the shares",
        lambda: share_with_neighbours(np.pad([[3.0]], 5), KERNEL),
        np.pad(3 * KERNEL, 3),
        rtol=1e-15,
    ),
    *(
        Claim(
            f"a flat field of {shape} stays flat",
            lambda shape=shape: share_with_neighbours(np.full(shape, 7.0), KERNEL),
            np.full(shape, 7 * KERNEL.sum()),
            rtol=1e-14,
        )
        for shape in ((1, 1), (2, 3), (12, 7))
    ),
    *(
        Claim(
            f"shares are linear between points of the field, at {place}",
            lambda place=place: share_with_neighbours(SIGNAL, FIELD)[place],
            share_with_neighbours(SIGNAL, kernel)[place],
            rtol=1e-13,
        )
        for place, kernel in (
            ((0, 0), FIELD[0, 0]),
            ((8, 4), FIELD[2, 1]),
            ((2, 1), (3 * (FIELD[0, 0] + FIELD[1, 0]) + FIELD[0, 1] + FIELD[1, 1]) / 8),
        )
    ),
    Claim(
        "sums of shares are linear too",
        lambda: shares_sum(FIELD, (9, 5))[4],
        np.linspace(FIELD[1, 0].sum(), FIELD[1, 1].sum(), 5),
        rtol=1e-14,
    ),
    Claim(
        "and of one pixel those of the middle",
        lambda: shares_sum(FIELD, (1, 1)),
        [[FIELD[1].mean(axis=0).sum()]],
        rtol=1e-14,
    ),
    Claim(
        "charge of light that lands: a convolution that loses what leaves the kernel",
        lambda: spread_shares(OPTICAL, KERNEL),
        [convolve(light, KERNEL, mode="same") for light in OPTICAL],
        rtol=1e-13,
    ),
    Claim(
        "binned values are sums of whole squares",
        lambda: bin_pixels(np.arange(15.0).reshape(3, 5), 2),
        [[0 + 1 + 5 + 6, 2 + 3 + 7 + 8]],
    ),
]


@pytest.mark.parametrize("claim", EFFICIENCIES + CONTRASTS + SHARES, ids=str)
def test_closed_forms_of_collection(claim: Claim) -> None:
    claim.check()


@settings(max_examples=20, deadline=None, derandomize=True)
@given(
    seed=st.integers(0, 2**32 - 1),
    # In the last one rows with equal filters around them do not lie at equal distances.
    cell=st.sampled_from([("GR", "BG"), ("RGB", "GGR"), (*["RG"] * 7, "BG")]),
)
def test_neighbours_get_what_a_pixel_loses(seed: int, cell: tuple[str, ...]) -> None:
    """Light that stays within the array is collected once, whatever the shares of each channel;
    channels add up, and a stacked sensor has each by itself.
    """
    rng = np.random.default_rng(seed)
    light = np.zeros((18, 21))
    light[3:-3, 3:-3] = rng.random((12, 15))
    shares = rng.random((3, 5, 5))
    shares /= shares.sum(axis=(1, 2), keepdims=True)
    layout = Layout(cell)
    # One channel has its shares at points of a grid.
    whole = collected_signal(light, [*shares[:2], np.tile(shares[2], (3, 2, 1, 1))], layout)
    assert whole.sum() == pytest.approx(light.sum(), rel=1e-12)
    parts = [
        collected_signal(light * (layout.numbers(light.shape) == channel), list(shares), layout)
        for channel in range(3)
    ]
    np.testing.assert_allclose(sum(parts), whole, atol=1e-14)
    stacked = collected_signal(light, list(shares), Layout(("RGB",), True))
    alone = [share_with_neighbours(*pair) for pair in zip(np.split(light, 3), shares, strict=True)]
    np.testing.assert_allclose(stacked, np.concatenate(alone), rtol=1e-14)


# --- Diffusion of charge


def collected_by_depth(frequency: float, alpha: float, depletion: float, length: float) -> float:
    """∫ α e^(-αz) P(z) dz with P = 1 in the depletion region and e^(-(z - L_D)/L) below, which
    solves n'' = n/L², n(L_D) = 0.
    """
    spread = 1 / math.sqrt(length**-2 + (2e-3 * math.pi * frequency) ** 2)
    below = quad(
        lambda z: alpha * math.exp(-alpha * (depletion + z) - z / spread), 0, np.inf, epsabs=1e-13
    )[0]
    return float(below - math.expm1(-alpha * depletion))


@pytest.mark.parametrize(
    ("alpha", "depletion", "length"),
    [(0.64, 0.0, 20.0), (0.19, 2.0, 50.0), (2.4, 1.0, 5.0), (0.05, 4.0, 100.0)],
)
def test_diffusion_mtf_solves_the_diffusion_equation(
    alpha: float, depletion: float, length: float
) -> None:
    frequency = np.array([0.0, 3.0, 50.0, 200.0, 1000.0])
    collected = np.array([collected_by_depth(f, alpha, depletion, length) for f in frequency])
    mtf = diffusion_mtf(frequency, alpha, depletion, length)
    np.testing.assert_allclose(mtf, collected / collected[0], rtol=1e-9)
    np.testing.assert_allclose(
        diffusion_mtf(-frequency, [[alpha]], depletion, length), [mtf], rtol=1e-15
    )


@pytest.mark.parametrize(
    ("alpha", "depletion", "length"),
    [(0.64, 1.0, 4.0), (2.4, 0.0, 2.0), (0.19, 0.5, 1.0), (1e-6, 0.0, 3.0)],
)
@pytest.mark.parametrize("phase", [0.11, 0.5])
def test_diffused_shares_have_the_transform_of_the_mtf(
    alpha: float, depletion: float, length: float, phase: float
) -> None:
    """The cosine moment of a row of cells, so wide that 5 hold all charge, is the sum over aliases
    of MTF · sinc · sinc.
    """
    pitch = 12.0
    side = 3.0
    shares = diffused_shares(pitch, side, alpha, depletion, length)
    beyond = 1 - shares.sum()
    assert 0 <= beyond < 0.01
    order = np.arange(-2000, 2001) + phase
    mtf = diffusion_mtf(1e3 * order / pitch, alpha, depletion, length)
    aliases = mtf * np.sinc(order) * np.sinc(order * side / pitch)
    transform = (shares.sum(axis=0) * np.cos(2 * math.pi * phase * np.arange(-2, 3))).sum()
    # The tail of the aliases is 2e-8, and there is charge beyond the five cells.
    assert transform == pytest.approx(aliases.sum(), abs=5e-8 + beyond)
    assert transform < 1 - 1e-4 - beyond  # it does spread
