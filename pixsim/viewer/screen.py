"""The screen: the part of the die that a display shows, the ideal picture of that part, and the
scene's white.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import numpy as np

from pixsim.base.arrays import Array
from pixsim.base.caller import setting
from pixsim.base.digits import exposure_time, percent, span
from pixsim.base.errors import invalid
from pixsim.base.notes import Note, warn
from pixsim.light.spectral import DIFFUSER, DIFFUSER_W, MIN_LM_PER_W, WHITE_RADIANCE, SpectralImage
from pixsim.optics.camera_lens import ideal_light
from pixsim.sensor.integration import array_size_um
from pixsim.viewer import display as displays
from pixsim.viewer.causes import lightness_range
from pixsim.viewer.develop import ColourChart, ideal_rgb, measure_colour_chart
from pixsim.viewer.display_options import Display
from pixsim.viewer.imaging import Imaging
from pixsim.viewer.scielab import (
    SINGLE_DELTA_E,
    colour_delta_e_map,
    delta_e,
    filtered_grey_lab,
    filtered_lab,
    grey_delta_e_map,
)
from pixsim.viewer.tone import luminance_of, toned

ROUNDING = 1e-6  # of white, in the luminance of a dot
CLIPPED_WARNING = 0.01  # share of the ideal picture
_WHITE_PERCENTILE = 99.0  # of the ideal picture of a scene whose white is unknown
_WHITE_FROM = f"{_WHITE_PERCENTILE:g}th percentile of the ideal image"
_WHITE_DIGITS = 2  # the noise of a render does not change a white rounded to two digits
# of white, between the primaries of a dot of the ideal image: two codes of 8 bits and more in all
# but dark greys
COLOURED = 0.02

# Of fields of a display: their units, and their entries in a header. A radiance is there where a
# luminance says nothing.
_UNITS_OF_WHITE = {"white_w_per_m2_sr": "W m⁻² sr⁻¹", "white_cd_per_m2": "cd/m²"}
HEADER_OF_WHITE = {"white_w_per_m2_sr": WHITE_RADIANCE, "white_cd_per_m2": "luminance_cd_per_m2"}


def allows_float32(tolerance_delta_e: float | None) -> bool:
    """Return whether a study may compute dots and S-CIELAB in float32, whose error of a mean ΔE is
    below `SINGLE_DELTA_E`.
    """
    return tolerance_delta_e is None or tolerance_delta_e >= SINGLE_DELTA_E


def perceived_lab(
    image: Array, display: Display, without_shortcuts: bool = False, in_float32: bool = False
) -> Array:
    """Return the CIELAB of a displayed image after the eye's blur, (H, W, 3).

    image : (H, W) luminance, or (H, W, 3) light of the display's primaries
    without_shortcuts : compute a grey image as a colour image
    in_float32 : compute in float32
    """
    view = _viewing_conditions(display) | {"single": in_float32}
    if image.ndim == 3:
        rgb: Array = np.asarray(image, np.float32) if in_float32 else image
        return filtered_lab(displays.rgb_to_xyz(rgb), **view)
    if without_shortcuts:
        return filtered_lab(displays.to_xyz(image), **view)
    return filtered_grey_lab(image, **view)


def _viewing_conditions(display: Display) -> dict[str, Any]:
    """Return the S-CIELAB arguments for a display."""
    return {
        "white_xyz": displays.WHITE_XYZ,
        "samples_per_deg": display.samples_per_deg,
        "filters": display.filters,
    }


@dataclass(frozen=True)
class Screen:
    """A display, the part of the die that it shows, and the ideal image of that part.

    size_um : (height, width) of the whole picture on the sensor
    dot_edges_um : of the rows and columns of dots that are shown and scored
    ideal, ideal_lab : shown light on those dots, (H, W) or (H, W, 3), and its CIELAB after the
        eye's blur
    without_shortcuts : compute grey images as colour images
    in_float32 : compute the dots of frames and S-CIELAB in float32
    ideal_out_of_gamut : share of the dots whose colour the display cannot show
    """

    display: Display
    size_um: tuple[float, float]
    dot_edges_um: tuple[Array, Array] = field(repr=False)
    ideal: Array = field(repr=False)
    ideal_lab: Array = field(repr=False)
    without_shortcuts: bool = False
    in_float32: bool = False
    ideal_out_of_gamut: float = 0.0

    @property
    def dot_um(self) -> float | None:
        """Side of a dot on the sensor, or None if dots are pixels."""
        return self.size_um[1] / self.display.dots if self.display.raster == "fixed_size" else None

    def seen_at(self, samples_per_deg: float) -> Screen:
        """Return the same screen at another viewing distance."""
        if samples_per_deg == self.display.samples_per_deg:
            return self
        display = self.display.model_copy(update={"samples_per_deg": samples_per_deg})
        return replace(
            self,
            display=display,
            ideal_lab=perceived_lab(self.ideal, display, self.without_shortcuts, self.in_float32),
        )

    def delta_e_map(self, image: Array) -> Array:
        """Return the S-CIELAB difference between a shown picture and the ideal one, (H, W)."""
        if self.display.delta_e != "1976" or self.without_shortcuts:
            lab = perceived_lab(image, self.display, self.without_shortcuts, self.in_float32)
            return delta_e(self.ideal_lab, lab, self.display.delta_e)
        view = _viewing_conditions(self.display) | {"single": self.in_float32}
        if image.ndim == 2:
            return grey_delta_e_map(self.ideal_lab, image, **view)
        rgb: Array = np.asarray(image, np.float32) if self.in_float32 else image
        return colour_delta_e_map(self.ideal_lab, displays.rgb_to_xyz(rgb), **view)


def display_image(light: Array, display: Display, *, in_place: bool = False) -> Array:
    """Return light as a display shows it: (H, W) of a luminance (H, W); (H, W, 3) of the light of
    primaries (3, H, W).

    in_place : overwrite the light
    """
    # Each primary has the codes of a luminance.
    codes = displays.shown_luminance(light, display, in_place=in_place)
    return codes if codes.ndim == 2 else np.moveaxis(codes, 0, -1)


def colour_chart_of(imaging: Imaging, irradiance: SpectralImage) -> ColourChart | None:
    """Return the colour chart under the scene's lamp as a colour sensor records it, or None for a
    monochrome sensor.
    """
    physics = imaging.physics
    if physics.layout is None:
        return None
    return measure_colour_chart(irradiance, physics.channels, imaging.display)


def ideal_on_dots(
    imaging: Imaging, irradiance: SpectralImage, colour_chart: ColourChart | None = None
) -> tuple[tuple[Array, Array], Array]:
    """Return the edges of the dots (`displays.dot_edges_um`), and the light of the ideal picture on
    them before the tone curve.

    The light is a luminance, (H, W), or that of the display's primaries, (3, H, W), 1 for white.

    colour_chart : of a colour sensor
    """
    irradiance = ideal_light(irradiance, imaging.camera)
    physics = imaging.physics
    edges_um = displays.dot_edges_um(
        displays.picture_size_um(irradiance),
        physics.read_pitch_um,
        imaging.display,
        imaging.scored_border_um,
        array_size_um(irradiance, imaging.camera),
        physics.registration,
    )
    if colour_chart is None:
        return edges_um, displays.ideal_luminance(imaging, irradiance, edges_um)
    return edges_um, ideal_rgb(
        irradiance, imaging.camera, imaging.display, colour_chart.to_display, edges_um
    )


def make_screen(
    imaging: Imaging, irradiance: SpectralImage, colour_chart: ColourChart | None = None
) -> tuple[Screen, float]:
    """Return the screen, and the fraction of the ideal picture's dots that are brighter than
    display white.

    colour_chart : of a colour sensor
    """
    display = imaging.display
    edges_um, light = ideal_on_dots(imaging, irradiance, colour_chart)
    gamut = 0.0 if colour_chart is None else displays.out_of_gamut_share(np.moveaxis(light, 0, -1))
    light = toned(light, imaging.develop, display)
    ideal = display_image(light, display)
    in_float32 = imaging.in_float32 and not imaging.without_shortcuts
    lab = perceived_lab(ideal, display, imaging.without_shortcuts, in_float32)
    screen = Screen(
        display,
        displays.picture_size_um(irradiance),
        edges_um,
        ideal,
        lab,
        imaging.without_shortcuts,
        in_float32,
        gamut,
    )
    return screen, fraction_beyond_white(light)


def fraction_beyond_white(light: Array) -> float:
    """Return the fraction of dots of an ideal image, (H, W) or (3, H, W), that are brighter than
    display white.
    """
    return float(np.mean(luminance_of(light) > 1 + ROUNDING))


class IdealFacts(NamedTuple):
    """Brightness of an ideal picture.

    beyond_white : fraction of its dots that are brighter than display white
    lightness : L* of its darkest and its lightest dot, as shown (`lightness_range`)
    """

    beyond_white: float
    lightness: tuple[float, float]


def ideal_light_of_dots(imaging: Imaging, irradiance: SpectralImage) -> Array:
    """Return the light of the ideal picture on the dots behind the tone curve, (H, W) or (3, H, W),
    1 for white.
    """
    _, light = ideal_on_dots(imaging, irradiance, colour_chart_of(imaging, irradiance))
    return toned(light, imaging.develop, imaging.display)


def ideal_facts(imaging: Imaging, irradiance: SpectralImage) -> IdealFacts:
    """Compute an ideal picture, and return its `IdealFacts`."""
    light = ideal_light_of_dots(imaging, irradiance)
    return IdealFacts(
        fraction_beyond_white(light), lightness_range(display_image(light, imaging.display))
    )


def is_coloured(ideal: Array) -> bool:
    """Return whether an ideal image, (H, W) or (H, W, 3), shows colours."""
    return ideal.ndim == 3 and float(np.ptp(ideal, axis=2).max()) > COLOURED


def check_one_ideal(grey: Sequence[str], coloured: Mapping[str, Array]) -> None:
    """Raise PixsimError if monochrome and colour sensors look at a coloured scene: their ideal
    images differ.

    grey : names of the monochrome sensors
    coloured : name of each colour sensor -> its ideal image
    """
    if grey and any(is_coloured(ideal) for ideal in coloured.values()):
        got = (
            f"{', '.join(grey)} without colour filters and {', '.join(coloured)} with them, in a"
            " coloured scene"
        )
        hint = (
            "Use a grey scene, such as csf, or leave the monochrome sensors out, whose ideal image"
            " is grey."
        )
        raise invalid("sensors", got, "a scene that has one ideal image for all", hint)


def white_field(irradiance: SpectralImage) -> str:
    """Return the field of a display that defines white: a luminance, or the radiance of light
    without a luminance.
    """
    return "white_cd_per_m2" if displays.has_luminance(irradiance) else "white_w_per_m2_sr"


def amount_of_white(imaging: Imaging, irradiance: SpectralImage) -> Array:
    """Return the white that gives each scored dot its ideal light, (H, W), in the unit of
    `white_field`.

    It is the ideal picture in the response of these pixels, in units of a white of 1.
    """
    unit = imaging.changed(
        display=imaging.display.model_copy(update={white_field(irradiance): 1.0})
    )
    return luminance_of(ideal_on_dots(unit, irradiance, colour_chart_of(unit, irradiance))[1])


def white_header(views: Sequence[tuple[Imaging, SpectralImage]]) -> dict[str, Any]:
    """Return header entries with a white for a scene of unknown white; none if the display or the
    scene defines the white.

    It is one luminance for all that see the scene: the 99th percentile of the ideal image in the
    response of the pixels, on the dots that are scored, rounded up to two digits, with a warning.
    Of several pixels, which see different parts of the spectrum, the largest counts: so that white
    clips at most 1 % of the ideal image of each.

    Of light without luminance it is a radiance. `display.white = "diffuser"` takes the luminance or
    radiance of a white plate, or of texel value 1 of an emissive chart, as the light says it, in
    place of any other.

    views : the pixels of each sensor with their light, all on one display

    Raises PixsimError if an ideal image is black up to that percentile, or if the light does not
    say what a white plate shows.
    """
    imaging, irradiance = views[0]
    display = imaging.display
    name = white_field(irradiance)
    if display.white is not None:
        return _white_of_diffuser(irradiance, display)
    if (
        display.white_cd_per_m2
        or display.white_w_per_m2_sr
        or HEADER_OF_WHITE[name] in irradiance.header
    ):
        return {}
    estimate = max(
        float(np.percentile(amount_of_white(*pair), _WHITE_PERCENTILE, overwrite_input=True))
        for pair in views
    )
    unit = _UNITS_OF_WHITE[name]
    if not estimate > 0:
        for _, light in views:
            light.validate()  # NaN is no darkness
        got = "no value, and the picture is too dark to estimate it"
        quantity = "luminance" if name == "white_cd_per_m2" else "radiance"
        raise invalid(
            f"display.{name}",
            got,
            f"the scene {quantity} shown as white, in {unit}",
            f"Set {setting(f'display.{name}')}.",
        )
    white = _rounded_up(estimate, _WHITE_DIGITS)
    among_sensors = "" if len(views) == 1 else ", the largest of these sensors'"
    source = f"the {_WHITE_FROM} in the sensor's response{among_sensors}, rounded up"
    fixed = f"set {setting(f'display.{name}', white)} to fix this value"
    warn(
        Note(
            "assumed",
            words=f"the scene does not define its white: using {white:g} {unit}, {source}; {fixed}",
        )
    )
    return {HEADER_OF_WHITE[name]: white, "white_from": _WHITE_FROM}


def _white_of_diffuser(image: SpectralImage, display: Display) -> dict[str, Any]:
    """Return header entries with the white of a plate. Raises PixsimError if the light does not say
    what it shows.
    """
    stated = image.header.get(DIFFUSER)
    if stated is None:
        got = "'diffuser', but this light does not state the light of a white plate"
        hint = (
            f"State the white: {setting('display.white_cd_per_m2')} or"
            f" {setting('display.white_w_per_m2_sr')}. "
        )
        hint += "In Python, pixsim.render(…, diffuser=True) makes light that states it."
        raise invalid("display.white", got, "light of a scene that was rendered for it", hint)
    if DIFFUSER_W not in stated:
        if display.diffuser_reflectance != 1:
            reason = "white is texel value 1 of the scene's emissive chart, not a plate"
            warn(Note("not_used", setting="display.diffuser_reflectance", reason=reason))
        return {**stated, "white_from": "texel value 1 of the chart"}
    per_nm = display.diffuser_reflectance * np.array(stated[DIFFUSER_W])
    cd_per_m2, w_per_m2_sr = (
        float(weights @ per_nm) for weights in (image.luminous_weight(), image.band_width_nm)
    )
    name = "white_w_per_m2_sr"
    white = w_per_m2_sr
    if cd_per_m2 > MIN_LM_PER_W * w_per_m2_sr:
        name = "white_cd_per_m2"
        white = cd_per_m2
    source = (
        f"a white plate of reflectance {display.diffuser_reflectance:g}, {stated['distance_m']:.4g}"
        " m before the lens"
    )
    return {HEADER_OF_WHITE[name]: float(f"{white:.9g}"), "white_from": source}


def with_white(display: Display, white: Mapping[str, Any]) -> Display:
    """Return a display with the white of a `white_header`, or the display itself for an empty
    header.
    """
    stated = {name: white[entry] for name, entry in HEADER_OF_WHITE.items() if entry in white}
    return display.model_copy(update={**stated, "white": None}) if stated else display


def _rounded_up(value: float, digits: int) -> float:
    """Return a positive number rounded up to a number of significant digits; excesses up to
    `ROUNDING` are ignored.

    >>> _rounded_up(730.1, 2), _rounded_up(730.0000001, 2), _rounded_up(9.96e-5, 2)
    (740.0, 730.0, 0.0001)
    """
    value *= 1 - ROUNDING
    nearest = float(f"{value:.{digits - 1}e}")
    step = 10.0 ** (math.floor(math.log10(value)) - digits + 1)
    return nearest if nearest >= value else float(f"{nearest + step:.{digits - 1}e}")


def warn_of_clipping(beyond_white: float, header: Mapping[str, Any], display: Display) -> None:
    """Warn if the display clips more of the ideal image than `CLIPPED_WARNING`."""
    if beyond_white > CLIPPED_WARNING:
        higher = displays.setting_of_white(header, display)
        warn(Note("white_clipped", share=percent(beyond_white), hint=f"raise {higher}"))


class LightLevel(NamedTuple):
    """The scene's white that is shown as display white, and the range of exposure times.

    white : luminance, or the radiance of light without luminance
    unit : of `white`
    white_from : source of its value
    white_spectrum : name of its spectrum
    """

    white: float
    unit: str
    white_from: str
    white_spectrum: str
    shortest_s: float
    longest_s: float

    @classmethod
    def of(
        cls, irradiance: SpectralImage, display: Display, integration_s: Iterable[float]
    ) -> LightLevel:
        """Return the light level of a scored picture; the display's white takes precedence over the
        scene's.
        """
        header = irradiance.header
        times_s = np.array(list(integration_s), float)
        stated = [name for name in _UNITS_OF_WHITE if getattr(display, name)]
        if stated:
            name = stated[0]
            white = getattr(display, name)
            source = f"display.{name}"
        else:
            name = next(name for name, entry in HEADER_OF_WHITE.items() if entry in header)
            white = header[HEADER_OF_WHITE[name]]
            source = header.get("white_from", "the scene")
            source += ", in the sensor's response" if source == _WHITE_FROM else ""
        return cls(
            float(white),
            _UNITS_OF_WHITE[name],
            source,
            displays.white_light(irradiance)[1],
            float(times_s.min()),
            float(times_s.max()),
        )

    @property
    def exposure(self) -> str:
        """Text of the exposure time, or of its range."""
        return span(exposure_time(self.shortest_s), exposure_time(self.longest_s))

    def __str__(self) -> str:
        return (
            f"display white is {self.white:.4g} {self.unit} in the scene; exposed for"
            f" {self.exposure}"
        )
