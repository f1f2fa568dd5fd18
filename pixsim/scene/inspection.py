"""Inspect a scene before its render is planned: its lamps, its surfaces, the shapes in view and the
wavelengths.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import astuple, dataclass

import numpy as np
from numpy.typing import NDArray

from pixsim.base.arrays import Array
from pixsim.base.caller import parameter, setting
from pixsim.base.digits import percent
from pixsim.base.errors import PixsimError, invalid
from pixsim.base.notes import Note
from pixsim.light.quantities import LUMINANCE
from pixsim.light.spectral import (
    HIGH_NM,
    MIN_LM_PER_W,
    VISIBLE,
    WHITE_RADIANCE,
    WIDEST,
    Span,
    Spectrum,
    photons_per_joule,
)
from pixsim.optics.camera import Camera
from pixsim.scene.contents import (
    Body,
    Lamp,
    Surfaces,
    check_shares,
    find_bodies,
    find_lamps,
    find_surfaces,
    lamps_in_range,
    planck,
    warnings_of_skies,
    white_spectra,
)
from pixsim.scene.scene import Scene, sensor_node
from pixsim.scene.tree import Node, Tree, nodes_of
from pixsim.sensor.pixel import PixelPhysics
from pixsim.sensor.spectral_range import CENTRES_NM, NOTED_SHARE, cells_in, span_of

_MIN_END_SHARE = 1e-3  # of its largest value: a lamp's table that ends with less ends dark
_LINE_NM = 100.0  # a lamp's table that is shorter is a line, which ends where it says
_SKY_NM = 320.0, 720.0  # data of Mitsuba 3.9's sunsky, which is 0 outside
_SUN_K = 5772.0  # effective temperature (IAU 2015 resolution B3)
MAX_NAMED = 4  # names of surfaces in a message


@dataclass(frozen=True)
class Inspection:
    """The lamps, surfaces and shapes of a scene, seen by a camera.

    scene, camera : the scene, and the thin lens that sees it
    state, sensor : its parsed tree for this camera, and the node of its sensor
    shape : (H, W) of the film in samples
    bodies : its shapes in the camera's frame
    span : range that is computed: where lamps shine and one of the pixels sees
    all_lamps, lamps : its lamps, and the lamps with light in the range
    surfaces : spectra of its surfaces
    white : spectra that add up to the light of its white; none if it is unknown
    pixels : that see the scene
    """

    scene: Scene
    camera: Camera
    state: Tree
    sensor: Node
    shape: tuple[int, int]
    bodies: list[Body]
    span: Span
    all_lamps: list[Lamp]
    lamps: list[Lamp]
    surfaces: Surfaces
    white: tuple[Spectrum, ...]
    pixels: Sequence[PixelPhysics]

    @property
    def aspect(self) -> float:
        """Width of the film over its height."""
        return self.shape[1] / self.shape[0]

    @property
    def lamp_spectra(self) -> list[Spectrum]:
        """The known spectra of all lamps."""
        return [lamp.spectrum for lamp in self.all_lamps if lamp.spectrum is not None]

    @property
    def chart_white(self) -> dict[str, float]:
        """The entry of an irradiance's header on texel value 1 of an emissive chart; empty where
        the scene is more than a chart.

        Its luminance in cd/m², or the radiance of light without one in W m⁻² sr⁻¹.
        """
        emitters = nodes_of(self.state, "Emitter")
        spectrum = self.lamps[0].spectrum
        is_chart = len(emitters) == 1 and len(self.bodies) == 1 and emitters[0][1].plugin == "area"
        if not is_chart or spectrum is None:
            return {}

        luminance_cd_per_m2 = self.lamps[0].luminance_cd_per_m2
        radiance = spectrum.integral(*astuple(self.span))
        name = WHITE_RADIANCE
        value = radiance
        if luminance_cd_per_m2 > MIN_LM_PER_W * radiance:
            name = LUMINANCE
            value = luminance_cd_per_m2
        return {name: float(f"{value:.9g}")} if value > 0 else {}

    @property
    def warnings(self) -> list[Note]:
        """Possible problems of the scene."""
        texts = []
        if self.surfaces.short:
            ranges = ", ".join(sorted(self.surfaces.short))
            texts.append(
                f"reflectance tables cover only {ranges}, and Mitsuba takes 0 outside; extend them"
                " to 360-830 nm"
            )
        if self.surfaces.ending:
            texts.append(
                f"outside {VISIBLE.words} these are what Mitsuba makes of them:"
                f" {_named(self.surfaces.ending)}"
            )
        texts += [
            *warnings_of_skies(self.state, self.scene.choice.reading),
            *_light_that_ends(self),
        ]
        return [Note("scene", words=text) for text in texts]


def inspect_scene(scene: Scene, camera: Camera, pixels: Sequence[PixelPhysics]) -> Inspection:
    """Return the lamps, surfaces and shapes of a scene, seen through a thin lens.

    pixels : whose response decides on the range that is computed

    Raises PixsimError for a scene without light in that range, for a lamp that is negative or not
    finite, and for a surface whose spectrum ends within that range.
    """
    state = scene.for_camera(camera)
    reading = scene.choice.reading
    sensor = sensor_node(state, scene.sensor_id)[1]
    height, width = scene.film_shape(camera, state)
    check_shares(state)
    all_lamps = find_lamps(state, reading)
    span = span_of([lamp.spectrum for lamp in all_lamps if lamp.spectrum is not None], pixels)
    lamps = lamps_in_range(all_lamps, span)
    if not lamps:
        raise _no_light(span)
    surfaces = find_surfaces(state, reading, span, scene.beyond_tables)
    if surfaces.ending and not scene.beyond_tables:
        raise _unknown_beyond(surfaces)

    return Inspection(
        scene=scene,
        camera=camera,
        state=state,
        sensor=sensor,
        shape=(max(1, height), max(1, width)),  # the renderer checks the size
        bodies=find_bodies(state, sensor),
        span=span,
        all_lamps=all_lamps,
        lamps=lamps,
        surfaces=surfaces,
        white=white_spectra(state, all_lamps if scene.white_lamps else lamps, scene.white_lamps),
        pixels=pixels,
    )


def _light_that_ends(inspection: Inspection) -> list[str]:
    """Return warnings of lamps whose data end where a sensor sees light, with the share of its
    electrons that may be missing.
    """
    pictures = [
        inspection.state.nodes[index]
        for lamp in inspection.all_lamps
        if lamp.spectrum is None
        for index in lamp.pictures
    ]
    warnings = [
        text for lamp in inspection.lamp_spectra for text in _table_that_ends(inspection, lamp)
    ]
    if pictures and inspection.span != VISIBLE:
        names = ", ".join(dict.fromkeys(f"'{node.plugin}'" for node in pictures))
        warnings.append(
            f"the light of a picture or an RGB colour is 0 outside {VISIBLE.words}, which counts"
            f" here: {names}"
        )

    if any(node.plugin == "sunsky" for node in pictures):
        # Air lets little of the sun through below 320 nm.
        share = _largest_share(inspection, planck(CENTRES_NM, _SUN_K), _SKY_NM[1] < CENTRES_NM)
        if share > NOTED_SHARE:
            warnings.append(
                f"a sunsky has data from {_SKY_NM[0]:g} to {_SKY_NM[1]:g} nm, and is 0 beyond: of"
                f" sunlight (a black body of {_SUN_K:g} K), {percent(share, 1)} of the electrons"
                " come from there; a filter keeps it out"
                f" ({setting('pixel.infrared_cut_nm', _SKY_NM[1])})"
            )
    return list(dict.fromkeys(warnings))


def _table_that_ends(inspection: Inspection, lamp: Spectrum) -> list[str]:
    """Return warnings of a lamp's table that begins or ends with light."""
    nodes_nm = lamp.nodes_nm
    values = lamp.values
    if nodes_nm[-1] - nodes_nm[0] < _LINE_NM:
        return []

    min_value = _MIN_END_SHARE * values.max()
    held = np.where(cells_in(inspection.span), np.interp(CENTRES_NM, nodes_nm, values), 0.0)
    warnings = []
    for verb, end_nm, value, beyond in (
        ("begins", nodes_nm[0], values[0], nodes_nm[0] > CENTRES_NM),
        ("ends", nodes_nm[-1], values[-1], nodes_nm[-1] < CENTRES_NM),
    ):
        if not value > min_value:
            continue
        share = _largest_share(inspection, held, beyond)
        if share > NOTED_SHARE:
            warnings.append(
                f"the light of a lamp {verb} at {end_nm:g} nm, where it is not 0: it is taken"
                f" as 0 beyond; if it stayed at that value, {percent(share)} of the electrons"
                f" would come"
                " from there"
            )
    return warnings


