"""Spectral images: linear, the same in factors and bands, in parts and as a whole."""

from __future__ import annotations

import copy
import pickle
import subprocess
import sys
import tracemalloc
from pathlib import Path

import numpy as np
import pytest
from helpers.claims import check
from hypothesis import given, settings, strategies as st

from pixsim.light import exr, spectral
from pixsim.light.exr import reduced_to_fit
from pixsim.light.spectral import OUTLIERS, SpectralImage, find_outliers, without_outliers
from pixsim.light.standard import patch_reflectance
from pixsim.light.stored import PictureFile, StoredImage

SPECTRA = Path(__file__).parents[2] / "scenes" / "spectra" / "macbeth"
NM = np.linspace(420.0, 680.0, 4)
seeds = given(st.integers(0, 10**6))
few = settings(max_examples=20, deadline=None, derandomize=True, database=None)


def factored(seed: int, shape: tuple[int, int] = (6, 9), margin: int = 0) -> SpectralImage:
    rng = np.random.default_rng(seed)
    factors = rng.uniform(0, 1, (3, NM.size)), rng.uniform(0, 1, (3, *shape))
    return SpectralImage(NM, 10.0, 2.0, factors=factors, header={"seed": seed}, margin=margin)


@few
@seeds
def test_light_is_linear_and_the_same_in_factors_bands_and_parts(seed: int) -> None:
    image = factored(seed, (8, 10), margin=2)
    data = np.einsum("rb,ryx->yxb", image.factors[0], image.whole.factors[1])
    bands = SpectralImage(NM, 10.0, 2.0, data=data, margin=2)
    inner = data[2:-2, 2:-2]
    weight = np.random.default_rng(seed).uniform(-1, 1, NM.size)
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
        SpectralImage(NM, 10.0, 2.0, data=image.data, header=image.header).digest(),
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
    ("shape", "bands", "columns"),
    [
        ((64, 64), 40, 64),  # fits: the same image
        ((4, 2048), 2, 1024),  # too wide
        ((30, 3000), 2, 1000),  # the largest number with whole samples in each mean
        ((8, 8), 250, 4),  # 16 kB, below the 60 kB here; 64 kB before
        ((101, 1999), 2, 970),  # prime: 49.01 rows
        ((1, 3000), 2, 3000),  # every coarser sampling would cut off the only row
    ],
)
def test_reduced_to_fit_holds_limits(shape, bands, columns, monkeypatch) -> None:
    if bands == 250:
        monkeypatch.setattr(exr, "_MAX_REDUCED_BYTES", 60_000)
    image = ramps(shape, bands)
    reduced = reduced_to_fit(image)
    rows = reduced.shape[0]
    assert reduced.shape[1] == columns
    assert (reduced is image) == (columns == shape[1])
    assert 0.99 * shape[0] <= rows * shape[1] / columns <= shape[0] * (1 + 1e-9)


@pytest.mark.parametrize(
    ("samples", "outliers"),
    [
        ({(3, 4): 1e6}, [(3, 4)]),
        ({(0, 0): 99.0}, []),  # less than a hundred times the others
        ({(3, 4): 1e6, (3, 5): 1e6}, []),  # a line: neighbours are as bright
        ({(3, 4): 1e6, (30, 40): 1e5}, [(3, 4), (30, 40)]),
    ],
)
def test_outliers_stand_alone_and_become_medians(samples, outliers) -> None:
    picture = np.ones((150, 150))
    for place, value in samples.items():
        picture[place] = value
    assert find_outliers(picture) == outliers
    header = {OUTLIERS: [list(place) for place in outliers]}
    image = SpectralImage([550.0], 10.0, 1.0, data=picture[..., None], header=header)
    plain = without_outliers(image)
    assert (plain is None) == (not outliers)
    if plain is not None:
        assert plain.data.max() == 1
        assert OUTLIERS not in plain.header


@pytest.mark.parametrize("places", [[[3]], [["a", 1]], [[9, 0]], "text", [[0, -1]]])
def test_outliers_of_a_foreign_header_change_nothing(places) -> None:
    header = {OUTLIERS: places}
    image = SpectralImage([550.0], 10.0, 1.0, data=np.ones((2, 2, 1)), header=header)
    assert without_outliers(image) is None


@pytest.mark.skipif(not SPECTRA.is_dir(), reason="the tests are installed without the scenes")
def test_patches_are_those_of_the_scene() -> None:
    """The scene `macbeth` renders the patches that matrices are fitted to."""
    nm = np.arange(360.0, 831.0)
    files = [np.loadtxt(path).T for path in sorted(SPECTRA.glob("*.spd"))]
    wanted = np.array([np.interp(nm, *file) for file in files])
    check("patches", patch_reflectance(nm), wanted, atol=1e-12, why="rounding")


LAMP = {spectral.LAMP: [1.0, 2.0, 3.0, 4.0]}
PLATE = {spectral.DIFFUSER: {spectral.DIFFUSER_W: [4.0, 3.0, 2.0, 1.0]}}


@pytest.mark.parametrize(
    ("header", "white"), [({}, NM), (LAMP, [1, 2, 3, 4]), (LAMP | PLATE, [4, 3, 2, 1])]
)
def test_white_is_the_plate_then_the_lamps_then_the_shared_spectrum(header, white) -> None:
    image = SpectralImage(NM, 10.0, 2.0, factors=(NM, np.ones((1, 2, 2))), header=header)
    check("white", image.white_spectrum, np.array(white), why="the same numbers")


# Pictures in a file


def in_bands() -> SpectralImage:
    return SpectralImage(NM, 10.0, 2.0, data=factored(3).data, header={"seed": 3}, margin=1)


@pytest.mark.parametrize(
    "make", [lambda: factored(3, margin=1), in_bands], ids=["factors", "bands"]
)
def test_stored_image_is_the_same(make, tmp_path: Path) -> None:
    file = PictureFile(tmp_path)
    file.stored(factored(4))
    image = make()
    stored_image = file.stored(image)
    for copied in (
        stored_image,
        copy.deepcopy(stored_image),
        pickle.loads(pickle.dumps(stored_image)),
        stored_image.with_planes(stored_image.whole.planes, margin=1),
    ):
        assert copied.digest() == image.digest()
        assert np.array_equal(copied.weighted(NM), image.weighted(NM))
    assert not isinstance(copy.copy(stored_image), StoredImage), "a copy may outlive the process"
    assert list(tmp_path.iterdir()) == [], "the file has no name"


def test_picture_file_holds_equal_pictures_once_and_memory_none_of_them(tmp_path: Path) -> None:
    """Twelve planes of 1 MiB; a sum over them holds its result of 2 MiB and a strip."""
    values = np.random.default_rng(1).random((12, 512, 512), np.float32)
    spectra = np.random.default_rng(2).random((12, NM.size))
    file = PictureFile(tmp_path)
    images = [
        file.stored(SpectralImage(NM, 10.0, 2.0, factors=(factor * spectra, values)))
        for factor in (1, 2)
    ]
    assert file._file.seek(0, 2) == values.nbytes
    del values
    tracemalloc.start()
    total = images[1].weighted(NM)
    peak_mib = tracemalloc.get_traced_memory()[1] / (1 << 20)
    tracemalloc.stop()
    assert 2 < peak_mib < 6
    check("twice the light", total, 2 * images[0].weighted(NM), rtol=1e-14, why="rounding")


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
