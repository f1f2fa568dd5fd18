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
class Allowed:
    """What a property may be.

    tags : elements that state it
    kinds : plugins that it may be, besides
    file : kind of the file that a string names: texture, mesh, volume; or metal, a table of
        Mitsuba's own
    instead : what to write in place of an element that is not allowed
    """

    tags: tuple[str, ...]
    kinds: tuple[str, ...] = ()
    file: str | None = None
    instead: str = ""


@dataclass(frozen=True)
class Plugin:
    """The properties of a plugin, and the kinds of plugins that it may hold under any name."""

    properties: dict[str, Allowed] = field(default_factory=dict)
    holds: tuple[str, ...] = ()


NUMBER, WHOLE, FLAG, WORD = (
    Allowed(_NUMBER_TAGS),
    Allowed(("integer",)),
    Allowed(("boolean",)),
    Allowed(("string",)),
)
TRANSFORM, PLACE = Allowed(("transform",)), Allowed(("point", "vector"))
COLOUR = Allowed(_COLOUR_TAGS, kinds=("texture",))
# A spectrum is refused later, with its reason: Mitsuba has one index for all wavelengths.
INDEX = Allowed(("string", *_COLOUR_TAGS), kinds=("texture",))
_INDEX_OF_METAL = replace(COLOUR, tags=(*_NUMBER_TAGS, "spectrum"), instead=METAL_BY_NAME)
VOLUME = Allowed(_COLOUR_TAGS, kinds=("volume",))
PICTURE, MESH, GRID, METAL = (
    Allowed(("string",), file=kind) for kind in ("texture", "mesh", "volume", "metal")
)


def each(rule: Allowed, names: str) -> dict[str, Allowed]:
    """Return properties that may all be the same, by their names."""
    return dict.fromkeys(names.split(), rule)


_OF_EMITTERS = each(NUMBER, "sampling_weight") | each(TRANSFORM, "to_world")
_OF_SHAPES = (
    each(TRANSFORM, "to_world")
    | each(FLAG, "flip_normals")
    | each(NUMBER, "silhouette_sampling_weight")
)
_OF_MESHES = _OF_SHAPES | each(MESH, "filename") | each(FLAG, "face_normals flip_tex_coords")
_OF_INTEGRATORS = (
    each(WHOLE, "max_depth rr_depth block_size samples_per_pass")
    | each(FLAG, "hide_emitters")
    | each(NUMBER, "timeout")
)
_OF_SENSORS = each(TRANSFORM, "to_world") | each(
    NUMBER, "near_clip far_clip shutter_open shutter_close"
)
_OF_LENSES = (
    _OF_SENSORS
    | each(WORD, "fov_axis focal_length")
    | each(NUMBER, "fov principal_point_offset_x principal_point_offset_y")
)
_OF_THIN_LENSES = _OF_LENSES | each(NUMBER, "aperture_radius focus_distance")
_OF_SAMPLERS = each(WHOLE, "sample_count seed")
_OF_JITTERED = _OF_SAMPLERS | each(FLAG, "jitter")
_OF_FILMS = (
    each(WHOLE, "width height crop_width crop_height crop_offset_x crop_offset_y")
    | each(FLAG, "sample_border compensate banner")
    | each(WORD, "component_format")
)
OF_PICTURES = (
    each(PICTURE, "filename")
    | each(WORD, "filter_type wrap_mode format")
    | each(FLAG, "raw accel")
    | each(TRANSFORM, "to_uv")
)
_OF_TABLES = each(NUMBER, "wavelength_min wavelength_max")
_OF_DIELECTRICS = each(INDEX, "int_ior ext_ior") | each(
    COLOUR, "specular_reflectance specular_transmittance"
)
_OF_ROUGH = (
    each(COLOUR, "alpha alpha_u alpha_v")
    | each(WORD, "distribution")
    | each(FLAG, "sample_visible")
)
_OF_METALS = (
    each(METAL, "material") | each(_INDEX_OF_METAL, "eta k") | each(COLOUR, "specular_reflectance")
)
_OF_PLASTICS = (
    each(COLOUR, "diffuse_reflectance specular_reflectance")
    | each(INDEX, "int_ior ext_ior")
    | each(FLAG, "nonlinear")
)
_OF_PRINCIPLED = (
    each(COLOUR, "base_color")
    | each(COLOUR, "roughness anisotropic spec_trans spec_tint sheen sheen_tint flatness")
    | each(NUMBER, "eta diffuse_reflectance_sampling_rate")
)
_OF_THICK = each(COLOUR, "metallic clearcoat clearcoat_gloss") | each(
    NUMBER, "specular main_specular_sampling_rate clearcoat_sampling_rate"
)
_OF_THIN = each(COLOUR, "diff_trans") | each(
    NUMBER,
    "specular_reflectance_sampling_rate specular_transmittance_sampling_rate"
    " diffuse_transmittance_sampling_rate",
)
_OF_SKIES = (
    each(
        NUMBER,
        "turbidity latitude longitude timezone hour minute second sun_scale sky_scale sun_aperture",
    )
    | each(WHOLE, "year month day")
    | each(COLOUR, "albedo")
    | each(PLACE, "sun_direction")
    | each(FLAG, "complex_sun")
)
_OF_MEDIA = (
    each(VOLUME, "albedo sigma_t")
    | each(NUMBER, "scale")
    | each(FLAG, "sample_emitters has_spectral_extinction")
)
_OF_MAPS = each(FLAG, "use_shadowing_function flip_invalid_normals")
_OF_GRIDS = (
    each(GRID, "filename")
    | each(WORD, "filter_type wrap_mode")
    | each(FLAG, "raw accel use_grid_bbox")
)
IN_SHAPES, IN_SENSORS = ("bsdf", "emitter", "medium", "texture"), ("film", "sampler", "medium")
_ANY_KIND = (
    "sensor", "film", "sampler", "rfilter", "integrator", "emitter", "shape", "bsdf", "texture", "medium", "phase", "volume",
)  # fmt: skip

