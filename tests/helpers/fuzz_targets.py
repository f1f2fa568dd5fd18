"""Small valid files of each kind that pixsim reads, with their readers: seeds for random
changes.
"""

import struct
import zlib
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np
from hypothesis import strategies as st
from PIL import Image

import pixsim
from pixsim.cli.options import SceneOptions
from pixsim.light.curves import read_curve
from pixsim.light.exr import write_exr
from pixsim.measure.sfr import read_edge_picture
from pixsim.optics.camera import CameraOptions
from pixsim.optics.exchange import read_with_camera, write_npz
from pixsim.report.pictures import picture_axes
from pixsim.scene.charts import write_chart
from pixsim.scene.guard.plugins import PLUGINS, PropertyRule
from pixsim.scene.packaged import packaged_scenes
from pixsim.scene.scene import load_scene
from pixsim.sensor.technology import load_technology
from pixsim.studies.files import load_study
from pixsim.studies.table import COLUMNS, Store

Reader = Callable[[Path], object]
PACKAGE = Path(pixsim.__file__).parent
DATA = Path(__file__).parents[1] / "data"
NM = np.array([450.0, 550.0, 650.0])
CONFIG = """
seed = 3
[camera]
f_number = 2.8
[pixel]
technology = "0.35um"
pitch_um = 8.0
bits = 12
quantum_efficiency = [[400, 0.3], [550, 0.6]]
[display]
dots = 64
"""
SCENE = """<scene version="3.0.0">
<!-- a chart -->
<default name="spp" value="4"/><default name="scale" value="1"/>
<integrator type="path"><integer name="max_depth" value="2"/></integrator>
<sensor type="thinlens" id="eye"><float name="fov" value="40"/><float name="aperture_radius" value="0.0005"/>
<float name="focus_distance" value="0.8"/><transform name="to_world"><lookat origin="0,0,0" target="0,0,1" up="0,1,0"/></transform>
<sampler type="multijitter"><integer name="sample_count" value="$spp"/></sampler>
<film type="hdrfilm"><integer name="width" value="16"/><integer name="height" value="16"/><rfilter type="box"/></film></sensor>
<bsdf type="diffuse" id="grey"><spectrum name="reflectance" value="400:0.2, 700:0.4"/></bsdf>
<include filename="part.xml"/>
<shape type="rectangle"><ref id="grey"/><transform name="to_world"><scale x="$scale" y="$scale"/><translate z="1"/></transform>
<emitter type="area"><texture type="d65" name="radiance"><float name="scale" value="0.01"/>
<texture type="bitmap" name="texture"><string name="filename" value="chart.exr"/><boolean name="raw" value="true"/>
<transform name="to_uv"><scale y="-1"/></transform></texture></texture></emitter></shape></scene>
"""
ENVI = (
    "ENVI\nsamples = 5\nlines = 4\nbands = 3\nheader offset = 0\nfile type = ENVI Standard\ndata"
    " type = 4\ninterleave = bsq\nbyte order = 0\nwavelength units = Nanometers\nwavelength = {450,"
    " 550, 650}\nfwhm = {9, 9, 9}\ndata units = W.m^-2.nm^-1\npitch_um = 5\n"
)


def light(factored: bool = False) -> pixsim.SpectralImage:
    values = np.random.default_rng(1).uniform(0.1, 1.0, (4, 5, 3)).astype(np.float32)
    content = (
        {"factors": (np.ones((1, 3)), values[:, :, :1].transpose(2, 0, 1))}
        if factored
        else {"data": values}
    )
    header = {
        "scene": "a.xml",
        "camera": pixsim.Camera().model_dump(),
        "parameters": {},
        "luminance_cd_per_m2": 100.0,
    }
    return pixsim.SpectralImage(NM, 10.0, 5.0, header=header, **content)


def rows(path: Path) -> None:
    Store(path).write([f"key{n}", "0.35um", *["1.5"] * (len(COLUMNS) - 2)] for n in range(3))