def _largest_share(inspection: Inspection, light: Array, beyond: NDArray[np.bool_]) -> float:
    """Return the largest share of the electrons in any channel, of a spectrum (cells,), that comes
    from the cells beyond an end.
    """
    shares = [0.0]
    for physics in inspection.pixels:
        for channel in physics.channels:
            efficiency = channel.quantum_efficiency(CENTRES_NM)
            electrons = light * efficiency * photons_per_joule(CENTRES_NM)
            if electrons.sum() > 0:
                shares.append(float(electrons[beyond].sum() / electrons.sum()))
    return max(shares)


def _unknown_beyond(surfaces: Surfaces) -> PixsimError:
    """Return the error for surfaces whose spectra end within the range that is computed."""
    got = (
        f"{_named(surfaces.ending)}, under a lamp with light that the sensor sees in"
        f" {surfaces.span.words}"
    )
    allowed = f"tables of reflectance that cover {surfaces.span.words}"
    hint = (
        f"Extend them; or state {parameter('beyond_tables', 'hold')} or 'zero'; or keep that light"
        f" out ({setting('pixel.infrared_cut_nm', HIGH_NM)})."
    )
    return invalid("scene", got, allowed, hint)


def _named(surfaces: Sequence[str]) -> str:
    """Return the names of surfaces for a message: the first of them, and how many follow."""
    names = "; ".join(surfaces[:MAX_NAMED])
    more_count = len(surfaces) - MAX_NAMED
    return f"{names}; and {more_count} more" if more_count > 0 else names


def _no_light(span: Span) -> PixsimError:
    """Return the error for a scene without light in the range that is computed."""
    allowed = (
        f"a lamp, a chart or a sky with light in {VISIBLE.words}, or in {WIDEST.words} where the"
        " sensor sees it"
    )
    hint = (
        "Check that its scale is above 0, and that no filter keeps it out (pixel.infrared_cut_nm)."
    )
    return invalid("scene", f"no emitter with light in {span.words}", allowed, hint)
