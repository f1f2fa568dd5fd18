"""Spectra and spectral images: closed forms, CIE tables and colour-science; linear, the same in
factors and bands, in parts and as a whole.
"""

import copy
import mmap
import pickle
import subprocess
import sys
import tracemalloc
from collections.abc import Callable
from decimal import Decimal
from pathlib import Path
from unittest.mock import Mock

import colour
import numpy as np
import pytest
import scipy.constants as si
from helpers.claims import Claim, check
from hypothesis import given, settings, strategies as st

from pixsim import PixsimError, SpectralImage
from pixsim.light import exr, spectral
from pixsim.light.standard import (
    OPPONENT_FROM_XYZ,
    XYZ_FROM_OPPONENT,
    illuminant,
    illuminant_names,
    patch_reflectance,
)
from pixsim.light.stored import PictureFile, StoredImage
from pixsim.light.tables import Column, column_quantum_efficiency

SPECTRA = Path(__file__).parents[2] / "scenes" / "spectra" / "macbeth"
NM = np.arange(360.0, 831.0)
OBSERVER = colour.MSDS_CMFS["CIE 1931 2 Degree Standard Observer"]
TENTHS = np.linspace(400.0, 401.0, 11)


def spectrum(nodes: list[float], values: list[float]) -> spectral.Spectrum:
    return spectral.Spectrum(np.array(nodes, float), np.array(values, float))


TRIANGLE = spectrum([400, 410, 430], [0, 2, 0])


def one_band(nm: float, width_nm: float, value: float, within_nm: float | None = None):
    """Return an image of one sample and one band, with its light at a single wavelength."""
    within = None if within_nm is None else ([[within_nm]], [[1.0]])
    return SpectralImage([nm], width_nm, 1.0, data=np.full((1, 1, 1), value), within=within)


def two_bands() -> SpectralImage:
    """Return bands with lines at 546 and 553 nm (1:3), and 596, 600 and 604 nm (1:2:1)."""
    within = [[546.0, 553.0, 550.0], [596.0, 600.0, 604.0]], [[0.25, 0.75, 0.0], [0.25, 0.5, 0.25]]
    return SpectralImage([550.0, 600.0], 10.0, 1.0, data=np.ones((1, 1, 2)), within=within)


def lamp_lx(name: str) -> tuple[float, float]:
    """Return the illuminance of a CIE lamp by ten-nanometre bands, and by colour-science."""
    shape = colour.SpectralShape(365, 825, 1)
    lamp = colour.SDS_ILLUMINANTS[name].copy().align(shape, interpolator=colour.LinearInterpolator)
    bands = ((lamp.values[:-1] + lamp.values[1:]) / 2).reshape(1, 1, 46, 10).mean(axis=3)
    image = SpectralImage(np.arange(370.0, 821.0, 10.0), 10.0, 1.0, data=bands)
    return image.illuminance_lx()[0, 0], colour.colorimetry.luminous_flux(lamp)


def merged_bands() -> SpectralImage:
    width_nm = np.array([5, 5, 2.5, 2.5, 1.25, 1.25, 2.5, 10, 15, 5, 5])
    factors = np.arange(11.0), np.ones((1, 1, 1))
    return exr._merged(
        SpectralImage(np.cumsum(width_nm) - width_nm / 2, width_nm, 1.0, factors=factors)
    )