def read_rows(path: Path) -> object:
    results = Store(path)
    results.read_keys()
    return results.resume(lambda row: row["key"] == "key1" and float(row["pitch_um"]) == 1.5)


def read_picture(path: Path) -> object:
    image, camera = read_with_camera(path, CameraOptions(), None)
    picture_axes(image)
    return image, camera


def seeds(folder: Path) -> dict[str, tuple[Path, Reader]]:
    """Kind -> a valid file and its reader."""
    shipped = packaged_scenes()["still_life"]
    load = partial(load_scene, variant="scalar_spectral")
    texts: dict[str, tuple[str, Reader]] = {
        "config.toml": (CONFIG, lambda path: SceneOptions([path]).settings()),
        "study.toml": ((PACKAGE / "data/studies/modern.toml").read_text(), load_study),
        "technology.toml": (
            (PACKAGE / "data/technologies/0.35um.toml").read_text(),
            lambda path: load_technology(str(path)),
        ),
        "lens.toml": (
            (PACKAGE / "data/lenses/phone.toml").read_text(),
            lambda path: pixsim.load_lens(str(path)),
        ),
        "lens.zmx": (
            (DATA / "lenses/US00583336-2-scaled.zmx").read_text(),
            lambda path: pixsim.load_lens(str(path)),
        ),
        "curve.csv": ("nm,qe\n400,0.1\n500,0.5\n600,0.4\n", read_curve),
        "scene.xml": (SCENE, load),
        "shipped.xml": (
            shipped.read_text().replace('"spectra/', f'"{shipped.parent}/spectra/'),
            load,
        ),
        "cube.hdr": (ENVI, read_picture),
    }
    for name, (text, _) in texts.items():
        (folder / name).write_text(text, encoding="utf-8")
    part = (
        '<scene version="3.0.0"><shape type="sphere"><float name="radius"'
        ' value="0.01"/></shape></scene>'
    )
    (folder / "part.xml").write_text(part, encoding="utf-8")
    light().data.transpose(2, 0, 1).tofile(folder / "cube.img")
    write_chart(folder / "chart.exr", np.ones((4, 4), np.float32))
    write_exr(folder / "light.exr", light())
    write_exr(folder / "factors.exr", light(factored=True))
    write_npz(folder / "light.npz", light())
    np.save(folder / "edge.npy", np.ones((4, 4)))
    Image.fromarray(np.ones((8, 8), np.uint16)).save(folder / "edge.png")
    np.savez_compressed(
        folder / "raw.npz", dn=np.ones((4, 4), np.uint16), black_level_dn=1.0, bits=10
    )
    rows(folder / "results.csv")
    readers: dict[str, Reader] = {name: reader for name, (_, reader) in texts.items()}
    readers |= dict.fromkeys(("light.exr", "factors.exr", "light.npz"), read_picture)
    readers |= dict.fromkeys(("chart.exr", "edge.npy", "edge.png"), read_edge_picture) | {
        "results.csv": read_rows
    }
    readers |= {"raw.npz": pixsim.read_frame}
    return {name: (folder / name, reader) for name, reader in readers.items()}


