"""The display: electrons → relative luminance on the display's dots → digital counts → light → XYZ.

Relative luminance is electrons over the mean electrons of the scene's white on axis: 1 for white,
and never scaled to a measured maximum.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from functools import lru_cache
from typing import Annotated, Any, NoReturn

import numpy as np
from scipy.sparse import csr_array

from pixsim.base.arrays import (
    STRIP_DOTS,
    Array,
    Finites,
    NumberArray,
    Picture,
    PositiveArray,
    Row,
    strips,
    transposed,
)
from pixsim.base.bounds import Bounds, Count, NotNegative, Positive
from pixsim.base.caller import setting
from pixsim.base.digits import amount
from pixsim.base.errors import invalid
from pixsim.light.spectral import (
    DIFFUSER,
    DIFFUSER_W,
    MIN_LM_PER_W,
    WHITE_LAMPS,
    WHITE_OF_PLATE,
    WHITE_RADIANCE,
    SpectralImage,
    d65,
    white_description,
)
from pixsim.optics.camera import Camera
from pixsim.optics.thin_lens import irradiance_factor
from pixsim.sensor.integration import (
    M2_PER_UM2,
    MAX_PIXELS,
    electrons_per_joule,
    first_edge_um,
    ideal_rate,
    integrate_axis,
    pixels_on,
)
from pixsim.sensor.pixel import CENTRED, PixelPhysics, Registration
from pixsim.sensor.pixel_options import BORDER_PIXELS
from pixsim.sensor.readout import Frame
from pixsim.viewer.display_options import Display
from pixsim.viewer.imaging import Imaging

_FAINTEST = Bounds(math.ulp(0.0))  # light may be however faint
Electrons = Annotated[float, _FAINTEST]
_AxisNumber = Annotated[int, Bounds(0, 1)]
Degree = Annotated[int, Bounds(0, 5)]

# Grey on a D65 display: XYZ is relative luminance times this (CIE 15, 2-degree observer, Y = 100).
WHITE_XYZ = np.array([95.047, 100.0, 108.883])
# Columns are the display's primaries, those of sRGB (IEC 61966-2-1), so scaled that their sum is
# its white.
_PRIMARIES_XY = ((0.64, 0.33), (0.30, 0.60), (0.15, 0.06))
_PRIMARIES_XYZ = np.array([[x / y, 1.0, (1 - x - y) / y] for x, y in _PRIMARIES_XY]).T
XYZ_FROM_RGB = _PRIMARIES_XYZ * np.linalg.solve(_PRIMARIES_XYZ, WHITE_XYZ)
RGB_FROM_XYZ = np.linalg.inv(XYZ_FROM_RGB)
# Of a primary's largest light, for rounding; of float32.
_GAMUT_TOLERANCE = 1e-9
_SINGLE_GAMUT_TOLERANCE = 1e-6

# Pictures divided by white stay within float64 for any sensor and exposure.
_WHITE_E_PER_S_UM2 = (1e-200, 1e200)
# Of white, in float32: shading, corrections and matrices leave it within its range.
_MAX_SINGLE = 1e30

# Quintic is only the reference for cubic displays.
SPLINE_DEGREE = {"nearest": 0, "linear": 1, "cubic": 3, "quintic": 5}
# Degree -> samples of the B-spline at 0, ±1, ±2.
_B_SPLINE_SAMPLES = {0: (1.0,), 1: (1.0,), 3: (4 / 6, 1 / 6), 5: (66 / 120, 26 / 120, 1 / 120)}

# Bins of luminance; powers of two, as the number of codes, so that a product with bins is exact.
_BINS_PER_CODE = 128
MAX_BINS = 1 << 18
_CODE_MARGIN = 1e-10  # of a luminance, far above the rounding of a power


def white_cd_per_m2(irradiance: SpectralImage, display: Display) -> float:
    """Return the scene luminance shown as display white: `display.white_cd_per_m2`, else the
    luminance of the scene's chart.

    Raises PixsimError if neither is known.
    """
    white = display.white_cd_per_m2 or irradiance.header.get("luminance_cd_per_m2")
    if not white:
        got = "no value, and the scene has no emissive chart that defines it"
        allowed = "the scene luminance in cd/m² that the display shows as white"
        raise invalid(
            "display.white_cd_per_m2", got, allowed, f"Set {setting('display.white_cd_per_m2')}."
        )
    return float(white)


def white_light(irradiance: SpectralImage) -> tuple[Array, str]:
    """Return the light of the scene's white in the image's bands, (B,) in any unit, and its name.
    If the scene's white is unknown, it is the light of D65.

    Where D65 has no light either, as in the infrared, it is the mean of the picture.
    """
    spectrum = irradiance.white_spectrum
    words = white_description(spectrum is not None, irradiance.header.get(WHITE_LAMPS, ()))
    if DIFFUSER_W in irradiance.header.get(DIFFUSER, {}):
        words = WHITE_OF_PLATE
    if spectrum is not None:
        return spectrum, words
    daylight = irradiance.band_mean(d65)
    if daylight.any():
        return daylight, words
    return irradiance.mean_spectrum(), "the mean of the picture, which D65 does not light"


def white_lx(irradiance: SpectralImage, camera: Camera, display: Display) -> float:
    """Return the illuminance on the sensor, on axis, from the scene's white. Raises PixsimError as
    `white_cd_per_m2` does.
    """
    return white_cd_per_m2(irradiance, display) * on_axis_sr(camera)


def on_axis_sr(camera: Camera) -> float:
    """Return the irradiance on the sensor, on axis, over the radiance of the scene, in sr."""
    return float(
        irradiance_factor(camera.f_number, 0.0, camera.magnification) * camera.transmittance
    )


def has_luminance(irradiance: SpectralImage) -> bool:
    """Whether the eye sees the light of the scene's white well enough for a luminance to say how
    much there is of it.
    """
    spectrum, _ = white_light(irradiance)
    lumens, watts = (
        (weight * spectrum).sum()
        for weight in (irradiance.luminous_weight(), irradiance.band_width_nm)
    )
    return bool(lumens > MIN_LM_PER_W * watts)


def white_w_per_m2_sr(irradiance: SpectralImage, display: Display) -> float | None:
    """Return the scene radiance in W m⁻² sr⁻¹, a number, shown as display white. A value of the
    display comes first, then the value that invisible light states.

    None if a luminance says what white is.
    """
    return _white_radiance(irradiance.header, display)


def _white_radiance(header: Mapping[str, Any], display: Display) -> float | None:
    if display.white_w_per_m2_sr is not None:
        return display.white_w_per_m2_sr
    if display.white_cd_per_m2 is not None:
        return None
    stated = header.get(WHITE_RADIANCE)
    return stated if isinstance(stated, float) and stated > 0 else None


def setting_of_white(header: Mapping[str, Any], display: Display) -> str:
    """Return the setting that states the white of light with a header, as the caller writes it.

    In light that nobody sees it is a radiance. It stands in place of a white plate, if there is
    one.
    """
    name = "white_cd_per_m2" if _white_radiance(header, display) is None else "white_w_per_m2_sr"
    instead = f", in place of {setting('display.white')}" if DIFFUSER in header else ""
    return f"{setting(f'display.{name}')}{instead}"


def white_rate(
    imaging: Imaging, irradiance: SpectralImage, channel: PixelPhysics | None = None
) -> float:
    """Return the photo-electrons s⁻¹ µm⁻² of photodiode that the scene's white gives on axis.

    `white_light` has its spectrum.

    imaging : camera, pixel, and the display that states the white
    channel : whose electrons these are. None: of the pixel, of a colour sensor the mean over its
        channels

    Raises PixsimError if the eye or the sensor does not respond to that spectrum.
    """
    spectrum, _ = white_light(irradiance)
    camera = imaging.camera
    display = imaging.display
    response = electrons_per_joule(channel or imaging.physics, irradiance)
    electrons = float((response * spectrum).sum())
    lux = float((irradiance.luminous_weight() * spectrum).sum())
    radiance = white_w_per_m2_sr(irradiance, display)
    rate = 0.0
    if radiance is not None:
        power = float((irradiance.band_width_nm * spectrum).sum())
        if power > 0:
            rate = electrons / power * radiance * on_axis_sr(camera) * M2_PER_UM2
    else:
        white = white_lx(irradiance, camera, display)
        if lux > 0:
            rate = electrons / lux * white * M2_PER_UM2

    low, high = _WHITE_E_PER_S_UM2
    if not low < rate < high:
        got = (
            f"{rate:.3g} electrons s⁻¹ µm⁻² on axis ({electrons:.3g} electrons and {lux:.3g} lx"
            " from its light in all bands)"
        )
        allowed = f"light to which both the sensor and the eye respond, {low:g} to {high:g}"
        hint = (
            "Choose a lamp within the sensor's response, or another technology or infrared cut."
            " For light that the eye does not see, state the white as a radiance"
            f" ({setting('display.white_w_per_m2_sr')})."
        )
        raise invalid("the scene's white", got, allowed, hint)
    return rate


def dot_edges_um(
    size_um: tuple[Positive, Positive],
    pitch_um: Positive,
    display: Display,
    border_um: NotNegative,
    array_um: tuple[float, float] | None = None,
    registration: Registration = CENTRED,
) -> tuple[Array, Array]:
    """Return the edges of the dots that are shown and scored, rows and columns, measured from the
    picture's top left corner.

    `fixed_size`: `dots` span the width of the die; a border of `border_um` on each side, rounded up
    to whole dots, is left out. `one_to_one`: each dot is one pixel of the array.

    size_um : (height, width) of the picture on the sensor
    pitch_um : of the pixels; used by `one_to_one` only
    border_um : of the largest pixels scored on the same dots, `PixelPhysics.border_um`: the strip
        that whole pixels do not fill, and the outermost half pixels, which interpolation continues
        as constants; used by `fixed_size` only
    array_um : (height, width) that the pixels fill, if it is not the picture
    registration : of the pixels, as in `PixelPhysics`

    Returns ((rows + 1,), (columns + 1,)). Raises PixsimError if no whole pixel fits, no whole dot
    is left, or there are more than 2^26 dots.
    """
    pixels = pixels_on(array_um or size_um, pitch_um, registration)
    if display.raster == "one_to_one":
        rows, columns = (
            pixel_edges_um(length_um, count, pitch_um, shift_px)
            for length_um, count, shift_px in zip(size_um, pixels, registration, strict=True)
        )
        return rows, columns

    # Half a dot is rounded down, whatever the rounding of lengths: other sensors with the same
    # field then have the same dots.
    rounding = 1 - 1e-9
    counts = [
        max(1, round(display.dots * length_um / size_um[1] * rounding)) for length_um in size_um
    ]
    if math.prod(counts) > MAX_PIXELS:
        got = (
            f"{display.dots} across a picture of {size_um[1]:g} µm × {size_um[0]:g} µm:"
            f" {amount(math.prod(counts))} dots"
        )
        raise invalid("display.dots", got, f"at most {amount(MAX_PIXELS)} dots in total")

    edges = []
    for length_um, count in zip(size_um, counts, strict=True):
        border_dots = math.ceil(border_um / length_um * count * rounding)
        if 2 * border_dots >= count:
            _refuse_border(border_um, count, dot_um=length_um / count)
        all_edges = np.linspace(0.0, length_um, count + 1)
        edges.append(all_edges[border_dots : count + 1 - border_dots])
    return edges[0], edges[1]


def _refuse_border(border_um: float, count: int, *, dot_um: float) -> NoReturn:
    """Raise PixsimError for a border that leaves none of the dots of a line."""
    got = (
        f"pixels whose border of {border_um:g} µm on each side leaves none of the {count}"
        f" dots of {dot_um:.3g} µm"
    )
    width = f"{BORDER_PIXELS:g} of the largest pixels wide"
    allowed = f"a border ({width}) below {(count - 1) // 2 * dot_um:.4g} µm on this die"
    hint = "Choose smaller pixels, a larger die, or display.raster = 'one_to_one'."
    raise invalid("pixel.pitch_um", got, allowed, hint)


def pixel_edges_um(
    length_um: Positive, count: Count, pitch_um: Positive, registration: float | None = None
) -> Array:
    """Return the edges of a line of `count` pixels, (count + 1,), measured from the picture's edge.

    registration : of the pixels along this axis, as in `PixelPhysics`: a fraction of the pitch,
        or None for a centred line
    """
    if registration is None:
        return length_um / 2 + (np.arange(count + 1.0) - count / 2) * pitch_um
    return (
        first_edge_um(length_um, count, pitch_um, registration) + np.arange(count + 1.0) * pitch_um
    )


def picture_size_um(irradiance: SpectralImage) -> tuple[float, float]:
    """Return the (height, width) of the picture on the sensor."""
    height, width = irradiance.shape
    return height * irradiance.pitch_um, width * irradiance.pitch_um


def average_axis(
    values: Array,
    pitch_um: Positive,
    low_um: float,
    edges_um: Row,
    degree: Degree,
    axis: _AxisNumber,
) -> Array:
    """Return the means, over intervals along an axis, of cells interpolated through their centres.

    The cells start at `low_um`; beyond the outermost centres the interpolation is constant.

    values : (n, ...) or (..., n), any unit; n becomes the number of intervals. Means of float32 are
        float32 up to degree 1
    pitch_um : of the cells
    edges_um : (intervals + 1,) increasing
    degree : of the interpolating spline: 0 (piecewise constant), 1, 3 or 5
    axis : 0 or 1

    Raises PixsimError if the edges do not increase, or the values have not that axis.
    """
    if values.ndim <= axis:
        raise invalid(
            "values", f"an array of shape {values.shape}", f"an array with an axis {axis}"
        )
    lines = values.swapaxes(0, axis)
    degree = min(degree, len(lines) - 1)
    if degree < 2:
        edges_bytes = np.asarray(edges_um, float).tobytes()
        is_single = values.dtype == np.float32
        weights = _mean_weights(len(lines), pitch_um, low_um, edges_bytes, degree, is_single)
        if axis == 1 and values.ndim == 2:
            return transposed(weights @ transposed(values))
        means = weights @ np.ascontiguousarray(lines)
    else:
        edges = _edges_in_cells(edges_um, pitch_um, low_um)
        means = _spline_means(lines, edges, degree)
    return np.ascontiguousarray(means.swapaxes(0, axis))


def _spline_means(lines: Array, edges: Array, degree: int) -> Array:
    """Return the means between neighbouring edges of a spline through values along the first axis.

    lines : (n, ...)
    edges : (intervals + 1,) in cells, 0 at the first value
    """
    from scipy.interpolate import make_interp_spline  # takes 0.3 s, for cubic displays only

    last = len(lines) - 1
    integral = make_interp_spline(np.arange(float(len(lines))), lines, k=degree).antiderivative()

    # Beyond the outermost values the interpolation is constant.
    column = edges.reshape(-1, *[1] * (lines.ndim - 1))
    before = np.minimum(column, 0.0) * lines[0]
    after = np.maximum(column - last, 0.0) * lines[-1]
    running = integral(np.clip(edges, 0, last)) + (before + after)
    return np.asarray(np.diff(running, axis=0) / np.diff(column, axis=0))


def _edges_in_cells(edges_um: Array, pitch_um: float, low_um: float) -> Array:
    """Return edges in units of cells, 0 in the centre of the first one. Raises PixsimError if they
    do not increase.
    """
    edges = (edges_um - low_um) / pitch_um - 0.5
    if edges.size < 2 or not np.all(np.diff(edges) > 0):
        got = (
            f"intervals that do not increase in cells of pitch_um = {pitch_um:g} from low_um ="
            f" {low_um:g}"
        )
        raise invalid("edges_um", got, "increasing edges")
    return edges


@lru_cache(maxsize=4)  # the frames of a pitch share them
def _mean_weights(
    count: int, pitch_um: float, low_um: float, edges_bytes: bytes, degree: int, in_float32: bool
) -> csr_array:
    """Return the weights of cells in the means between neighbouring edges, sparse (edges - 1,
    count).

    pitch_um, low_um : as in `average_axis`
    edges_bytes : of the array of edges (µm), float64
    in_float32 : return them in float32

    The basis function of a value is a box (degree 0) or a hat (degree 1) around its position; the
    outermost ones extend to infinity. Their integral up to an edge has a closed form, and few of
    them overlap an interval.
    """
    edges = _edges_in_cells(np.frombuffer(edges_bytes), pitch_um, low_um)
    half_width = 0.5 if degree == 0 else 1.0
    first = np.clip(np.floor(edges[:-1] - half_width), 0, count - 1).astype(int)
    last = np.clip(np.ceil(edges[1:] + half_width), 0, count - 1).astype(int)
    cell = first[:, None] + np.arange((last - first).max() + 1)

    def integral_up_to(edge: Array) -> Array:
        distance = edge[:, None] - cell
        near = np.clip(distance, -half_width, half_width)
        integral = near + half_width if degree == 0 else 0.5 + near - near * np.abs(near) / 2
        is_before_first = (cell == 0) & (distance < 0)
        is_after_last = (cell == count - 1) & (distance > 0)
        return np.where(is_before_first | is_after_last, distance + 0.5, integral)

    integral = integral_up_to(edges[1:]) - integral_up_to(edges[:-1])
    weight = integral / np.diff(edges)[:, None]
    is_used = (cell <= last[:, None]) & (weight != 0)
    row_starts = np.concatenate([[0], np.cumsum(is_used.sum(axis=1))])
    weights = weight[is_used].astype(np.float32 if in_float32 else float)
    return csr_array((weights, cell[is_used], row_starts), shape=(edges.size - 1, count))


def interpolation_mtf(
    frequency_cy_per_mm: Finites, pitch_um: Positive, interpolation: str
) -> Array:
    """Return the MTF of the interpolation between pixel centres, (...) as the frequencies, 0 to 1.

    With x = frequency · pitch: nearest |sinc x|, linear sinc² x, the interpolating cubic spline
    sinc⁴ x · 3/(2 + cos 2πx). In general it is the transform of the B-spline over the transform of
    its samples; M. Unser, A. Aldroubi and M. Eden, IEEE Trans. Signal Process. 41 (1993) 821.

    A component below the Nyquist frequency of the pixels is shown with this contrast. Its images
    around each multiple of 1/pitch are shown with the contrast at their own frequencies.

    pitch_um : of the pixels
    interpolation : nearest, linear, cubic or quintic

    Raises PixsimError for any other interpolation.

    >>> interpolation_mtf(50.0, 10.0, "linear").round(6).item()  # at the Nyquist frequency: (2/π)²
    0.405285
    """
    if interpolation not in SPLINE_DEGREE:
        raise invalid("interpolation", f"'{interpolation}'", ", ".join(SPLINE_DEGREE))
    degree = SPLINE_DEGREE[interpolation]
    x = np.asarray(frequency_cy_per_mm, float) * pitch_um * 1e-3
    middle, *others = _B_SPLINE_SAMPLES[degree]
    samples = middle + sum(
        2 * sample * np.cos(2 * np.pi * k * x) for k, sample in enumerate(others, 1)
    )
    return np.asarray(np.abs(np.sinc(x)) ** (degree + 1) / samples)


def means_on_dots(picture: Picture, pitch_um: Positive, edges_um: tuple[Row, Row]) -> Array:
    """Return the means over dots of a picture.

    picture : (H, W), any unit, means over cells
    pitch_um : of the cells
    edges_um : of the dots' rows and columns, from `dot_edges_um`

    Returns (rows, columns) in the picture's unit.

    Raises PixsimError as `integrate_axis` does.
    """
    for axis, edges in enumerate(edges_um):
        picture = integrate_axis(picture, pitch_um, edges[:-1], edges[1:], axis)
        picture /= np.diff(edges).reshape((-1, 1) if axis == 0 else (1, -1))
    return picture


def ideal_luminance(
    imaging: Imaging, irradiance: SpectralImage, edges_um: tuple[Row, Row]
) -> Array:
    """Return the relative luminance of each dot for an ideal sensor: no pixels, noise or
    quantisation, and no diffraction.

    A dot shows the mean of the light over its area: the limit of the image as pixels become
    smaller.

    imaging : camera, pixel, and the display that states the white
    edges_um : of the dots' rows and columns, from `dot_edges_um`

    Returns (H, W) dots, 1 for the scene's white.

    Raises PixsimError as `white_rate` does.
    """
    rate = means_on_dots(ideal_rate(irradiance, imaging.physics), irradiance.pitch_um, edges_um)
    rate /= white_rate(imaging, irradiance)
    return np.maximum(rate, 0.0, out=rate)


def frame_luminance(
    frame: Frame,
    size_um: tuple[Positive, Positive],
    white_e: Electrons,
    display: Display,
    edges_um: tuple[Row, Row],
    shading: PositiveArray | None = None,
    *,
    single: bool = False,
) -> Array:
    """Return the relative luminance of a frame on the display's dots, (H, W), mapped by position on
    the die.

    A dot shows the mean, over its area, of the picture interpolated between pixel centres.
    (Sampling at the dots' centres would make noise depend on how pixels and dots register: mean ΔE
    jumps by a quarter where the pitches agree.)

    size_um : (height, width) of the picture on the sensor
    white_e : mean electrons on axis of the scene's white, in this frame's exposure
    edges_um : of the dots' rows and columns, from `dot_edges_um`
    shading : (rows, columns) by which the frame is divided: mean collection of the pixels relative
        to one on axis, or None for none
    single : compute the means in float32, if `fits_single`

    Raises PixsimError if the edges do not increase, and as `relative_to_white` does.
    """
    picture = relative_to_white(frame.estimate_e, frame, white_e, shading, single=single)
    return on_dots(picture, frame.pitch_um, size_um, display, edges_um, frame.registration)


def relative_to_white(
    picture: Picture,
    frame: Frame,
    white_e: Electrons,
    shading: PositiveArray | None = None,
    *,
    single: bool = False,
) -> Array:
    """Return electrons over the electrons of white, without shading, (rows, columns); the picture
    is overwritten.

    picture : (rows, columns) electrons of a frame's pixels
    frame : of which they are
    white_e, shading, single : as in `frame_luminance`

    Raises PixsimError for a shading of another shape.
    """
    picture /= white_e
    if shading is not None:
        if shading.shape != picture.shape:
            raise invalid(
                "shading",
                f"an array {shading.shape}",
                f"a value for each of the {picture.shape} pixels",
            )
        picture /= shading
    return picture.astype(np.float32) if single and fits_single(frame, white_e) else picture


def fits_single(frame: Frame, white_e: Electrons) -> bool:
    """Return whether all codes of a frame, in units of white (electrons), are far within the range
    of float32.
    """
    return 2.0**frame.bits / frame.dn_per_e + frame.mean_dark_e < _MAX_SINGLE * white_e


def on_dots(
    picture: Picture,
    pitch_um: Positive,
    size_um: tuple[Positive, Positive],
    display: Display,
    edges_um: tuple[Row, Row],
    registration: Registration = CENTRED,
) -> Array:
    """Return the means of a picture over the display's dots, (H, W), in its unit, as
    `frame_luminance` takes them.

    picture : (rows, columns) of pixels, in any unit; float32 stays float32, as in `average_axis`
    pitch_um : of the pixels
    size_um : (height, width) of the whole picture on the sensor
    edges_um : of the dots' rows and columns, from `dot_edges_um`
    registration : of the pixels on the picture, as in `PixelPhysics`

    Raises PixsimError if the edges do not increase.
    """
    if display.raster == "one_to_one":
        return picture
    # In the order in which the transposed array is the smaller one.
    for axis in (0, 1) if picture.shape[1] > display.dots else (1, 0):
        low_um = first_edge_um(size_um[axis], picture.shape[axis], pitch_um, registration[axis])
        degree = SPLINE_DEGREE[display.interpolation]
        picture = average_axis(picture, pitch_um, low_um, edges_um[axis], degree, axis)
    return picture


def shown_luminance(
    relative_luminance: NumberArray, display: Display, *, in_place: bool = False
) -> Array:
    """Return `relative_luminance` (...) as a display of finite bits and range shows it, in the same
    shape, 1 for white.

    That of float32 is float32. Encode (count = luminance^(1/γ)), round, decode; clipped to 0 … 1.

    in_place : overwrite `relative_luminance`, if it is a contiguous, writeable array of float64 or
        float32

    >>> shown_luminance(np.array([-0.1, 0.5, 2.0]), Display(gamma=1.0, bits=1)).tolist()
    [0.0, 0.0, 1.0]
    """
    top = 2**display.bits - 1
    is_single = relative_luminance.dtype == np.float32
    table = _light_of_bins(display.gamma, top, is_single)
    borders = _code_borders(display.gamma, top)
    light_of_codes = _light_of_codes(display.gamma, top)

    fits = relative_luminance.flags.carray and relative_luminance.dtype == table.dtype
    if in_place and fits:
        displayed = relative_luminance
    else:
        displayed = np.empty(relative_luminance.shape, table.dtype)
    values = relative_luminance.reshape(-1)
    out = displayed.reshape(-1)
    for part in strips(values.size, 1, STRIP_DOTS):
        luminance = np.clip(values[part], 0.0, 1.0)
        result = out[part]
        bins = (luminance * (table.size - 1)).astype(np.int32)
        np.take(table, bins, out=result, mode="clip")  # checks of indices take as long again

        # Bins with several codes are searched.
        several = np.flatnonzero(np.isnan(result))
        codes = np.searchsorted(borders, luminance[several], "right")
        result[several] = light_of_codes[codes]
    return displayed


@lru_cache(maxsize=4)
def _light_of_codes(gamma: float, top: int) -> Array:
    """Return the light of each code, (top + 1,)."""
    return (np.arange(top + 1) / top) ** gamma


@lru_cache(maxsize=4)
def _code_borders(gamma: float, top: int) -> Array:
    """Return the least luminance of each code from 1 on, (top,): where round(top · luminance^(1/γ))
    reaches it in float64.

    It is within a few roundings of ((code - 1/2)/top)^γ, among numbers whose bits, read as
    integers, increase with them.
    """
    codes = np.arange(1.0, top + 1)
    near = ((codes - 0.5) / top) ** gamma
    below = np.maximum((near * (1 - _CODE_MARGIN)).view(np.int64) - 1, 0)
    reached = (near * (1 + _CODE_MARGIN)).view(np.int64) + 1
    while (reached - below > 1).any():
        middle = (below + reached) // 2
        has_code = np.rint(middle.view(float) ** (1 / gamma) * top) >= codes
        reached = np.where(has_code, middle, reached)
        below = np.where(has_code, below, middle)
    return reached.view(float)


@lru_cache(maxsize=4)
def _light_of_bins(gamma: float, top: int, in_float32: bool) -> Array:
    """Return the light shown for all luminances of each of n equal bins from 0 to 1, and for 1, (n
    + 1,); NaN for several codes.

    in_float32 : return it in float32
    """
    count = min(_BINS_PER_CODE * (top + 1), MAX_BINS)
    edges = np.arange(count + 1) / count
    borders = _code_borders(gamma, top)
    first_code = np.searchsorted(borders, edges[:-1], "right")
    last_code = np.searchsorted(borders, edges[1:], "left")
    light = np.where(first_code == last_code, _light_of_codes(gamma, top)[first_code], np.nan)
    light = np.append(light, 1.0)
    return light.astype(np.float32) if in_float32 else light


def to_xyz(luminance: Picture) -> Array:
    """Return the XYZ of grey light on a D65 display, (H, W, 3) with white at Y = 100, for relative
    luminance (H, W). CIE 15.
    """
    return luminance[:, :, None] * WHITE_XYZ


def rgb_to_xyz(rgb: Array) -> Array:
    """Return the XYZ of light on the display, (..., 3) with white at Y = 100, for its primaries R,
    G, B (..., 3), 1 for white.

    It has the primaries of sRGB (IEC 61966-2-1:1999); R = G = B is `to_xyz` of that luminance.
    XYZ of float32 are float32.

    rgb : light of the primaries, relative

    Raises PixsimError for another shape.
    """
    planes = _planes_of(rgb)
    dtype = np.float32 if rgb.dtype == np.float32 else float
    result: Array = np.empty_like(rgb, dtype=dtype)  # planes stay planes in memory
    # Not by BLAS, whose rounding depends on the number of threads.
    np.einsum(
        "ij,j...->i...",
        XYZ_FROM_RGB.astype(dtype),
        planes,
        out=np.moveaxis(result, -1, 0),
        optimize=False,
    )
    return result


def out_of_gamut_share(rgb: Array) -> float:
    """Return the share of dots, 0 to 1, whose colour the display cannot show, for the light of its
    primaries (..., 3), 1 for white.

    Such a dot needs a primary below 0, or one above 1 in light that is not brighter than white.
    What is brighter is no matter of the gamut. Raises PixsimError for another shape.

    rgb : light of the primaries, relative
    """
    planes = _planes_of(rgb)
    tolerance = _SINGLE_GAMUT_TOLERANCE if rgb.dtype == np.float32 else _GAMUT_TOLERANCE
    red_y, green_y, blue_y = (XYZ_FROM_RGB[1] / WHITE_XYZ[1]).tolist()
    outside = 0
    for rows in strips(planes.shape[1], math.prod(planes.shape[2:])) if planes.ndim > 1 else [...]:
        strip = planes[:, rows]
        is_negative = strip.min(axis=0) < -tolerance
        is_bright = (strip.max(axis=0) > 1 + tolerance) & ~is_negative
        red, green, blue = strip[:, is_bright]
        luminance = red_y * red + green_y * green + blue_y * blue
        outside += int(np.count_nonzero(is_negative)) + int(np.count_nonzero(luminance <= 1))
    return outside / planes[0].size


def _planes_of(rgb: Array) -> Array:
    """Return the planes of colours (..., 3), first. Raises PixsimError for another shape."""
    if rgb.shape[-1:] != (3,) or not rgb.size:
        raise invalid(
            "rgb, shape", rgb.shape, "(..., 3), not empty", "Put the three values in the last axis."
        )
    return np.moveaxis(rgb, -1, 0)