FOUR_NM = np.linspace(420.0, 680.0, 4)
LAMP = {spectral.LAMP: [1.0, 2.0, 3.0, 4.0]}
SQUARES = np.arange(7.0)[:, None] ** 2 + 10 * np.arange(7.0)
CLAIMS = [
    Claim(
        "outliers of a foreign header change nothing",
        lambda: [
            spectral.without_outliers(
                image(data=np.ones((2, 2, 1)), header={spectral.OUTLIERS: places})
            )
            is None
            for places in ([[3]], [["a", 1]], [[9, 0]], "text", [[0, -1]])
        ],
        [1] * 5,
    ),
    Claim(
        "an outlier needs two samples beside it",
        lambda: [
            len(spectral.find_outliers(1 + 1e6 * (np.arange(count)[None] == 0))) for count in (2, 3)
        ],
        [0, 1],
    ),
    Claim(
        "extremes of planes in a file",
        lambda: spectral.extremes(
            np.positive(
                np.float32([[[-5, -7]], [[-2, -3]]]),
                out=np.frombuffer(mmap.mmap(-1, 16), np.float32).reshape(2, 1, 2),
            )
        ),
        [-7.0, -2.0],
    ),
    Claim(
        "an outlier is the median of the nine samples around, or of four in a corner",
        lambda: [
            spectral.without_outliers(
                image(data=SQUARES[..., None], header={spectral.OUTLIERS: [[row, column]]})
            ).data[row, column, 0]
            for row, column in ((2, 3), (0, 0), (3, 4))
        ],
        [np.median(SQUARES[1:4, 2:5]), np.median(SQUARES[:2, :2]), np.median(SQUARES[2:5, 3:6])],
    ),
    *(
        Claim(
            f"white is the spectrum of {name}",
            lambda header=header: (
                SpectralImage(
                    FOUR_NM, 10.0, 2.0, factors=(FOUR_NM, np.ones((1, 2, 2))), header=header
                ).white_spectrum
            ),
            white,
        )
        for name, header, white in (
            ("the only factor", {}, FOUR_NM),
            ("the lamps", LAMP, [1, 2, 3, 4]),
            (
                "the plate",
                LAMP | {spectral.DIFFUSER: {spectral.DIFFUSER_W: [4.0, 3.0, 2.0, 1.0]}},
                [4, 3, 2, 1],
            ),
        )
    ),
    Claim(
        "photons a joule by the SI",
        lambda: spectral.photons_per_joule([400.0, 800.0]),
        np.array([400e-9, 800e-9]) / (si.h * si.c),
        rtol=1e-14,
    ),
    Claim(
        "photons a lumen at 555 nm",
        lambda: spectral.photons_per_joule(555.0) / 683,
        4.09e15,
        rtol=1e-3,
        why="the handbook's three digits",
    ),
    Claim(
        "683 lm/W at 555 nm by the SI",
        lambda: one_band(555.0, 1.0, 2.0).illuminance_lx(),
        [[2 * 683.0]],
        rtol=1e-5,
        why="the SI defines it for 555.016 nm in air",
    ),
    Claim(
        "light off the centre of its band",
        lambda: one_band(530.0, 10.0, 0.2, 532.0).illuminance_lx(),
        [[2 * 683.002 * 0.8849624]],
        rtol=1e-6,
        why="digits of CIE's table",
    ),
    Claim(
        "light at the centre of its band",
        lambda: one_band(530.0, 10.0, 0.2).illuminance_lx(),
        [[2 * 683.002 * 0.862]],
        rtol=1e-6,
        why="digits of CIE's table",
    ),
    Claim(
        "weights of bands",
        lambda: spectral.luminous_weight([550.0, 600.0], [10.0, 5.0]),
        683.002 * spectral.photopic_efficiency([550.0, 600.0]) * [10.0, 5.0],
        rtol=1e-14,
    ),
    Claim(
        "mean of a line over the light in a band",
        lambda: two_bands().band_mean(lambda nm: nm),
        [551.25, 600.0],
        rtol=1e-15,
    ),
    Claim(
        "mean of a square over the light in a band",
        lambda: two_bands().band_mean(lambda nm: nm**2) - [551.25**2, 600**2],
        [49 * 3 / 16, 8],
        rtol=1e-9,
    ),
    *(
        Claim(f"illuminance of {name}", lambda got=got: got, wanted, rtol=1e-4, why="10 nm bands")
        for name in ("E", "D65", "A")
        for got, wanted in [lamp_lx(name)]
    ),
    Claim(
        "observer of colour-science",
        lambda: spectral.colour_matching(OBSERVER.wavelengths),
        OBSERVER.values,
        rtol=1e-9,
        atol=1e-20,
        why="ten digits",
    ),
    Claim(
        "efficiency is the observer's y",
        lambda: spectral.photopic_efficiency(NM),
        spectral.colour_matching(NM)[:, 1],
    ),
    Claim(
        "observer at a table of wavelengths",
        lambda: spectral.colour_matching(NM[150:156].reshape(2, 3)),
        spectral.colour_matching(NM[150:156]).reshape(2, 3, 3),
    ),
    Claim(
        "no light beyond the tables",
        lambda: spectral.colour_matching([359.0, 831.0]),
        np.zeros((2, 3)),
    ),
    Claim(
        "opponents of X = Y = Z by the published matrix",
        lambda: OPPONENT_FROM_XYZ @ np.ones(3),
        [0.8939847, -0.0818111, -0.0029257],
        atol=1e-9,
    ),
    Claim("D65 is 100 at 560 nm", lambda: spectral.d65([359.0, 560.0, 831.0]), [0, 100, 0]),
    Claim("illuminant D65 is d65", lambda: illuminant("D65", NM), spectral.d65(NM)),
    *(
        Claim(
            f"{name} of colour-science",
            lambda name=name, table=table: illuminant(name, table.wavelengths[table.domain >= 360]),
            table.values[table.domain >= 360],
            rtol=1e-5,
            why="six digits",
        )
        for name in illuminant_names()
        for table in [colour.SDS_ILLUMINANTS[name]]
    ),
    # The tests may be installed without the scenes.
    *(
        Claim(
            "patches that matrices are fitted to are those of the scene `macbeth`",
            lambda: patch_reflectance(NM),
            [np.interp(NM, *np.loadtxt(path).T) for path in paths],
            atol=1e-12,
        )
        for paths in [sorted(SPECTRA.glob("*.spd"))]
        if paths
    ),
    Claim("no A beyond 360-780 nm", lambda: illuminant("A", [355.0, 835.0]), [0, 0]),
    Claim("opponents back", lambda: XYZ_FROM_OPPONENT @ OPPONENT_FROM_XYZ, np.eye(3), atol=1e-14),
    Claim("area of a triangle", TRIANGLE.integral, 30.0, rtol=1e-14),
    Claim("area of half a triangle", lambda: TRIANGLE.integral(410, 430), 20.0, rtol=1e-14),
    Claim(
        "area beside a jump",
        lambda: spectrum([500, 500, 510], [0, 3, 3]).integral(490.0, 505.0),
        15.0,
        rtol=1e-14,
    ),
    Claim(
        "means over cells of a triangle",
        lambda: TRIANGLE.cell_means(np.array([395.0, 405.0, 410.0, 420.0, 440.0])),
        [0.25, 1.5, 1.5, 0.25],
        rtol=1e-13,
    ),
    Claim("a spectrum between nodes", lambda: TRIANGLE.at(np.array([390, 405, 420])), [0, 1, 1]),
    Claim("a spectrum twice", lambda: (TRIANGLE * 2.0).integral(), 60.0, rtol=1e-14),
    *(
        Claim(
            f"trapezoids on a grid of {step_nm:g} nm",
            lambda step_nm=step_nm: np.trapezoid(TRIANGLE.on_grid(step_nm), dx=step_nm),
            30.0,
            rtol=1e-12,
        )
        for step_nm in spectral.STEPS_NM
    ),
    *(
        Claim(f"step for nodes {spacing_nm:g} nm apart", lambda nodes=nodes: nodes.step_nm, step_nm)
        for spacing_nm, step_nm in ((1.0, 1.0), (0.2, 1 / 8), (0.1, 1 / 32))
        for nodes in [spectral.Spectrum(400.0 + spacing_nm * np.arange(3), np.ones(3))]
    ),
    Claim(
        "nodes of unequal steps in equal ones",
        lambda: spectral.regular_values(TRIANGLE),
        [0, 2, 1, 0],
        rtol=1e-14,
    ),
    Claim(
        "equal steps of 0.1 nm",
        lambda: spectral.regular_values(spectral.Spectrum(TENTHS, TENTHS - 400)),
        TENTHS - 400,
        atol=1e-12,
    ),
    Claim(
        "no equal steps below 0.1 nm",
        lambda: spectral.regular_values(spectrum([400, 400.05, 401], [1, 1, 1])) is None,
        1.0,
    ),
    Claim("a table at whole nanometres", lambda: spectral.tabulated(NM).integral(400, 402), 802.0),
    Claim("widths of merged bands", lambda: merged_bands().band_width_nm, [10, 10, 10, 15, 10]),
    Claim(
        "centres of merged bands",
        lambda: merged_bands().wavelength_nm,
        [5, 15, 25, 37.5, 50],
        rtol=1e-14,
    ),
    Claim(
        "means of merged bands",
        lambda: merged_bands().factors[0][0],
        [0.5, (2 * 2.5 + 3 * 2.5 + 4 * 1.25 + 5 * 1.25 + 6 * 2.5) / 10, 7, 8, 9.5],
        rtol=1e-14,
    ),
    Claim(
        "responsivity to quantum efficiency, R h c/(q λ)",
        lambda: column_quantum_efficiency(
            Column("R", "A/W", (Decimal("0.1"), Decimal("0.2"))), (Decimal(400), Decimal(500))
        ),
        np.array([0.1, 0.2]) * si.h * si.c / (si.e * np.array([400e-9, 500e-9])),
        rtol=1e-12,
    ),
    Claim("shortest digits of a float32", lambda: exr.shortest(float(np.float32(5.3))), 5.3),
]


