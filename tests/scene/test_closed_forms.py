"""Closed forms of scenes, charts and films, a row each."""

import math
from functools import partial

import numpy as np
import pytest
from helpers.claims import Claim
from helpers.edits import load

import pixsim
from pixsim.light.spectral import Spectrum
from pixsim.optics.lens_defocus import depth_of_field_m
from pixsim.scene import charts, rules
from pixsim.scene.bands import passes
from pixsim.scene.contents import Body, blur_um, face_one_way, greatest_blur_um, planck
from pixsim.scene.film import details_across
from pixsim.scene.job import Passes
from pixsim.scene.own_chart import srgb_decoded
from pixsim.scene.plan import decide_saturation, make_render_plan
from pixsim.sensor.reading import Readout

CAMERA = pixsim.Camera()
FILM = pixsim.Camera(die_mm=2.4, f_number=2.8, focal_length_mm=4.0)
CSF = {"scene": "csf.xml"}


def disc_um(camera: pixsim.Camera, depth_m: float) -> float:
    """Diameter of the blur disc: the aperture times the relative miss of the image; 1/v is negative
    where the image is virtual.
    """
    image_mm = 1 / (1 / camera.focal_length_mm - 1 / (1e3 * camera.object_distance_m))
    vergence_per_mm = 1 / camera.focal_length_mm - 1 / (1e3 * depth_m)
    return 1e3 * camera.focal_length_mm / camera.f_number * abs(image_mm * vergence_per_mm - 1)


def edge_loss() -> float:
    """Light of a straight edge across a disc of diameter 1: the share of the disc beyond t, for t
    from 0 to ½; an edge loses it on one side and has it on the other.
    """
    t = (np.arange(100000) + 0.5) / 200000
    return float(((np.arccos(2 * t) - 2 * t * np.sqrt(1 - 4 * t**2)) / np.pi).mean())


def boards(*normals: tuple[float, float, float]) -> bool:
    units = [np.array(normal) / np.linalg.norm(normal) for normal in normals]
    return face_one_way([Body(0, None, unit) for unit in units])


def details(
    camera: pixsim.Camera, aperture_um: float, pitch_um: float, display: pixsim.Display
) -> float:
    return details_across(camera, aperture_um, display, pitch_um)[0]


def saturation(**options: object) -> tuple[bool, float]:
    line = decide_saturation(Readout.of(pixsim.derive(pixsim.Pixel(**options))), 0.1)
    return line.kept, line.bound_e


def field_m(pixel_um: float) -> tuple[float, float]:
    camera = pixsim.Camera(focal_length_mm=16.0, f_number=4.0, object_distance_m=1.0)
    return depth_of_field_m(camera, pixel_um)


PART_CAMERA = pixsim.Camera(focal_length_mm=16.0, f_number=2.8, die_mm=0.02, object_distance_m=0.3)
CONE = 1 / (1 + 4 * PART_CAMERA.f_number**2 * (1 + PART_CAMERA.magnification) ** 2)


def light_on_axis(quantity: str, **parameters) -> float:
    """Light of a part without a target in the middle of the film, in lx or W/m²."""
    scene = load("target", contrast=0, size_um=1, **parameters).with_resolution(1)
    plan = make_render_plan(scene, PART_CAMERA, exact=True)
    image = pixsim.render(scene, PART_CAMERA, plan=plan)
    weight = image.luminous_weight() if quantity == "lux" else image.band_width_nm
    return float(image.weighted(weight).item())


