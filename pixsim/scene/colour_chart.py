"""The contrast-sensitivity chart in colour: a change of colour in place of luminance, as a scene
with three slide projectors.

Mitsuba has no lamp whose texture and spectrum are both free, but for the spot: each primary of a
display shines through a slide onto a white screen that fills the die. So the light is three spectra
times three pictures. The projectors stand so far away that light on the screen is uniform to 4e-4.
"""

from __future__ import annotations

import math
import os
from collections.abc import Sequence
from contextlib import ExitStack
from functools import lru_cache
from importlib import resources
from pathlib import Path
from typing import Any
from xml.sax.saxutils import quoteattr

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pixsim.base.arrays import Array
from pixsim.base.errors import invalid
from pixsim.base.files import replacing, resolved
from pixsim.light.exr import fill_channels, writing
from pixsim.light.spectral import LUMINOUS_EFFICACY_LM_PER_W, colour_matching, d65, grid_nm
from pixsim.light.standard import OPPONENT_FROM_XYZ, XYZ_FROM_OPPONENT
from pixsim.optics.quantities import DieWidth
from pixsim.scene.charts import LUMINANCE_CD_PER_M2, Side, csf_contrast, make_chart

PRIMARIES = ("red", "green", "blue")
# Of each slide, as in the grey chart.
MEAN = sum(LUMINANCE_CD_PER_M2) / (2 * LUMINANCE_CD_PER_M2[1])
PROJECTOR_M = 30.0  # from the screen
_BEAM = 1.5  # half width of a slide over half width of the screen, whose corners are at √2
SCENE = """<!-- {title}
     Three projectors shine the primaries of a display through slides onto a white screen; all
     slides at 1 are D65 of 1000 cd/m2. The camera looks along +z, up is +y. Row 0 of a slide is
     up and column 0 is left. pixsim sets the parameters of the camera and of the screen, so that
     the chart fills the die. Made by pixsim chart. -->
<scene version="3.0.0">
    <default name="white_cd_per_m2" value="{white_cd_per_m2:g}"/>
    <default name="white_lamps" value="{white_lamps}"/>
    <default name="chart_half_width" value="0.350145791"/>
    <default name="chart_half_height" value="0.350145791"/>
    <default name="resolution" value="1024"/>
    <default name="spp" value="16"/>
    <default name="fov" value="38.594975"/>
    <default name="aperture_radius" value="0.0004825"/>
    <default name="focus_distance" value="1"/>

    <integrator type="path">
        <integer name="max_depth" value="2"/>
    </integrator>

    <sensor type="thinlens" id="camera">
        <float name="fov" value="$fov"/>
        <float name="aperture_radius" value="$aperture_radius"/>
        <float name="focus_distance" value="$focus_distance"/>
        <transform name="to_world">
            <lookat origin="0, 0, 0" target="0, 0, 1" up="0, 1, 0"/>
        </transform>
        <sampler type="multijitter">
            <integer name="sample_count" value="$spp"/>
        </sampler>
        <film type="hdrfilm">
            <integer name="width" value="$resolution"/>
            <integer name="height" value="$resolution"/>
            <string name="pixel_format" value="luminance"/>
            <rfilter type="box"/>
        </film>
    </sensor>

    <shape type="rectangle" id="screen">
        <transform name="to_world">
            <scale x="$chart_half_width" y="$chart_half_height"/>
            <rotate y="1" angle="180"/>
            <translate z="$focus_distance"/>
        </transform>
        <bsdf type="diffuse">
            <spectrum name="reflectance" value="1"/>
        </bsdf>
    </shape>
{projectors}
</scene>
"""
_PROJECTOR = """
    <emitter type="spot" id="{name}">
        <transform name="to_world">
            <scale x="$chart_half_width" y="$chart_half_height"/>
            <translate z="-{distance:g}"/>
            <translate z="$focus_distance"/>
        </transform>
        <spectrum name="intensity" value="{intensity}"/>
        <float name="cutoff_angle" value="{cutoff_deg:.9g}"/>
        <float name="beam_width" value="{beam_deg:.9g}"/>
        <texture type="bitmap" name="texture">
            <string name="filename" value={slide}/>
            <boolean name="raw" value="true"/>
            <string name="wrap_mode" value="clamp"/>
            <transform name="to_uv">
                <scale x="-{beam:g}" y="-{beam:g}"/>
                <translate x="{centre:g}" y="{centre:g}"/>
            </transform>
        </texture>
    </emitter>"""


@lru_cache
def primaries() -> tuple[Array, Array]:
    """Return wavelengths in nm, (B,), and the radiance of the primaries at full power, (B, 3) W m⁻²
    sr⁻¹ nm⁻¹.

    Their sum has the chromaticity of D65 and 1000 cd/m².
    """
    path = str(resources.files("pixsim") / "data/display_primaries.csv")
    table = np.loadtxt(path, delimiter=",", skiprows=3)
    table_nm = table[:, 0]
    powers = table[:, 1:]

    nm = grid_nm()
    observer = colour_matching(grid_nm())
    xyz = [np.interp(nm, table_nm, power, left=0.0, right=0.0) @ observer for power in powers.T]
    white = d65(nm) @ observer
    white *= LUMINANCE_CD_PER_M2[1] / (LUMINOUS_EFFICACY_LM_PER_W * white[1])
    return table_nm, powers * np.linalg.solve(np.stack(xyz, axis=1), white)


