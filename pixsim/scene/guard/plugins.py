"""The plugins of Mitsuba 3.9 that a scene may use, with the types and bounds of their properties.

What is not here is refused before Mitsuba sees it: plugins that pixsim cannot inspect (raw pointers, files of unknown layout,
polarisation), names that would make Mitsuba load another file, and values that would crash it or keep it busy without an end.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

from pixsim.scene.textures import METAL_BY_NAME

LARGEST = 1e30  # of any number: float32 ends at 3.4e38
SMALLEST = 1e-30  # of a spectrum or a scale that is not 0: below 1e-38 float32 has no full digits, and each operation is slow
LIGHT_NM = (1.0, 1e5)
MAX_DEPTH_OF_PATHS = 1 << 16
MAX_ROULETTE = 256  # surfaces that light may meet before Russian roulette ends its path
MAX_SAMPLES = 1 << 20
MAX_SIDE = 16384  # samples of a film
WHOLE_TAGS, NUMBER_TAGS = ("integer",), ("float", "integer")
COLOUR_TAGS = (*NUMBER_TAGS, "spectrum", "rgb")
# Elements of each kind in a scene, or of one plugin. A lamp may need a render of its own.
MAX_ELEMENTS = {"emitter": 512, "sensor": 64, "medium": 256, "volume": 256, "phase": 256, "integrator": 8}
# Mitsuba compiles each instance for itself, in a time that grows with the square of their number.
MAX_ELEMENTS |= {"instance": 512}
MAX_ELEMENTS |= dict.fromkeys(("shape", "bsdf", "texture", "film", "sampler", "rfilter"), 4096)


@dataclass(frozen=True)
class Allowed:
    """What a property may be.

    tags : elements that state it
    low, high : bounds of its numbers
    smallest : magnitude of the smallest number that is not 0
    words : the values of a string; None for any that `pattern` matches
    kinds : plugins that it may be, besides
    rgb_of_surface : each number of an <rgb> is from 0 to 1, as Mitsuba has it where it makes a reflectance of them
    is_share : a share of the light, as a reflectance is: numbers above 1 are warned of, and those above 1.5 refused
    file : kind of the file that it names: picture, mesh, volume; or metal, a table of Mitsuba's own
    instead : what to write in place of an element that is not allowed
    """

    tags: tuple[str, ...]
    low: float = -LARGEST
    high: float = LARGEST
    smallest: float = 0.0
    words: tuple[str, ...] | None = None
    pattern: str | None = None
    kinds: tuple[str, ...] = ()
    file: str | None = None
    rgb_of_surface: bool = False
    is_share: bool = False
    instead: str = ""


@dataclass(frozen=True)
class Plugin:
    """The properties of a plugin, those that it needs, and the kinds of plugins that it may hold under any name."""

    properties: dict[str, Allowed] = field(default_factory=dict)
    needs: tuple[str, ...] = ()
    holds: tuple[str, ...] = ()


def number(low: float = -LARGEST, high: float = LARGEST) -> Allowed:
    return Allowed(NUMBER_TAGS, low, high)


def whole(low: int, high: int) -> Allowed:
    return Allowed(WHOLE_TAGS, low, high)


def words(*names: str) -> Allowed:
    return Allowed(("string",), words=names)


def file(kind: str) -> Allowed:
    return Allowed(("string",), file=kind)


SCALE = Allowed(NUMBER_TAGS, smallest=SMALLEST)
FLAG = Allowed(("boolean",))
TRANSFORM = Allowed(("transform",))
PLACE = Allowed(("point", "vector"))
COLOUR = Allowed(COLOUR_TAGS, smallest=SMALLEST, kinds=("texture",))
SURFACE = replace(COLOUR, rgb_of_surface=True)
SHARE = replace(SURFACE, is_share=True)
NUMBERS = Allowed(("string",), smallest=SMALLEST, pattern="numbers")
# A spectrum is refused later, with its reason: Mitsuba has one index for all wavelengths.
INDEX = Allowed(("string", *COLOUR_TAGS), 0, 1e3, pattern=r"[\w .+-]{1,64}", kinds=("texture",))
VOLUME = Allowed(COLOUR_TAGS, 0, smallest=SMALLEST, kinds=("volume",))
METAL = Allowed(("string",), file="metal")


def more(properties: dict[str, Allowed], *lists: dict[str, Allowed]) -> dict[str, Allowed]:
    """Return the properties with those of the other lists."""
    return {name: rule for each in (properties, *lists) for name, rule in each.items()}


OF_EMITTERS = {"sampling_weight": number(0, 1e6), "to_world": TRANSFORM}
OF_SHAPES = {"to_world": TRANSFORM, "flip_normals": FLAG, "silhouette_sampling_weight": number(0, 1e6)}
OF_MESHES = more(OF_SHAPES, {"filename": file("mesh"), "face_normals": FLAG, "flip_tex_coords": FLAG})
OF_INTEGRATORS = {
    "max_depth": whole(-1, MAX_DEPTH_OF_PATHS), "rr_depth": whole(1, MAX_ROULETTE), "hide_emitters": FLAG,
    "block_size": whole(0, 4096), "samples_per_pass": whole(1, MAX_SAMPLES), "timeout": number(-1, 1e9),
}  # fmt: skip
OF_SENSORS = {
    "to_world": TRANSFORM, "near_clip": number(0), "far_clip": number(0), "shutter_open": number(), "shutter_close": number(),
}  # fmt: skip
OF_LENSES = more(
    OF_SENSORS,
    {
        "fov": number(), "fov_axis": words("x", "y", "diagonal", "smaller", "larger"),
        "focal_length": Allowed(("string",), pattern=r"\d{1,9}(\.\d{1,9})?(mm)?"),
        "principal_point_offset_x": number(), "principal_point_offset_y": number(),
    },
)  # fmt: skip
OF_THIN_LENSES = more(OF_LENSES, {"aperture_radius": number(), "focus_distance": number()})
OF_SAMPLERS = {"sample_count": whole(1, MAX_SAMPLES), "seed": whole(0, 2**32 - 1)}
OF_FILMS = {
    "width": whole(1, MAX_SIDE), "height": whole(1, MAX_SIDE), "sample_border": FLAG, "compensate": FLAG, "banner": FLAG,
    **{f"crop_{name}": whole(0, MAX_SIDE) for name in ("width", "height", "offset_x", "offset_y")},
    "component_format": words("float16", "float32", "uint32"),
}  # fmt: skip
OF_PICTURES = {
    "filename": file("picture"), "filter_type": words("nearest", "bilinear"), "wrap_mode": words("repeat", "mirror", "clamp"),
    "format": words("auto", "variant", "fp16"), "raw": FLAG, "accel": FLAG, "to_uv": TRANSFORM,
}  # fmt: skip
OF_TABLES = {"wavelength_min": number(*LIGHT_NM), "wavelength_max": number(*LIGHT_NM)}
OF_DIELECTRICS = {
    "int_ior": INDEX, "ext_ior": INDEX, "specular_reflectance": SHARE, "specular_transmittance": SHARE,
}  # fmt: skip
OF_ROUGH = {
    "alpha": COLOUR, "alpha_u": COLOUR, "alpha_v": COLOUR, "distribution": words("beckmann", "ggx"), "sample_visible": FLAG,
}  # fmt: skip
INDEX_OF_METAL = replace(COLOUR, tags=(*NUMBER_TAGS, "spectrum"), instead=METAL_BY_NAME)
OF_METALS = {"material": METAL, "eta": INDEX_OF_METAL, "k": INDEX_OF_METAL, "specular_reflectance": SHARE}
OF_PLASTICS = {
    "diffuse_reflectance": SHARE, "specular_reflectance": SHARE, "int_ior": INDEX, "ext_ior": INDEX, "nonlinear": FLAG,
}  # fmt: skip
OF_PRINCIPLED = {
    "base_color": SHARE,
    **dict.fromkeys(("roughness", "anisotropic", "spec_trans", "spec_tint", "sheen", "sheen_tint"), SURFACE),
    "flatness": SURFACE, "eta": number(0, 1e3), "diffuse_reflectance_sampling_rate": number(0, 1e6),
}  # fmt: skip
OF_MEDIA = {
    "albedo": replace(VOLUME, high=1.0), "sigma_t": replace(VOLUME, high=1e9), "scale": Allowed(NUMBER_TAGS, 0, 1e9, SMALLEST),
    "sample_emitters": FLAG, "has_spectral_extinction": FLAG,
}  # fmt: skip
OF_MAPS = {"use_shadowing_function": FLAG, "flip_invalid_normals": FLAG}
IN_SHAPES = ("bsdf", "emitter", "medium", "texture")
PATH = Plugin(OF_INTEGRATORS)
ANY_KIND = (
    "sensor", "film", "sampler", "rfilter", "integrator", "emitter", "shape", "bsdf", "texture", "medium", "phase", "volume",
)  # fmt: skip

# Kind -> name -> plugin.
PLUGINS: dict[str, dict[str, Plugin]] = {
    "scene": {"scene": Plugin({"embree_use_robust_intersections": FLAG}, holds=ANY_KIND)},
    "sensor": {
        "thinlens": Plugin(OF_THIN_LENSES, holds=("film", "sampler", "medium")),
        "perspective": Plugin(OF_THIN_LENSES, holds=("film", "sampler", "medium")),
        "orthographic": Plugin(OF_SENSORS, holds=("film", "sampler", "medium")),
    },
    "film": {
        "hdrfilm": Plugin(
            more(
                OF_FILMS,
                {
                    "file_format": words("openexr", "exr", "rgbe", "pfm"),
                    "pixel_format": words("luminance", "luminance_alpha", "rgb", "rgba", "xyz", "xyza"),
                },
            ),
            holds=("rfilter",),
        ),
        "specfilm": Plugin(OF_FILMS, holds=("rfilter", "texture")),
    },
    "sampler": {
        **dict.fromkeys(("independent", "ldsampler"), Plugin(OF_SAMPLERS)),
        **dict.fromkeys(("stratified", "multijitter"), Plugin(more(OF_SAMPLERS, {"jitter": FLAG}))),
        "orthogonal": Plugin(more(OF_SAMPLERS, {"jitter": FLAG, "strength": whole(2, 8)})),
    },
    "rfilter": {
        **dict.fromkeys(("box", "catmullrom"), Plugin()),
        "tent": Plugin({"radius": number(1e-3, 64)}),
        "gaussian": Plugin({"stddev": number(1e-3, 16)}),
        "mitchell": Plugin({name: number(-1e3, 1e3) for name in ("A", "B", "C")}),
        "lanczos": Plugin({"lobes": whole(1, 32)}),
    },
    "integrator": {
        **dict.fromkeys(("path", "volpath", "volpathmis", "prb", "prbvolpath"), PATH),
        "direct": Plugin(
            more(OF_INTEGRATORS, {name: whole(0, 4096) for name in ("shading_samples", "emitter_samples", "bsdf_samples")})
        ),
    },
    "emitter": {
        **dict.fromkeys(("area", "constant", "directionalarea"), Plugin(more(OF_EMITTERS, {"radiance": COLOUR}))),
        "directional": Plugin(more(OF_EMITTERS, {"irradiance": COLOUR, "direction": PLACE})),
        "point": Plugin(more(OF_EMITTERS, {"intensity": COLOUR, "position": PLACE})),
        "spot": Plugin(
            more(
                OF_EMITTERS,
                {"intensity": COLOUR, "cutoff_angle": number(1e-3, 180), "beam_width": number(0, 180), "texture": COLOUR},
            )
        ),
        "projector": Plugin(more(OF_EMITTERS, OF_LENSES, {"irradiance": COLOUR, "scale": SCALE}), holds=("texture",)),
        "envmap": Plugin(
            more(OF_EMITTERS, {"filename": file("picture"), "scale": SCALE, "mis_compensation": FLAG}), needs=("filename",)
        ),
        "sunsky": Plugin(
            more(
                OF_EMITTERS,
                {
                    "turbidity": number(1, 10), "albedo": Allowed(COLOUR_TAGS, 0, 1, SMALLEST, kinds=("texture",)),
                    "latitude": number(-90, 90), "longitude": number(-180, 180), "timezone": number(-24, 24),
                    "year": whole(1, 9999), "month": whole(1, 12), "day": whole(1, 31), "hour": number(0, 24),
                    "minute": number(0, 60), "second": number(0, 60), "sun_direction": PLACE, "sun_scale": SCALE,
                    "sky_scale": SCALE, "sun_aperture": number(0.01, 90), "complex_sun": FLAG,
                },
            )
        ),
    },
    "shape": {
        "sphere": Plugin(more(OF_SHAPES, {"center": PLACE, "radius": number()}), holds=IN_SHAPES),
        "cylinder": Plugin(more(OF_SHAPES, {"p0": PLACE, "p1": PLACE, "radius": number()}), holds=IN_SHAPES),
        **dict.fromkeys(("rectangle", "disk"), Plugin(OF_SHAPES, holds=IN_SHAPES)),
        "cube": Plugin(more(OF_SHAPES, {"face_normals": FLAG}), holds=IN_SHAPES),
        **dict.fromkeys(("ply", "obj"), Plugin(OF_MESHES, needs=("filename",), holds=IN_SHAPES)),
        "serialized": Plugin(more(OF_MESHES, {"shape_index": whole(0, 1 << 20)}), needs=("filename",), holds=IN_SHAPES),
        "shapegroup": Plugin(holds=("shape",)),
        "instance": Plugin({"to_world": TRANSFORM}, holds=("shape",)),
    },
    "bsdf": {
        "diffuse": Plugin({"reflectance": SHARE}),
        **dict.fromkeys(("dielectric", "thindielectric"), Plugin(OF_DIELECTRICS)),
        "roughdielectric": Plugin(more(OF_DIELECTRICS, OF_ROUGH)),
        "conductor": Plugin(OF_METALS),
        "roughconductor": Plugin(more(OF_METALS, OF_ROUGH)),
        "plastic": Plugin(OF_PLASTICS),
        "roughplastic": Plugin(more(OF_PLASTICS, OF_ROUGH)),
        "principled": Plugin(
            more(
                OF_PRINCIPLED,
                dict.fromkeys(("metallic", "clearcoat", "clearcoat_gloss"), SURFACE),
                {
                    "specular": number(0, 1e3), "main_specular_sampling_rate": number(0, 1e6),
                    "clearcoat_sampling_rate": number(0, 1e6),
                },
            )
        ),
        "principledthin": Plugin(
            more(
                OF_PRINCIPLED,
                {"diff_trans": replace(SURFACE, low=0, high=2)},
                {f"{name}_sampling_rate": number(0, 1e6) for name in ("specular_reflectance", "specular_transmittance")},
                {"diffuse_transmittance_sampling_rate": number(0, 1e6)},
            )
        ),
        "twosided": Plugin(holds=("bsdf",)),
        "mask": Plugin({"opacity": SURFACE}, holds=("bsdf",)),
        "blendbsdf": Plugin({"weight": SURFACE}, holds=("bsdf",)),
        "bumpmap": Plugin(more(OF_MAPS, {"scale": SCALE}), holds=("bsdf", "texture")),
        "normalmap": Plugin(more(OF_MAPS, {"normalmap": COLOUR}), holds=("bsdf", "texture")),
        "null": Plugin(),
    },
    "texture": {
        "bitmap": Plugin(OF_PICTURES, needs=("filename",)),
        "checkerboard": Plugin({"color0": SURFACE, "color1": SURFACE, "to_uv": TRANSFORM}),
        "mesh_attribute": Plugin(
            {"name": Allowed(("string",), pattern=r"(vertex|face)_\w{1,64}"), "scale": SCALE}, needs=("name",)
        ),
        "volume": Plugin(holds=("volume",)),
        "uniform": Plugin(more(OF_TABLES, {"value": SCALE})),
        "regular": Plugin(more(OF_TABLES, {"values": NUMBERS, "range": replace(NUMBERS, low=LIGHT_NM[0], high=LIGHT_NM[1])})),
        "irregular": Plugin({"wavelengths": replace(NUMBERS, low=LIGHT_NM[0], high=LIGHT_NM[1]), "values": NUMBERS}),
        "d65": Plugin({"scale": SCALE, "color": Allowed(("rgb",), smallest=SMALLEST)}, holds=("texture",)),
        "blackbody": Plugin(more(OF_TABLES, {"temperature": number(1, 1e7)})),
        "srgb": Plugin({"color": Allowed(("rgb",), smallest=SMALLEST, rgb_of_surface=True)}),
    },
    "medium": {
        "homogeneous": Plugin(OF_MEDIA, holds=("phase",)),
        "heterogeneous": Plugin(OF_MEDIA, holds=("phase",)),
    },
    "phase": {
        **dict.fromkeys(("isotropic", "rayleigh"), Plugin()),
        "hg": Plugin({"g": number(-0.999, 0.999)}),
        "blendphase": Plugin({"weight": VOLUME}, holds=("phase", "volume")),
    },
    "volume": {
        "constvolume": Plugin({"value": replace(COLOUR, low=0)}),
        "gridvolume": Plugin(
            more(
                {name: rule for name, rule in OF_PICTURES.items() if name in ("wrap_mode", "raw", "accel")},
                {
                    "filename": file("volume"), "filter_type": words("nearest", "trilinear"), "use_grid_bbox": FLAG,
                    "to_world": TRANSFORM,
                },
            ),
            needs=("filename",),
        ),
    },
}  # fmt: skip