# Kind -> name -> plugin.
PLUGINS: dict[str, dict[str, Plugin]] = {
    "scene": {"scene": Plugin(each(FLAG, "embree_use_robust_intersections"), holds=_ANY_KIND)},
    "sensor": {
        "thinlens": Plugin(_OF_THIN_LENSES, holds=IN_SENSORS),
        "perspective": Plugin(_OF_THIN_LENSES, holds=IN_SENSORS),
        "orthographic": Plugin(_OF_SENSORS, holds=IN_SENSORS),
    },
    "film": {
        "hdrfilm": Plugin(_OF_FILMS | each(WORD, "file_format pixel_format"), holds=("rfilter",)),
        "specfilm": Plugin(_OF_FILMS, holds=("rfilter", "texture")),
    },
    "sampler": {
        **dict.fromkeys(("independent", "ldsampler"), Plugin(_OF_SAMPLERS)),
        **dict.fromkeys(("stratified", "multijitter"), Plugin(_OF_JITTERED)),
        "orthogonal": Plugin(_OF_JITTERED | each(WHOLE, "strength")),
    },
    "rfilter": {
        **dict.fromkeys(("box", "catmullrom"), Plugin()),
        "tent": Plugin(each(NUMBER, "radius")),
        "gaussian": Plugin(each(NUMBER, "stddev")),
        "mitchell": Plugin(each(NUMBER, "A B C")),
        "lanczos": Plugin(each(WHOLE, "lobes")),
    },
    "integrator": {
        **dict.fromkeys(
            ("path", "volpath", "volpathmis", "prb", "prbvolpath"), Plugin(_OF_INTEGRATORS)
        ),
        "direct": Plugin(
            _OF_INTEGRATORS | each(WHOLE, "shading_samples emitter_samples bsdf_samples")
        ),
    },
    "emitter": {
        **dict.fromkeys(
            ("area", "constant", "directionalarea"), Plugin(_OF_EMITTERS | each(COLOUR, "radiance"))
        ),
        "directional": Plugin(_OF_EMITTERS | each(COLOUR, "irradiance") | each(PLACE, "direction")),
        "point": Plugin(_OF_EMITTERS | each(COLOUR, "intensity") | each(PLACE, "position")),
        "spot": Plugin(
            _OF_EMITTERS
            | each(COLOUR, "intensity texture")
            | each(NUMBER, "cutoff_angle beam_width")
        ),
        "projector": Plugin(
            _OF_EMITTERS | _OF_LENSES | each(COLOUR, "irradiance") | each(NUMBER, "scale"),
            holds=("texture",),
        ),
        "envmap": Plugin(
            _OF_EMITTERS
            | each(PICTURE, "filename")
            | each(NUMBER, "scale")
            | each(FLAG, "mis_compensation")
        ),
        "sunsky": Plugin(_OF_EMITTERS | _OF_SKIES),
    },
    "shape": {
        "sphere": Plugin(
            _OF_SHAPES | each(PLACE, "center") | each(NUMBER, "radius"), holds=IN_SHAPES
        ),
        "cylinder": Plugin(
            _OF_SHAPES | each(PLACE, "p0 p1") | each(NUMBER, "radius"), holds=IN_SHAPES
        ),
        **dict.fromkeys(("rectangle", "disk"), Plugin(_OF_SHAPES, holds=IN_SHAPES)),
        "cube": Plugin(_OF_SHAPES | each(FLAG, "face_normals"), holds=IN_SHAPES),
        **dict.fromkeys(("ply", "obj"), Plugin(_OF_MESHES, holds=IN_SHAPES)),
        "serialized": Plugin(_OF_MESHES | each(WHOLE, "shape_index"), holds=IN_SHAPES),
        "shapegroup": Plugin(holds=("shape",)),
        "instance": Plugin(each(TRANSFORM, "to_world"), holds=("shape",)),
    },
    "bsdf": {
        "diffuse": Plugin(each(COLOUR, "reflectance")),
        **dict.fromkeys(("dielectric", "thindielectric"), Plugin(_OF_DIELECTRICS)),
        "roughdielectric": Plugin(_OF_DIELECTRICS | _OF_ROUGH),
        "conductor": Plugin(_OF_METALS),
        "roughconductor": Plugin(_OF_METALS | _OF_ROUGH),
        "plastic": Plugin(_OF_PLASTICS),
        "roughplastic": Plugin(_OF_PLASTICS | _OF_ROUGH),
        "principled": Plugin(_OF_PRINCIPLED | _OF_THICK),
        "principledthin": Plugin(_OF_PRINCIPLED | _OF_THIN),
        "twosided": Plugin(holds=("bsdf",)),
        "mask": Plugin(each(COLOUR, "opacity"), holds=("bsdf",)),
        "blendbsdf": Plugin(each(COLOUR, "weight"), holds=("bsdf",)),
        "bumpmap": Plugin(_OF_MAPS | each(NUMBER, "scale"), holds=("bsdf", "texture")),
        "normalmap": Plugin(_OF_MAPS | each(COLOUR, "normalmap"), holds=("bsdf", "texture")),
        "null": Plugin(),
    },
    "texture": {
        "bitmap": Plugin(OF_PICTURES),
        "checkerboard": Plugin(each(COLOUR, "color0 color1") | each(TRANSFORM, "to_uv")),
        "mesh_attribute": Plugin(each(WORD, "name") | each(NUMBER, "scale")),
        "volume": Plugin(holds=("volume",)),
        "uniform": Plugin(_OF_TABLES | each(NUMBER, "value")),
        "regular": Plugin(_OF_TABLES | each(WORD, "values range")),
        "irregular": Plugin(each(WORD, "wavelengths values")),
        "d65": Plugin(each(NUMBER, "scale") | each(Allowed(("rgb",)), "color"), holds=("texture",)),
        "blackbody": Plugin(_OF_TABLES | each(NUMBER, "temperature")),
        "srgb": Plugin(each(Allowed(("rgb",)), "color")),
    },
    "medium": dict.fromkeys(("homogeneous", "heterogeneous"), Plugin(_OF_MEDIA, holds=("phase",))),
    "phase": {
        **dict.fromkeys(("isotropic", "rayleigh"), Plugin()),
        "hg": Plugin(each(NUMBER, "g")),
        "blendphase": Plugin(each(VOLUME, "weight"), holds=("phase", "volume")),
    },
    "volume": {
        "constvolume": Plugin(each(COLOUR, "value")),
        "gridvolume": Plugin(_OF_GRIDS | each(TRANSFORM, "to_world")),
    },
}