def primaries_xyz() -> Array:
    """Return the XYZ of the primaries at full power, (3, 3), a column each, with Y of 1 for their
    sum.
    """
    nm, radiance = primaries()
    xyz = np.stack(
        [np.interp(grid_nm(), nm, power) @ colour_matching(grid_nm()) for power in radiance.T],
        axis=1,
    )
    return xyz / xyz[1].sum()


def modulation(change_xyz: ArrayLike) -> Array:
    """Return the change of each primary, over the largest of these changes, along a change of
    XYZ; both (3,).

    change_xyz : not 0, in any unit; its sign counts
    """
    shares = np.linalg.solve(primaries_xyz(), np.asarray(change_xyz, float))
    return np.asarray(shares / np.abs(shares).max())


def slide(share: float, grey: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return the slide of a primary, (H, W), whose contrast is `share`, -1 to 1, times the
    contrast of the grey chart (H, W).
    """
    return (MEAN + share * (grey.astype(float) - MEAN)).astype(np.float32)


def write_colour_chart(
    path: str | os.PathLike[str],
    shares: Array,
    title: str,
    width: Side | None = None,
    height: Side | None = None,
    die_mm: DieWidth | None = None,
) -> Sequence[Path]:
    """Write the CSF chart as a scene, `path`, with a slide of each primary beside it, and return
    the paths of the slides.

    path : ends in .xml
    shares : change of each primary where the grey chart changes luminance (`modulation`)
    title : of the scene, a comment in it: without two hyphens together
    width, height, die_mm : of `make_chart`

    Raises PixsimError for another ending, a name that Mitsuba would read as a parameter, a size
    outside 2 to 32768 texels, and where a file cannot be written.
    """
    path = Path(path)
    if path.suffix.lower() != ".xml":
        raise invalid(
            "colour chart",
            f"'{path}'",
            "a scene file, whose name ends in .xml",
            "pixsim writes its slides next to it.",
        )
    if "$" in path.name:
        allowed = "a name without $, which begins a parameter of a scene"
        raise invalid("colour chart", f"'{path}'", allowed)

    grey = make_chart("csf", width, height, die_mm)
    scene_file = resolved(path)
    slides = [scene_file.with_name(f"{path.stem}_{name}.exr") for name in PRIMARIES]
    text = SCENE.format(
        title=title,
        white_cd_per_m2=LUMINANCE_CD_PER_M2[1],
        white_lamps=", ".join(PRIMARIES),
        projectors="\n".join(_projectors(slides)),
    )
    try:
        # All files are finished before the first one moves; the scene, the first one here, moves
        # last.
        with ExitStack() as files:
            scene_target = files.enter_context(replacing(path))
            scene_target.write_bytes(text.encode("ascii", "xmlcharrefreplace"))
            for share, file in zip(shares.tolist(), slides, strict=True):
                slide_target = files.enter_context(writing(file, named=False))
                fill_channels(slide_target, {"Y": slide(share, grey)}, {})
    except OSError as error:
        got = f"'{path}' ({error.strerror or error})"
        raise invalid("output file", got, "a path that can be written") from None
    return slides


def _projectors(slides: Sequence[Path]) -> list[str]:
    """Return the XML of a projector for each slide."""
    nm, radiance = primaries()
    # Of a screen that reflects all light: L = E/π, E = I/r².
    intensities = math.pi * PROJECTOR_M**2 * radiance
    cutoff_deg = math.degrees(math.atan(_BEAM / PROJECTOR_M))
    projectors = []
    for name, file, intensity in zip(PRIMARIES, slides, intensities.T, strict=True):
        pairs = [f"{at:g}:{value:.6g}" for at, value in zip(nm, intensity, strict=True)]
        projectors.append(
            _PROJECTOR.format(
                name=name,
                distance=PROJECTOR_M,
                intensity=", ".join(pairs),
                cutoff_deg=cutoff_deg,
                beam_deg=0.999 * cutoff_deg,
                slide=quoteattr(file.name),
                beam=_BEAM,
                centre=(1 + _BEAM) / 2,
            )
        )
    return projectors


def write_colour_axis(
    axis: str, output: Path, width: int | None, height: int | None, die_mm: float | None
) -> dict[str, Any]:
    """Write the CSF chart that changes one opponent channel of S-CIELAB, and return its files and
    contrasts, for JSON.

    axis : red-green or blue-yellow
    """
    # The channels are positive for green and for blue.
    channel, sign = {"red-green": (1, -1), "blue-yellow": (2, 1)}[axis]
    shares = modulation(sign * XYZ_FROM_OPPONENT[:, channel])
    title = f"The contrast-sensitivity chart of Chen et al. (2000), {axis} at constant luminance."
    slides = write_colour_chart(output, shares, title, width, height, die_mm)

    # Michelson contrast of each slide where the chart's contrast is largest; negative where it
    # falls as the first rises.
    contrasts = dict(zip(PRIMARIES, (shares * float(csf_contrast(1.0))).tolist(), strict=True))
    largest = max(map(abs, contrasts.values()))
    opponent = OPPONENT_FROM_XYZ @ (primaries_xyz() @ shares * MEAN * largest)
    white = OPPONENT_FROM_XYZ[0] @ primaries_xyz().sum(axis=1)
    return {
        "file": str(output),
        "kind": "csf",
        "colour_axis": axis,
        "slides": [path.name for path in slides],
        "contrasts": contrasts,
        "opponent_amplitude": abs(float(opponent[channel] / white)),
    }