def changed(content: bytes, changes: list[tuple[float, bytes]], end: float, repeated: int) -> bytes:
    """Overwrite bytes at relative positions from 0 to 1, truncate at `end`, and repeat the
    middle.
    """
    work = bytearray(content)
    for place, new in changes:
        at = int(place * len(work))
        work[at : at + len(new)] = new
    work = work[: int(end * len(work)) or 1]
    return bytes(work + work[len(work) // 3 : 2 * len(work) // 3] * repeated)


# --- Scenes and meshes for `test_hostile_scenes`
# -------------------------------------------------------------------------------

TRIANGLES = np.array([(3, (0, 1, 2)), (3, (1, 2, 3))], [("n", "u1"), ("corners", "<i4", 3)])
POSITIONS = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0.5]], "<f4")
PLY = (
    b"ply\nformat binary_little_endian 1.0\nelement vertex 4\nproperty float x\nproperty float"
    b" y\nproperty float z\nelement face 2\nproperty list uchar int vertex_indices\nend_header\n"
    + POSITIONS.tobytes()
    + TRIANGLES.tobytes()
)
SERIALIZED = (
    struct.pack("<HH", 0x041C, 4)
    + zlib.compress(
        struct.pack("<I", 0x1000)
        + b"name\0"
        + struct.pack("<QQ", 4, 2)
        + POSITIONS.tobytes()
        + TRIANGLES["corners"].tobytes()
    )
    + struct.pack("<QI", 0, 1)
)
ODD_NUMBERS = [
    "0",
    "1",
    "-1",
    "0.5",
    "2",
    "1e-3",
    "400:0.1, 700:0.2",
    "1 0 0",
    "1, 2, 3",
    "nan",
    "1e400",
    "1e-310",
    "9" * 30,
    "x",
    "",
]
TAGS = [
    "float",
    "integer",
    "string",
    "boolean",
    "spectrum",
    "rgb",
    "point",
    "vector",
    "transform",
    "ref",
    "texture",
    "bdsf",
]
STEPS = [
    '<scale value="2"/>',
    '<rotate y="1" angle="30"/>',
    '<translate x="1"/>',
    '<matrix value="1"/>',
    '<lookat origin="0 0 0"/>',
]
RIGHT = {
    "float": "1", "integer": "2", "boolean": "true", "spectrum": "400:0.1, 700:0.2", "rgb": "0.1, 0.2, 0.3", "point": "1, 2, 3",
    "vector": "0 0 1", "string": "1, 2",
}  # fmt: skip


@st.composite
def random_scene(draw: st.DrawFn) -> str:
    """The body of a scene: elements of the allowed plugins, mostly with properties that they may
    have.
    """
    return "".join(
        draw(_element(draw(st.sampled_from(["shape", "bsdf", "emitter", "medium", "texture"]))))
        for _ in range(2)
    )


@st.composite
def _element(draw: st.DrawFn, kind: str, name: str = "", deep: int = 0) -> str:
    plugin, content = draw(st.sampled_from(sorted(PLUGINS[kind].items())))
    named = f' name="{name}"' if name else ""
    if draw(st.integers(0, 15)) == 0:
        plugin = draw(st.sampled_from(["../x", "blender", "", "scene", "a" * 999]))
    names = (
        st.lists(st.sampled_from(sorted(content.properties)), max_size=3, unique=True)
        if content.properties
        else st.just([])
    )
    needed = content.properties.keys() & {"filename", *content.needs}
    inside = [
        draw(_property(content.properties[each], each, deep)) for each in {*needed, *draw(names)}
    ]
    if content.holds and deep < 4:
        inside += [
            draw(_element(draw(st.sampled_from(content.holds)), deep=deep + 1))
            for _ in range(draw(st.integers(0, 2)))
        ]
    return f'<{kind} type="{plugin}"{named}>{"".join(inside)}</{kind}>'


@st.composite
def _property(draw: st.DrawFn, rule: PropertyRule, name: str, deep: int) -> str:
    if rule.kinds and deep < 4 and draw(st.booleans()):
        return str(draw(_element(draw(st.sampled_from(rule.kinds)), name, deep + 1)))
    right = draw(st.integers(0, 19)) > 0
    tag = draw(st.sampled_from(rule.tags if right and rule.tags else TAGS))
    if tag == "transform":
        return (
            "<transform"
            f' name="{name}">{draw(st.sampled_from(STEPS[: 3 if right else None]))}</transform>'
        )
    value = RIGHT.get(tag, "1") if right else draw(st.sampled_from(ODD_NUMBERS))
    if right and tag == "string":
        files = {"texture": "chart.exr", "mesh": "a.ply", "volume": "a.vol", "metal": "Au"}
        value = files[rule.file] if rule.file else "vertex_c" if name == "name" else "1.5"
    return f'<{tag} name="{name}" value="{value}"/>'