@pytest.mark.parametrize("claim", CLAIMS, ids=str)
def test_closed_forms(claim: Claim) -> None:
    claim.check()


# Images


def factored(seed: int, shape: tuple[int, int] = (6, 9), margin: int = 0) -> SpectralImage:
    rng = np.random.default_rng(seed)
    factors = rng.uniform(0, 1, (3, FOUR_NM.size)), rng.uniform(0, 1, (3, *shape))
    return SpectralImage(FOUR_NM, 10.0, 2.0, factors=factors, header={"seed": seed}, margin=margin)


@settings(max_examples=20, deadline=None, derandomize=True, database=None)
@given(st.integers(0, 10**6))
def test_light_is_linear_and_the_same_in_factors_bands_and_parts(seed: int) -> None:
    image = factored(seed, (8, 10), margin=2)
    data = np.einsum("rb,ryx->yxb", image.factors[0], image.whole.factors[1])
    bands = SpectralImage(FOUR_NM, 10.0, 2.0, data=data, margin=2)
    inner = data[2:-2, 2:-2]
    weight = np.random.default_rng(seed).uniform(-1, 1, FOUR_NM.size)
    for name, got, wanted in (
        ("factors", image.data, inner),
        ("with margin", bands.whole.data, data),
        ("rows of a band", image.band(2, slice(1, 4)), inner[1:4, :, 2]),
        ("weighted factors", image.weighted(weight), inner @ weight),
        ("weighted bands", bands.weighted(weight), inner @ weight),
        (
            "part of a picture",
            image.weighted_part(weight, np.s_[1:3, 2:6]),
            inner[1:3, 2:6] @ weight,
        ),
        ("mean of factors", image.mean_spectrum(), inner.mean(axis=(0, 1))),
        ("mean of bands", bands.mean_spectrum(), inner.mean(axis=(0, 1))),
        ("illuminance", image.illuminance_lx(), inner @ image.luminous_weight()),
        ("mirrored", image.with_planes(image.planes[:, :, ::-1]).data, inner[:, ::-1]),
    ):
        check(name, got, wanted, rtol=3e-6, atol=1e-6, why="float32 of three terms")


