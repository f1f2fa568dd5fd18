"""Copies of the packaged scenes with small edits."""

from pathlib import Path

import pytest

import pixsim
from pixsim.base.arrays import Array
from pixsim.optics.thin_lens import field_factor
from pixsim.scene.packaged import packaged_scenes
from pixsim.scene.plan import Plan, make_render_plan
from pixsim.scene.rules import Decision
from pixsim.scene.scene import Scene
from pixsim.scene.variants import graphics, variant as variants

VARIANT = (
    "scalar_spectral"  # available everywhere, and faster for small images since it compiles nothing
)
FOLDER = packaged_scenes()["csf"].parent
END = "</scene>"
variants.choose()  # must precede the import of Mitsuba
NEEDS_LLVM = pytest.mark.skipif(
    variants.find_llvm()[0] is None, reason="no LLVM 17 or newer here: scalar_spectral only"
)
NO_CARD = graphics.no_card_reason()
NEEDS_CARD = pytest.mark.skipif(NO_CARD is not None, reason=f"no NVIDIA driver here: {NO_CARD}")
NEEDS_NO_CARD = pytest.mark.skipif(NO_CARD is None, reason="an NVIDIA driver is installed here")
VARIANTS = pytest.mark.parametrize(
    "variant", [pytest.param("llvm_ad_spectral", marks=NEEDS_LLVM), VARIANT]
)


def lens_xml(fov_deg: float = 40, aperture_m: float = 0.0005, focus_m: float = 0.8) -> str:
    return (
        f'<float name="fov" value="{fov_deg}"/><float name="aperture_radius"'
        f' value="{aperture_m}"/><float name="focus_distance" value="{focus_m}"/>'
    )


def sensor_xml(
    inside: str | None = None,
    plugin: str = "thinlens",
    name: str = "eye",
    size: tuple[int, int] = (8, 8),
    spp: int = 4,
) -> str:
    """A sensor at the origin that looks along z. inside : lens and place; size : (width, height)"""
    return f"""<sensor type="{plugin}" id="{name}">{lens_xml() if inside is None else inside}
        <sampler type="multijitter"><integer name="sample_count" value="{spp}"/></sampler>
        <film type="hdrfilm"><integer name="width" value="{size[0]}"/>
            <integer name="height" value="{size[1]}"/><rfilter type="box"/></film></sensor>"""


def scene_file(folder: Path, *elements: str) -> Path:
    path = folder / "scene.xml"
    path.write_text(f'<scene version="3.0.0">{"".join(elements)}</scene>', encoding="utf-8")
    return path


def edited(folder: Path, name: str, *edits: tuple[str, str]) -> Path:
    """A copy of a packaged scene with texts replaced; `END` inserts text before "</scene>"."""
    text = (FOLDER / f"{name}.xml").read_text(encoding="utf-8")
    for before, after in edits:
        assert before in text, f"{before!r} is not in {name}.xml"
        text = text.replace(before, after + END if before == END else after, 1)
    for linked in ("charts", "spectra"):
        if not (folder / linked).exists():
            (folder / linked).symlink_to(FOLDER / linked)
    path = folder / f"{name}.xml"
    path.write_text(text, encoding="utf-8")
    return path


def load(path: Path | str, **parameters: object) -> Scene:
    return pixsim.load_scene(path, variant=VARIANT, **parameters)


def render_plan(path: Path | str, **parameters: object) -> Plan:
    return make_render_plan(load(path, **parameters), pixel=pixsim.Pixel())


def lens_sr(image: pixsim.SpectralImage, camera: pixsim.Camera) -> Array:
    """Irradiance over radiance at each sample, (H, W) sr, without the transmittance."""
    return field_factor(
        image.shape, image.pitch_um, camera.image_distance_mm, camera.f_number, camera.magnification
    )


def decision(plan: Plan, subject: str) -> Decision:
    (result,) = (decision for decision in plan.decisions if decision.subject == subject)
    return result


def left_out(plan: Plan) -> set[str]:
    return {decision.subject for decision in plan.decisions if not decision.kept}
