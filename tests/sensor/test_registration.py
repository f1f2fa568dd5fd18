"""Where the pixels of a repeat lie on the die, and that no result depends on it but by chance."""

from __future__ import annotations

import numpy as np
import pytest
from helpers.chains import imaging, scene_of

import pixsim
from pixsim.base.errors import PixsimError
from pixsim.light.spectral import SpectralImage
from pixsim.optics.camera import Camera
from pixsim.sensor.exposure import Exposure
from pixsim.sensor.integration import (
    any_hard_edge,
    cell_spline,
    first_edge_um,
    integrate_pixels,
    interval_weights,
    mean_signal_rate,
    pixel_count,
    pixels_on,
    running_integral,
)
from pixsim.sensor.pixel import CENTRED, derive, spread_registration
from pixsim.sensor.pixel_options import Pixel
from pixsim.viewer.chain import make_chain
from pixsim.viewer.display import on_dots
from pixsim.viewer.display_options import Display
from pixsim.viewer.evaluate import evaluate
from pixsim.viewer.noise_budget import noiseless_frame
from pixsim.viewer.scene_light import PreparedScene

CAMERA, DISPLAY = Camera(die_mm=2.7136), Display(white_cd_per_m2=1000.0)
LONG = Exposure(integration_s=0.03)


@pytest.mark.parametrize("digits", range(1, 9))
def test_spread_registration_is_a_net_for_every_power_of_two(digits: int) -> None:
    """Of 2^m points, each of 2^m equal rectangles of any shape has one: a (0, m, 2)-net in base 2,
    as Sobol' proved.
    """
    points = [spread_registration(repeat) for repeat in range(2**digits)]
    for across in range(digits + 1):
        cells = {(int(x * 2**across), int(y * 2 ** (digits - across))) for x, y in points}
        assert len(cells) == 2**digits


@pytest.mark.parametrize("registration", [0.0, 0.25, 0.5, 0.5 + 1e-9, 0.75, 0.999])
def test_a_pixel_border_lies_at_the_registration_from_the_centre(registration: float) -> None:
    """And as many whole pixels as fit are on each side, for even and odd numbers of them."""
    for length_um in np.random.default_rng(1).uniform(5.0, 100.0, 200).tolist():
        count = pixel_count(length_um, 3.7, registration)
        first_um = first_edge_um(length_um, count, 3.7, registration)
        borders = (first_um - length_um / 2) / 3.7 - registration
        assert borders == pytest.approx(round(borders), abs=1e-9)
        for uncovered_um in (first_um, length_um - first_um - count * 3.7):
            assert -1e-9 <= uncovered_um < 3.7
    # Exactly filled, and centred: the numbers of a centred array.
    assert pixel_count(512 * 5.3, 5.3, 0.0) == pixel_count(512 * 5.3, 5.3) == 512
    assert first_edge_um(512 * 5.3, 512, 5.3, 0.0) == pytest.approx(
        first_edge_um(512 * 5.3, 512, 5.3), abs=1e-9
    )
    assert first_edge_um(511 * 5.3, 511, 5.3, 0.5) == pytest.approx(
        first_edge_um(511 * 5.3, 511, 5.3), abs=1e-9
    )


def test_pixels_on_without_room_at_a_registration_raises() -> None:
    assert pixels_on((1.5, 1.5), 1.0, (0.5, 0.5)) == (1, 1)
    with pytest.raises(
        PixsimError,
        match=r"pitch_um: got 1; allowed: small enough for one whole pixel .* registration 0\.",
    ):
        pixels_on((1.9, 1.5), 1.0, (0.0, 0.5))


def waves(x: np.ndarray) -> np.ndarray:
    """Running integral of light that waves with a period of 23 µm."""
    return 3 * x - 20 / np.pi * np.cos(2 * np.pi * x / 23.0 + 0.4)


def picture(pattern: str = "") -> SpectralImage:
    """One band whose light waves across a picture of 120 × 120 samples of 1 µm, and less so down
    it.
    """
    edges = np.arange(121.0)
    across, down = np.diff(waves(edges)), np.diff(waves(edges / 2)) * 2
    return SpectralImage(
        [550.0], 10.0, 1.0, data=np.outer(down, across)[..., None], header={"diffraction": False}
    )