def test_digest_distinguishes_light() -> None:
    image = factored(1, (8, 8), margin=1)
    digests = [
        image.digest(),
        factored(2, (8, 8), margin=1).digest(),
        factored(1, (8, 8)).digest(),
        SpectralImage(FOUR_NM, 10.0, 2.0, data=image.data, header=image.header).digest(),
        image.with_planes(np.array(image.planes), header={"seed": 3}).digest(),
    ]
    assert len(set(digests)) == 5
    assert factored(1, (8, 8), margin=1).identified.header["digest"] == digests[0]


@pytest.mark.parametrize("is_factored", [False, True])
@pytest.mark.parametrize(
    ("shape", "columns"), [((12, 18), 6), ((12, 18), 7), ((13, 17), 5), ((16, 16), 16), ((9, 5), 1)]
)
def test_box_reduced_plane_keeps_centres(shape, columns, is_factored) -> None:
    """A plane in x and y stays one; the die's width and centre stay, less than a sample is cut."""
    image = ramps(shape, is_factored=is_factored)
    reduced = image.box_reduced(columns)
    rows = reduced.shape[0]
    ratio = shape[1] / columns
    assert 0 <= shape[0] - rows * ratio < ratio * (1 + 1e-9)
    check("width", reduced.pitch_um * columns, image.pitch_um * shape[1], rtol=1e-12, why="kept")
    x = (np.arange(columns) + 0.5) * ratio
    y = shape[0] / 2 + (np.arange(rows)[:, None] + 0.5 - rows / 2) * ratio
    # An area with parts of samples errs by up to a quarter of a step of 3.
    error = 0 if ratio.is_integer() else 0.75 / ratio
    wanted = np.stack([1 + x + 2 * y, 5 + 3 * x - y / shape[0]])
    check("planes", reduced.planes, wanted, rtol=1e-6, atol=error, why="float32, parts of samples")
    assert reduced.header["seed"] == 1
    assert reduced.header["reduced"] == {"samples": list(shape), "factor": pytest.approx(ratio)}