SPREAD_MM2 = 4.0 * 1e-3 * 5.0 * (1000.0 - 16.0)  # N c (u - f)
LANES = Passes(1.0, ((0, (0.0,)),) * 3, ((0, 1), (2,)))
CLAIMS = [
    Claim("CSF: 25 to 1000 cd/m² below (Michelson contrast 975/1025), a hundredth of it on top",
          lambda: [[row.min(), row.max()] for row in charts.csf_value(np.linspace(0, 1, 200_001), np.array([[0.0], [0.5], [1.0]])) * 1000],
          [[512.5 - half, 512.5 + half] for half in (4.875, 48.75, 487.5)], atol=1e-4, why="steps of the chart"),
    Claim("white has lux/π, or what is stated",
          lambda: [load(name, lux=5 * math.pi, **white).white_cd_per_m2 for name, white in (
              *((name, {}) for name in ("target", "macbeth", "line_lamp", "cornell_box", "still_life")), ("target", {"white_cd_per_m2": 7}))],
          [5.0, 5.0, 5.0, 5.0, 5.0, 7.0], rtol=5e-6, why="lamps and illuminances of the files are rounded"),
    *(
        Claim(f"light on axis of a matt part: ρ E/(1 + 4 N²(1 + m)²), {parameters}", partial(light_on_axis, quantity, **parameters),
              on_part * CONE, rtol=3e-5, why="the files' lamps have six digits, and the film's cell is 0.03° wide")
        for quantity, on_part, parameters in (
            ("lux", 800.0, {"lux": 800}),
            ("lux", 400.0, {"lux": 800, "reflectance": 0.5}),
            ("lux", 400.0, {"lux": 800, "reflectance": 0.5, "lamp": "spectra/a.spd"}),
            ("lux", 500 * math.pi, {"reflectance": 0.5, "lamp": "spectra/fl11.spd"}),
            ("watts", 2 * math.sqrt(0.5), {"reflectance": 0.4, "lamp": "spectra/led_850nm.spd"}),
            ("watts", 1.0, {"reflectance": 0.4, "lamp": "spectra/led_850nm.spd", "incidence_deg": 60}),
            ("watts", 2.8, {"reflectance": 0.4, "lamp": "spectra/led_940nm.spd", "irradiance_w_per_m2": 7}),
        )
    ),
    *(
        Claim(f"blur disc at {depth_m:g} m, f/{camera.f_number}", partial(blur_um, camera, depth_m),
              disc_um(camera, depth_m), rtol=1e-9, atol=1e-9)
        for camera in (CAMERA, pixsim.Camera(focal_length_mm=50.0, f_number=1.4, object_distance_m=0.8)) for depth_m in (0.05, 0.999, 1.2, 1e6)
    ),
    Claim("half of a Siemens star's disc is dark", lambda: charts.siemens_star(64, 64).mean(),
          1 - 0.975 * np.pi * 0.45**2 / 2, rtol=2e-3, why="512 × 512 points"),
    Claim("a uniform chart has one detail", lambda: rules.Chart(np.ones((2, 2)), (1.0, 1.0), (2, 2)).details, 1.0),
    Claim("no blur in focus", lambda: blur_um(CAMERA, 1.0), 0.0, atol=1e-9),
    Claim("blur at and behind the lens", lambda: [blur_um(CAMERA, z) for z in (0.0, -1.0)], [math.inf] * 2),
    Claim("blur of unknown size", lambda: greatest_blur_um(CAMERA, Body(0, None, None)), math.inf),
    Claim("blur of a deep body is at its near end", lambda: greatest_blur_um(CAMERA, Body(0, np.array([[0.0, 0.0, 0.6], [0.0, 0.0, 1.4]]), None)), disc_um(CAMERA, 0.6), rtol=1e-9),
    Claim("light that a blurred edge moves, 2/(3π)", edge_loss, rules.BLURRED_EDGE, rtol=1e-6, why="midpoint rule"),
    Claim("depth of field, u f²/(f² ± N c (u - f))", lambda: field_m(5.0), [256 / (256 + SPREAD_MM2), 256 / (256 - SPREAD_MM2)], rtol=1e-12),
    Claim("depth of field beyond the hyperfocal distance", lambda: field_m(80.0)[1], math.inf),
    Claim("CSF: 1 lp/mm to the Nyquist frequency of 15 µm, equal ratios",
          lambda: charts.csf_frequency_lp_per_mm([0, 0.5, 1]), [1.0, math.sqrt(1000 / 30), 1000 / 30], rtol=1e-12),
    Claim("CSF: contrast from 25 to 1000 cd/m², and a hundredth", lambda: charts.csf_contrast([0, 0.5, 1]),
          np.array([0.01, 0.1, 1]) * 975 / 1025, rtol=1e-12),
    Claim("CSF on a larger sensor", lambda: charts.csf_frequency_on_sensor(CSF, 2 * charts.DIE_MM)(1.0), 50 / 3, rtol=1e-12),
    Claim("CSF of other scenes and charts has no frequency",
          lambda: [charts.csf_frequency_on_sensor(header, 2.0) is None for header in (
              {"scene": "flat.xml"}, CSF | {"parameters": {"chart": "a.exr"}}, CSF | {"parameters": 3})], [1, 1, 0]),
    Claim("sRGB (IEC 61966-2-1)", lambda: srgb_decoded(np.array([0, 0.04045, 0.5, 1])), [0, 0.0031308, 0.21404, 1], atol=5e-6, why="digits of the standard"),
    Claim("steps that resolve tables", lambda: [Spectrum(np.array(nodes), np.ones(len(nodes))).step_nm for nodes in (
        [380, 385, 390], [531, 532, 533], [400, 500, 500, 600], [631.8, 632.8, 633.8], [400, 400.2, 401],
        [400, 400.19, 401], [532.0, 532.01, 532.02])], [1, 1, 1, 1 / 8, 1 / 8, 1 / 32, 1 / 32]),
    Claim("Wien: a black body of 5000 K is brightest at 579.6 nm",
          lambda: 400 + planck(np.arange(400.0, 800.0), 5000).argmax(), 580.0, atol=1, why="steps of 1 nm"),
    Claim("passes of few pulses", lambda: list(map(len, passes(3) + passes(1))), [2, 1, 1]),
    Claim("lanes of passes", lambda: LANES.lanes, [[0, 1, 0, 1], [2, 2, 2, 2]]),
    Claim("lanes of a pulse share its area", lambda: LANES.shifts, [[0, 0, 0.5, 0.5], [0, 0.25, 0.5, 0.75]]),
    Claim("boards that face the same way do not light each other", lambda: [
        boards((0, 0, -1), (0, 0, -1)), boards((0.6, 0, -0.8), (0.6, 1e-8, -0.8)), boards((0, 0, -1), (0, 0, 1)),
        boards((0, 0, -1), (0, 1e-4, -1)), boards()], [1, 1, 0, 0, 0]),
    Claim("details: photodiodes", lambda: details(FILM, 3.75, 3.75, pixsim.Display(dots=512)), 640.0),
    Claim("details: dots", lambda: details(FILM, 20.0, 20.0, pixsim.Display(dots=512)), 512.0),
    Claim("details: half dots", lambda: details(FILM, 0.5, 0.5, pixsim.Display(dots=512)), 1024.0),
    Claim("details: pixels one to one", lambda: details(FILM, 2.0, 3.0, pixsim.Display(raster="one_to_one")), 1200.0),
    Claim("details: two for each period of 1/(λN)", lambda: details(FILM.model_copy(update={"f_number": 16.0}), 0.5, 0.5, pixsim.Display(dots=512)),
          2 * 2.4 / (550e-6 * 16), rtol=0.01, why="effective f-number"),
    Claim("details: of the chart", lambda: details_across(FILM, 0.5, pixsim.Display(dots=512), 0.5, 90.0)[0], 90.0),
    Claim("a hard clip has no bound", saturation, [1, 0]),
    Claim("a diode is linear to 86 % of its well", lambda: saturation(well_limit="diode"), [0, 1e-6 / 0.857], rtol=1e-2, why="two digits"),
    Claim("a junction bends", lambda: saturation(well_limit="diode", conversion="junction"), [1, 0]),
]  # fmt: skip


@pytest.mark.parametrize("claim", CLAIMS, ids=str)
def test_closed_forms(claim: Claim) -> None:
    claim.check()