@pytest.mark.parametrize(
    "colour",
    [None, {"pattern": "rggb", "sensitivities": "Nikon_D5100", "peak_quantum_efficiency": 0.5}],
)
def test_signal_is_the_light_at_the_registered_places(colour: dict[str, object] | None) -> None:
    """Closed form: the pixels' own intervals of the running integral, in the ratio of their light
    (even or a mosaic's channel).
    """
    own: dict[str, object] = {} if colour is None else {"colour": colour}
    pixel = Pixel(pitch_um=6.5, infrared_cut_nm=700.0, registration=(0.3, 0.8), **own)
    physics = derive(pixel)
    signal = mean_signal_rate(picture(), Camera(die_mm=0.12), physics)
    rows, columns = signal.shape
    assert (rows, columns) == (18, 17)  # on either side of the centre 10 and 8, 9 and 8
    half = physics.photodiode_side_um / 2
    y, x = 60 + 6.5 * (0.8 + np.arange(-10, 8) + 0.5), 60 + 6.5 * (0.3 + np.arange(-9, 8) + 0.5)
    light = np.outer(
        2 * (waves((y + half) / 2) - waves((y - half) / 2)), waves(x + half) - waves(x - half)
    )
    ratio = signal / light
    for row, column in np.ndindex(2, 2):
        own_ratio = ratio[row::2, column::2]
        np.testing.assert_allclose(
            own_ratio, own_ratio[0, 0], rtol=1e-6
        )  # of the spline; 0.01 pixel off gives 1e-3


@pytest.mark.parametrize("registration", [CENTRED, (0.3, 0.8), (0.5, 0.0)])
def test_a_ramp_is_shown_where_it_is(registration: tuple[float | None, float | None]) -> None:
    """Linear interpolation of a ramp between pixel centres is the ramp, wherever the pixels lie."""
    size_um, edges_um = (84.8, 169.6), (np.arange(20.0, 61.0, 5.3), np.arange(20.0, 150.0, 5.3))
    rows, columns = pixels_on(size_um, 3.1, registration)
    first = [
        first_edge_um(um, n, 3.1, own)
        for um, n, own in zip(size_um, (rows, columns), registration, strict=True)
    ]
    y, x = (
        begin + 3.1 * (np.arange(n) + 0.5) for begin, n in zip(first, (rows, columns), strict=True)
    )
    shown = on_dots(2 * y[:, None] + x, 3.1, size_um, Display(dots=32), edges_um, registration)
    middle_y, middle_x = ((edges[1:] + edges[:-1]) / 2 for edges in edges_um)
    np.testing.assert_allclose(shown, 2 * middle_y[:, None] + middle_x, rtol=1e-12)


def test_running_integral_both_ways_gives_the_same_integrals() -> None:
    """As splines along one axis after the other; and the sum of adjacent intervals is exact next to
    light 1e7 times as bright.
    """
    smooth = 1 + np.random.default_rng(2).uniform(0, 1, (61, 83)).cumsum(axis=1) / 83
    running = running_integral(smooth)
    assert running.both_ways
    for pitch_um, side_um in ((1.7, 1.1), (5.3, 5.3), (0.31, 0.2), (20.0, 13.0)):
        one = integrate_pixels(smooth, 1.0, pitch_um, side_um)
        np.testing.assert_allclose(
            integrate_pixels(smooth, 1.0, pitch_um, side_um, running), one, rtol=1e-11
        )
    ends = np.array([0.0, 1e-3, 7.4, 61.0])
    weights = interval_weights(ends[:-1], ends[1:], cell_spline(61))
    assert weights.sum() == pytest.approx(weights.sum(axis=0).sum(), rel=1e-15)
    steep = np.exp(np.linspace(0, 7 * np.log(10), 200))[:, None] * np.ones(
        8
    )  # neighbours differ by 8 %
    running = running_integral(steep)
    assert running.both_ways
    np.testing.assert_allclose(
        integrate_pixels(steep, 1.0, 1.0, 1.0, running),
        steep[:, :8] * np.ones((200, 8)),
        rtol=1e-12,
    )
    assert any_hard_edge(np.array([[1.0], [101.0]]))
    assert not running_integral(
        np.where(np.arange(40) < 20, 1.0, 200.0)[:, None] * np.ones(40)
    ).both_ways


def chart(size: int) -> SpectralImage:
    """The CSF chart under even light, without diffraction."""
    from pixsim.scene.charts import csf_value

    at = (np.arange(size) + 0.5) / size
    light = csf_value(at, at[:, None]).astype(np.float32)
    header = {"diffraction": False, "luminance_cd_per_m2": 1000.0}
    return SpectralImage(
        [550.0], 10.0, 2713.6 / size, factors=(np.ones((1, 1)) * 1e-3, light[None]), header=header
    )