def ramps(shape: tuple[int, int], bands: int = 2, is_factored: bool = False) -> SpectralImage:
    """Planes in x and y, of which the mean over any area is the value at its centre."""
    y, x = (np.arange(n) + 0.5 for n in shape)
    planes = np.stack([1 + x + 2 * y[:, None], 5 + 3 * x - y[:, None] / shape[0]])
    nm = np.linspace(400, 700, bands)
    content = {"data": planes[np.arange(bands) % 2].transpose(1, 2, 0)}
    if is_factored:
        content = {"factors": (np.linspace(1, 2, 2 * bands).reshape(2, bands), planes)}
    return SpectralImage(nm, 5.0, 2.0, header={"seed": 1}, **content)


@pytest.mark.parametrize(
    ("shape", "bands", "is_factored", "columns"),
    [
        ((64, 64), 40, False, 64),  # fits: the same image
        ((4, 2048), 2, False, 1024),  # too wide
        ((30, 3000), 2, False, 1000),  # the largest number with whole samples in each mean
        ((8, 8), 250, False, 4),  # 16 kB, below the 60 kB here; 64 kB before
        ((2, 58), 250, True, 58),  # 58.9 kB of 125 merged bands and 2 factors
        ((2, 60), 250, True, 30),  # 61 kB before
        ((101, 1999), 2, False, 970),  # prime: 49.01 rows
        ((303, 1536), 2, False, 1024),  # 202 rows of 1.5 samples: nothing is cut off
        ((1, 3000), 2, False, 3000),  # every coarser sampling would cut off the only row
    ],
)
def test_reduced_to_fit_holds_limits(shape, bands, is_factored, columns, monkeypatch) -> None:
    if bands == 250:
        monkeypatch.setattr(exr, "_MAX_REDUCED_BYTES", 60_000)
    image = ramps(shape, bands, is_factored)
    reduced = exr.reduced_to_fit(image)
    rows = reduced.shape[0]
    assert (reduced.shape[1], reduced is image) == (columns, columns == shape[1])
    assert 0.99 * shape[0] <= rows * shape[1] / columns <= shape[0] * (1 + 1e-9)


