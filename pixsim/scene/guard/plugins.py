"""The plugins of Mitsuba 3.9 that a scene may use, with the types of their properties.

What is not here is refused before Mitsuba sees it: plugins that pixsim cannot inspect (raw
pointers, files of unknown layout, polarisation), and names that would make Mitsuba load another
file. Whether a value is in its range Mitsuba judges, in the child.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

from pixsim.scene.textures import METAL_BY_NAME

_NUMBER_TAGS = ("float", "integer")
_COLOUR_TAGS = (*_NUMBER_TAGS, "spectrum", "rgb")


@dataclass(frozen=True)
class PropertyRule:
    """What a property may be.

    tags : elements that state it
    kinds : plugins that it may be, besides
    file : kind of the file that a string names: texture, mesh, volume; or metal, a table of
        Mitsuba's own
    instead : what to write in place of an element that is not allowed
    """

    tags: tuple[str, ...] = ()
    kinds: tuple[str, ...] = ()
    file: str | None = None
    instead: str = ""


@dataclass(frozen=True)
class Plugin:
    """The properties of a plugin, and the kinds of plugins that it may hold under any name.

    needs : properties without which Mitsuba crashes
    """

    properties: dict[str, PropertyRule] = field(default_factory=dict)
    holds: tuple[str, ...] = ()
    needs: tuple[str, ...] = ()


NUMBER = PropertyRule(_NUMBER_TAGS)
WHOLE = PropertyRule(("integer",))
_FLAG = PropertyRule(("boolean",))
TEXT = PropertyRule(("string",))
_TRANSFORM = PropertyRule(("transform",))
_POINT = PropertyRule(("point", "vector"))
COLOUR = PropertyRule(_COLOUR_TAGS, kinds=("texture",))
INDEX = PropertyRule(
    ("string", *_NUMBER_TAGS),
    instead=(
        "Give the index at 589 nm: dielectrics of Mitsuba have one index for all wavelengths."
    ),
)
_CROP = PropertyRule(instead="Remove the crop: the film is the die.")
_METAL_INDEX = replace(COLOUR, tags=(*_NUMBER_TAGS, "spectrum"), instead=METAL_BY_NAME)
VOLUME = PropertyRule(_COLOUR_TAGS, kinds=("volume",))
PICTURE_FILE, MESH_FILE, GRID_FILE, METAL_NAME = (
    PropertyRule(("string",), file=kind) for kind in ("texture", "mesh", "volume", "metal")
)


def _properties(rule: PropertyRule, names: str) -> dict[str, PropertyRule]:
    """Return properties that may all be the same, by their names."""
    return dict.fromkeys(names.split(), rule)


_EMITTER = _properties(NUMBER, "sampling_weight") | _properties(_TRANSFORM, "to_world")
_SHAPE = (
    _properties(_TRANSFORM, "to_world")
    | _properties(_FLAG, "flip_normals")
    | _properties(NUMBER, "silhouette_sampling_weight")
)
_MESH_SHAPE = (
    _SHAPE | _properties(MESH_FILE, "filename") | _properties(_FLAG, "face_normals flip_tex_coords")
)
_INTEGRATOR = (
    _properties(WHOLE, "max_depth rr_depth block_size samples_per_pass")
    | _properties(_FLAG, "hide_emitters")
    | _properties(NUMBER, "timeout")
)
_SENSOR = _properties(_TRANSFORM, "to_world") | _properties(
    NUMBER, "near_clip far_clip shutter_open shutter_close"
)
_PERSPECTIVE = (
    _SENSOR
    | _properties(TEXT, "fov_axis focal_length")
    | _properties(NUMBER, "fov principal_point_offset_x principal_point_offset_y")
)
_THIN_LENS = _PERSPECTIVE | _properties(NUMBER, "aperture_radius focus_distance")
_SAMPLER = _properties(WHOLE, "sample_count seed")
_JITTERED_SAMPLER = _SAMPLER | _properties(_FLAG, "jitter")
_FILM = (
    _properties(WHOLE, "width height")
    | _properties(_CROP, "crop_width crop_height crop_offset_x crop_offset_y")
    | _properties(_FLAG, "sample_border compensate banner")
    | _properties(TEXT, "component_format file_format pixel_format")
)
_BITMAP = (
    _properties(PICTURE_FILE, "filename")
    | _properties(TEXT, "filter_type wrap_mode format")
    | _properties(_FLAG, "raw accel")
    | _properties(_TRANSFORM, "to_uv")
)
_SPECTRUM_TABLE = _properties(NUMBER, "wavelength_min wavelength_max")
_DIELECTRIC = _properties(INDEX, "int_ior ext_ior") | _properties(
    COLOUR, "specular_reflectance specular_transmittance"
)
_ROUGHNESS = (
    _properties(COLOUR, "alpha alpha_u alpha_v")
    | _properties(TEXT, "distribution")
    | _properties(_FLAG, "sample_visible")
)
_CONDUCTOR = (
    _properties(METAL_NAME, "material")
    | _properties(_METAL_INDEX, "eta k")
    | _properties(COLOUR, "specular_reflectance")
)
_PLASTIC = (
    _properties(COLOUR, "diffuse_reflectance specular_reflectance")
    | _properties(INDEX, "int_ior ext_ior")
    | _properties(_FLAG, "nonlinear")
)
_PRINCIPLED = (
    _properties(COLOUR, "base_color")
    | _properties(COLOUR, "roughness anisotropic spec_trans spec_tint sheen sheen_tint flatness")
    | _properties(NUMBER, "eta diffuse_reflectance_sampling_rate")
)
_PRINCIPLED_THICK = _properties(COLOUR, "metallic clearcoat clearcoat_gloss") | _properties(
    NUMBER, "specular main_specular_sampling_rate clearcoat_sampling_rate"
)
_PRINCIPLED_THIN = _properties(COLOUR, "diff_trans") | _properties(
    NUMBER,
    "specular_reflectance_sampling_rate specular_transmittance_sampling_rate"
    " diffuse_transmittance_sampling_rate",
)
_SKY = (
    _properties(
        NUMBER,
        "turbidity latitude longitude timezone hour minute second sun_scale sky_scale sun_aperture",
    )
    | _properties(WHOLE, "year month day")
    | _properties(COLOUR, "albedo")
    | _properties(_POINT, "sun_direction")
    | _properties(_FLAG, "complex_sun")
)
_MEDIUM = (
    _properties(VOLUME, "albedo sigma_t")
    | _properties(NUMBER, "scale")
    | _properties(_FLAG, "sample_emitters has_spectral_extinction")
)
_NORMAL_MAP = _properties(_FLAG, "use_shadowing_function flip_invalid_normals")
_GRID_VOLUME = (
    _properties(GRID_FILE, "filename")
    | _properties(TEXT, "filter_type wrap_mode")
    | _properties(_FLAG, "raw accel use_grid_bbox")
)
_SHAPE_CHILDREN = ("bsdf", "emitter", "medium", "texture")
_SENSOR_CHILDREN = ("film", "sampler", "medium")
_SCENE_CHILDREN = (
    "sensor",
    "film",
    "sampler",
    "rfilter",
    "integrator",
    "emitter",
    "shape",
    "bsdf",
    "texture",
    "medium",
    "phase",
    "volume",
)

# Kind -> name -> plugin.
PLUGINS: dict[str, dict[str, Plugin]] = {
    "scene": {
        "scene": Plugin(
            _properties(_FLAG, "embree_use_robust_intersections"), holds=_SCENE_CHILDREN
        )
    },
    "sensor": {
        "thinlens": Plugin(_THIN_LENS, holds=_SENSOR_CHILDREN),
        "perspective": Plugin(_THIN_LENS, holds=_SENSOR_CHILDREN),
        "orthographic": Plugin(_SENSOR, holds=_SENSOR_CHILDREN),
    },
    "film": {"hdrfilm": Plugin(_FILM, holds=("rfilter",))},
    "sampler": {
        **dict.fromkeys(("independent", "ldsampler"), Plugin(_SAMPLER)),
        **dict.fromkeys(("stratified", "multijitter"), Plugin(_JITTERED_SAMPLER)),
        "orthogonal": Plugin(_JITTERED_SAMPLER | _properties(WHOLE, "strength")),
    },
    "rfilter": {
        **dict.fromkeys(("box", "catmullrom"), Plugin()),
        "tent": Plugin(_properties(NUMBER, "radius")),
        "gaussian": Plugin(_properties(NUMBER, "stddev")),
        "mitchell": Plugin(_properties(NUMBER, "A B C")),
        "lanczos": Plugin(_properties(WHOLE, "lobes")),
    },
    "integrator": {
        **dict.fromkeys(
            ("path", "volpath", "volpathmis", "prb", "prbvolpath"), Plugin(_INTEGRATOR)
        ),
        "direct": Plugin(
            _INTEGRATOR | _properties(WHOLE, "shading_samples emitter_samples bsdf_samples")
        ),
    },
    "emitter": {
        **dict.fromkeys(
            ("area", "constant", "directionalarea"),
            Plugin(_EMITTER | _properties(COLOUR, "radiance")),
        ),
        "directional": Plugin(
            _EMITTER | _properties(COLOUR, "irradiance") | _properties(_POINT, "direction")
        ),
        "point": Plugin(
            _EMITTER | _properties(COLOUR, "intensity") | _properties(_POINT, "position")
        ),
        "spot": Plugin(
            _EMITTER
            | _properties(COLOUR, "intensity texture")
            | _properties(NUMBER, "cutoff_angle beam_width")
        ),
        "projector": Plugin(
            _EMITTER
            | _PERSPECTIVE
            | _properties(COLOUR, "irradiance")
            | _properties(NUMBER, "scale"),
            holds=("texture",),
        ),
        "envmap": Plugin(
            _EMITTER
            | _properties(PICTURE_FILE, "filename")
            | _properties(NUMBER, "scale")
            | _properties(_FLAG, "mis_compensation")
        ),
        "sunsky": Plugin(_EMITTER | _SKY),
    },
    "shape": {
        "sphere": Plugin(
            _SHAPE | _properties(_POINT, "center") | _properties(NUMBER, "radius"),
            holds=_SHAPE_CHILDREN,
        ),
        "cylinder": Plugin(
            _SHAPE | _properties(_POINT, "p0 p1") | _properties(NUMBER, "radius"),
            holds=_SHAPE_CHILDREN,
        ),
        **dict.fromkeys(("rectangle", "disk"), Plugin(_SHAPE, holds=_SHAPE_CHILDREN)),
        "cube": Plugin(_SHAPE | _properties(_FLAG, "face_normals"), holds=_SHAPE_CHILDREN),
        **dict.fromkeys(("ply", "obj"), Plugin(_MESH_SHAPE, holds=_SHAPE_CHILDREN)),
        "serialized": Plugin(
            _MESH_SHAPE | _properties(WHOLE, "shape_index"), holds=_SHAPE_CHILDREN
        ),
        "shapegroup": Plugin(holds=("shape",)),
        "instance": Plugin(_properties(_TRANSFORM, "to_world"), holds=("shape",)),
    },
    "bsdf": {
        "diffuse": Plugin(_properties(COLOUR, "reflectance")),
        **dict.fromkeys(("dielectric", "thindielectric"), Plugin(_DIELECTRIC)),
        "roughdielectric": Plugin(_DIELECTRIC | _ROUGHNESS),
        "conductor": Plugin(_CONDUCTOR),
        "roughconductor": Plugin(_CONDUCTOR | _ROUGHNESS),
        "plastic": Plugin(_PLASTIC),
        "roughplastic": Plugin(_PLASTIC | _ROUGHNESS),
        "principled": Plugin(_PRINCIPLED | _PRINCIPLED_THICK),
        "principledthin": Plugin(_PRINCIPLED | _PRINCIPLED_THIN),
        "twosided": Plugin(holds=("bsdf",)),
        "mask": Plugin(_properties(COLOUR, "opacity"), holds=("bsdf",)),
        "blendbsdf": Plugin(_properties(COLOUR, "weight"), holds=("bsdf",), needs=("weight",)),
        "bumpmap": Plugin(_NORMAL_MAP | _properties(NUMBER, "scale"), holds=("bsdf", "texture")),
        "normalmap": Plugin(
            _NORMAL_MAP | _properties(COLOUR, "normalmap"), holds=("bsdf", "texture")
        ),
        "null": Plugin(),
    },
    "texture": {
        "bitmap": Plugin(_BITMAP, needs=("filename",)),
        "checkerboard": Plugin(
            _properties(COLOUR, "color0 color1") | _properties(_TRANSFORM, "to_uv")
        ),
        "mesh_attribute": Plugin(_properties(TEXT, "name") | _properties(NUMBER, "scale")),
        "volume": Plugin({"volume": PropertyRule(kinds=("volume",))}, needs=("volume",)),
        "uniform": Plugin(_SPECTRUM_TABLE | _properties(NUMBER, "value")),
        "regular": Plugin(_SPECTRUM_TABLE | _properties(TEXT, "values range")),
        "irregular": Plugin(_properties(TEXT, "wavelengths values")),
        "d65": Plugin(
            _properties(NUMBER, "scale") | _properties(PropertyRule(("rgb",)), "color"),
            holds=("texture",),
        ),
        "blackbody": Plugin(_SPECTRUM_TABLE | _properties(NUMBER, "temperature")),
        "srgb": Plugin(_properties(PropertyRule(("rgb",)), "color")),
    },
    "medium": dict.fromkeys(("homogeneous", "heterogeneous"), Plugin(_MEDIUM, holds=("phase",))),
    "phase": {
        **dict.fromkeys(("isotropic", "rayleigh"), Plugin()),
        "hg": Plugin(_properties(NUMBER, "g")),
        "blendphase": Plugin(_properties(VOLUME, "weight"), holds=("phase", "volume")),
    },
    "volume": {
        "constvolume": Plugin(_properties(COLOUR, "value")),
        "gridvolume": Plugin(_GRID_VOLUME | _properties(_TRANSFORM, "to_world")),
    },
}