def expected_delta_e(
    light: PreparedScene, pitch_um: float, repeats: int, display: Display
) -> float:
    """Mean ΔE without noise over the registrations of some repeats."""
    found = []
    for repeat in range(repeats):
        pixel = Pixel(pitch_um=pitch_um, infrared_cut_nm=700.0)
        chain = make_chain(imaging(CAMERA, pixel, LONG, display).registered(repeat), light)
        found.append(chain.development.score(noiseless_frame(chain, 0.03)).mean_delta_e)
    return float(np.mean(found))


@pytest.fixture(scope="module")
def light() -> PreparedScene:
    display = DISPLAY.model_copy(update={"dots": 128})
    return scene_of(chart(512), CAMERA, Pixel(infrared_cut_nm=700.0), display, border_um=40.0)


def test_one_pixel_column_less_makes_no_step(light: PreparedScene) -> None:
    """At die/100 the number of columns falls. A centred array moves by half a pixel; the mean over
    registrations hardly changes.

    The gate is the step of .05 % that remains where registrations shift a centred grid in place of
    a border.
    """
    display, edge_um = light.screen.display, 2713.6 / 100
    below, above = (
        expected_delta_e(light, edge_um * (1 + side * 1e-6), 8, display) for side in (-1, 1)
    )
    pixels = (
        Pixel(pitch_um=edge_um * (1 + side * 1e-6), infrared_cut_nm=700.0) for side in (-1, 1)
    )
    chains = [make_chain(imaging(CAMERA, pixel, LONG), light) for pixel in pixels]
    centred = [
        chain.development.score(noiseless_frame(chain, 0.03)).mean_delta_e for chain in chains
    ]
    assert abs(above / below - 1) < 5e-4
    assert abs(centred[1] / centred[0] - 1) > 5e-4


def test_mean_over_registrations_does_not_beat_with_the_dots(light: PreparedScene) -> None:
    """Around the pitch of a dot, the mean ΔE of 16 registrations lies within .4 % of a parabola; of
    centred pixels it does not.
    """
    display, dot_um = light.screen.display, 2713.6 / 128
    pitches_um = dot_um * np.array([0.97, 0.98, 0.99, 0.995, 1.0, 1.005, 1.01, 1.02, 1.03])
    spread = np.array([expected_delta_e(light, um, 16, display) for um in pitches_um.tolist()])
    one = np.array([expected_delta_e(light, um, 1, display) for um in pitches_um.tolist()])
    off = [
        values / np.polyval(np.polyfit(pitches_um, values, 2), pitches_um) - 1
        for values in (spread, one)
    ]
    assert np.abs(off[0]).max() < 4e-3
    assert np.abs(off[1]).max() > 1e-2


def test_repeats_of_a_study_have_their_registrations(tmp_path: object) -> None:
    """In x and y, the same for all sizes, by the number of the repeat; where dots are pixels, the
    array stays centred.
    """
    from helpers.tiny import PITCHES_UM, tiny

    result = pixsim.study(tiny(repeats=3), tmp_path, jobs=1)
    for pitch_um in (PITCHES_UM[0], PITCHES_UM[-1]):
        scores = result.scores(result.curves[0].technology, pitch_um)
        assert [score.frame.registration for score in scores] == [
            (y, x) for x, y in map(spread_registration, range(3))
        ]
    assert (
        imaging(CAMERA, Pixel(), LONG, Display(raster="one_to_one"))
        .registered(1)
        .physics.registration
        == CENTRED
    )
    stated = derive(Pixel(registration=(0.1, 0.2)))
    assert stated.registered(1).registration == (0.2, 0.1)


def test_evaluate_stays_centred_unless_a_registration_is_stated() -> None:
    """The border of both is one and a half pixels; (0, 0) of an even number of pixels is the
    centred array.
    """
    image, camera = chart(256), CAMERA
    display = Display(dots=128)
    centred, stated = (
        evaluate(
            image,
            camera,
            Pixel(pitch_um=21.2, infrared_cut_nm=700.0, registration=where),
            LONG,
            display,
        )
        for where in (None, (0.0, 0.0))
    )
    assert centred.border_um == stated.border_um == pytest.approx((42.4, 42.4))  # whole dots
    np.testing.assert_array_equal(stated.frame.dn, centred.frame.dn)
    np.testing.assert_array_equal(stated.delta_e, centred.delta_e)
    one_to_one = Display(raster="one_to_one")
    moved = evaluate(
        image,
        camera,
        Pixel(pitch_um=21.2, infrared_cut_nm=700.0, registration=(0.5, 0.0)),
        LONG,
        one_to_one,
    )
    assert moved.delta_e.shape == (128, 127)
    assert moved.border_um == pytest.approx((0.0, 10.6), abs=1e-9)