@pytest.mark.parametrize(
    ("samples", "outliers"),
    [
        ({(3, 4): 1e6}, [(3, 4)]),
        ({(0, 0): 99.0}, []),  # less than a hundred times the others
        ({(0, 0): 101.0}, [(0, 0)]),
        ({(3, 4): 1e6, (3, 5): 1e6}, []),  # a line: neighbours are as bright
        ({(3, 4): 1e6, (4, 3): 1e6}, []),
        ({(3, 4): 1e6, (4, 5): 1e6}, []),
        ({(3, 4): 1e6, (3, 6): 1e5}, [(3, 4), (3, 6)]),
        ({(3, 4): 1e6, (5, 4): 1e5}, [(3, 4), (5, 4)]),
        ({(3, 4): 1e6, (30, 40): 1e5}, [(3, 4), (30, 40)]),
        ({(149, 149 - 2 * n): 1e6 for n in range(3)}, []),  # more than 1 in 10 000
    ],
)
def test_outliers_stand_alone_and_become_medians(samples, outliers) -> None:
    picture = np.random.default_rng(5).uniform(0.5, 1, (150, 150))
    for place, value in samples.items():
        picture[place] = value
    assert spectral.find_outliers(picture) == outliers
    header = {spectral.OUTLIERS: [list(place) for place in outliers]}
    image = SpectralImage([550.0], 10.0, 1.0, data=picture[..., None], header=header)
    plain = spectral.without_outliers(image)
    assert (plain is None) == (not outliers)
    if plain is not None:
        assert (plain.data.max() < 1, spectral.OUTLIERS in plain.header) == (True, False)


# Pictures in a file


@pytest.mark.parametrize("is_factored", [True, False])
def test_stored_image_is_the_same(is_factored: bool, tmp_path: Path) -> None:
    image = factored(3, margin=1)
    if not is_factored:
        image = SpectralImage(FOUR_NM, 10.0, 2.0, data=image.whole.data, margin=1)
    file = PictureFile(tmp_path)
    file.stored(factored(4))
    # As where one write does not take all of a picture.
    file._file = Mock(wraps=(disk := file._file), write=lambda part: disk.write(part[:100]))
    stored_image = file.stored(image)
    for copied in (
        stored_image,
        copy.deepcopy(stored_image),
        pickle.loads(pickle.dumps(stored_image)),
        stored_image.with_planes(stored_image.whole.planes, margin=1),
    ):
        assert copied.digest() == image.digest()
        assert np.array_equal(copied.weighted(FOUR_NM), image.weighted(FOUR_NM))
    assert not isinstance(copy.copy(stored_image), StoredImage), "a copy may outlive the process"
    assert list(tmp_path.iterdir()) == [], "the file has no name"


def test_picture_file_holds_equal_pictures_once_and_memory_none_of_them(tmp_path: Path) -> None:
    """Twelve planes of 1 MiB; a sum over them holds its result of 2 MiB and a strip."""
    values = np.random.default_rng(1).random((12, 512, 512), np.float32)
    spectra = np.random.default_rng(2).random((12, FOUR_NM.size))
    file = PictureFile(tmp_path)
    images = [
        file.stored(SpectralImage(FOUR_NM, 10.0, 2.0, factors=(factor * spectra, values)))
        for factor in (1, 2)
    ]
    assert file._file.seek(0, 2) == values.nbytes
    del values
    tracemalloc.start()
    total = images[1].weighted(FOUR_NM)
    peak_mib = tracemalloc.get_traced_memory()[1] / (1 << 20)
    tracemalloc.stop()
    assert 2 < peak_mib < 6
    check("twice the light", total, 2 * images[0].weighted(FOUR_NM), rtol=1e-14, why="rounding")


def test_picture_file_on_a_full_disk_is_refused(tmp_path: Path) -> None:
    """The limit of a file's size stands for the disk's, in a process of its own."""
    code = (
        "import resource, signal, sys, numpy as np, pixsim; from pathlib import Path; from"
        " pixsim.light.stored import PictureFile\nsignal.signal(signal.SIGXFSZ, signal.SIG_IGN);"
        " resource.setrlimit(resource.RLIMIT_FSIZE, (1000, 1000))\nimage ="
        " pixsim.SpectralImage([550.0], 10.0, 5.0, data=np.ones((32, 32, 1)))\ntry:"
        " PictureFile(Path(sys.argv[1])).stored(image)\nexcept pixsim.PixsimError as error:"
        " print(error)"
    )
    command = [sys.executable, "-B", "-c", code, tmp_path]
    ended = subprocess.run(command, capture_output=True, text=True, check=False)
    assert "cannot be written (File too large)" in ended.stdout
    assert ended.stderr == ""


# What does not fit

DATA = np.ones((2, 2, 1))
PLANES = np.ones((1, 2, 2))


def image(**options: object) -> SpectralImage:
    return SpectralImage([550.0], 10.0, 1.0, **({"data": DATA} | options))


REFUSALS = [
    ("neither", lambda: image(data=None), "either data or factors"),
    ("both", lambda: image(factors=(np.ones(1), PLANES)), "not both"),
    ("two axes", lambda: image(data=np.ones((2, 2))), "data: got"),
    ("bands first", lambda: image(data=np.ones((1, 4, 4))), "moveaxis"),
    ("factors", lambda: image(data=None, factors=(np.ones((2, 1)), PLANES)), "factors: got"),
    ("nodes", lambda: image(within=([[550.0]], [[0.5, 0.5]])), "within: got"),
    ("a line of nodes", lambda: image(within=([550.0], [1.0])), "within: got"),
    ("rows of nodes", lambda: image(within=(np.ones((2, 1)), np.ones((2, 1)))), "within: got"),
    ("widths", lambda: SpectralImage([550.0], [1.0, 2.0], 1.0, data=DATA), "band_width_nm: got"),
    ("no bands", lambda: SpectralImage([], 10.0, 1.0, data=DATA), "wavelength_nm: got"),
    ("margin", lambda: image(margin=1), "margin: got 1"),
    ("half of the rows", lambda: image(data=np.ones((4, 9, 1)), margin=2), "margin: got 2"),
    ("planes", lambda: image().with_planes(np.ones((2, 2, 2), np.float32)), "planes: got"),
    ("a second band", lambda: image().band(1), "index: got 1"),
    ("weights", lambda: image().weighted(np.ones(2)), "weight: got"),
    ("no columns", lambda: image().box_reduced(0), "columns: got 0"),
    ("finer columns", lambda: image().box_reduced(3), "columns: got 3"),
    ("negative", lambda: image(data=-DATA).validate(), "irradiance: got .* 0 or more"),
    ("infinite", lambda: image(data=np.inf * DATA).validate(), "irradiance: got .* finite"),
    ("one node", lambda: spectrum([500], [1]), "two nodes or more"),
    ("falling nodes", lambda: spectrum([500, 400], [1, 0]), "increasing order"),
    ("values", lambda: spectrum([400, 500], [1, 2, 3]), "two nodes or more"),
    ("no number", lambda: spectrum([400, 500], [1, np.nan]), "NaN or infinity"),
    ("beyond float32", lambda: spectrum([400, 500], [1, 1e31]), "values up to"),
    ("illuminant", lambda: illuminant("LED-B4", [550.0]), "illuminant: .*'LED-B3'"),
]


@pytest.mark.parametrize(("name", "call", "words"), REFUSALS)
def test_arguments_that_do_not_fit_each_other(name: str, call: Callable[[], object], words) -> None:
    with pytest.raises(PixsimError, match=words):
        call()
