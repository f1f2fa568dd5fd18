"""Read a Mitsuba 3 XML: parameters, camera and contents, before Mitsuba builds or renders the
scene.
"""

from __future__ import annotations

import math
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache, partial
from pathlib import Path
from typing import Any

from pixsim.base import caller
from pixsim.base.bounds import LARGEST, SMALLEST, value_text
from pixsim.base.door import checked_methods
from pixsim.base.errors import PixsimError, did_you_mean, invalid
from pixsim.base.files import cache_folder, digest_of, missing
from pixsim.base.hashes import content_hash
from pixsim.base.problems import names_meant
from pixsim.light.quantities import (
    EMITTER_SCALE,
    ILLUMINANCE,
    INCIDENCE,
    IRRADIANCE,
    LAMP,
    LUMINANCE,
    FilmSamples,
)
from pixsim.light.spectral import WHITE_LAMPS
from pixsim.optics.camera import Camera, CameraOptions, values_of_lens_geometry
from pixsim.optics.camera_lens import camera_with_lens
from pixsim.optics.lens_options import LensOptions
from pixsim.scene import charts
from pixsim.scene.contents import (
    Beyond,
    check_textures,
    files_of_scene,
    find_lamp,
    find_lamps,
    is_neutral,
    white_spectra,
)
from pixsim.scene.film import FILM_ROUNDING
from pixsim.scene.guard.dictionary import scene_and_parameters
from pixsim.scene.guard.files import ASSETS
from pixsim.scene.guard.inspector import ALLOWED_SENSOR, REASONS, SENSOR, SceneText, open_scene
from pixsim.scene.illuminance import strength
from pixsim.scene.own_chart import LINEAR_SUFFIXES, SUFFIXES, OwnChart, is_own_chart
from pixsim.scene.packaged import packaged_folder, packaged_scenes
from pixsim.scene.target import Target
from pixsim.scene.tree import (
    Node,
    SpectrumTable,
    Tree,
    children,
    nodes_of,
    parse_tree,
    plain_values,
)
from pixsim.scene.variants import variant as variants
from pixsim.viewer.display_options import Luminance
from pixsim.viewer.setting import Run

CHART = "chart"
_CHART_LINEAR = "chart_linear"
_TARGET_FILE = "target.exr"
_CSF_FILE = "csf.exr"
_BEYOND_TABLES = "beyond_tables"
# Parameters that only pixsim reads, of the packaged charts that have some.
_PARAMETERS_OF_CHARTS = {
    _CSF_FILE: (charts.MAX_LP_PER_MM,),
    _TARGET_FILE: tuple(Target.model_fields),
}
_CHART_HALF_WIDTH = "chart_half_width"
_CHART_HALF_HEIGHT = "chart_half_height"
_ALLOWED_RESOLUTION = (1, 16384)  # samples along a side of a film
_ALLOWED_SAMPLES = (1, 1 << 20)  # for a film cell
# Parameters of the film's samples across and of the samples for each of its cells: every scene
# takes them, also one whose XML has none of this name.
RESOLUTION = "resolution"
SAMPLES_PER_CELL = "spp"
_MAX_DIGITS = 18
_LENS_PARAMETERS = ("fov", "aperture_radius", "focus_distance")
# a <default> that only pixsim reads: the luminance that the display shows as white
WHITE = "white_cd_per_m2"
_LIGHTS = LUMINANCE, ILLUMINANCE, IRRADIANCE
_MAX_INCIDENCE_DEG = 89.0
_INCIDENCE_DEG = 45.0  # of the light of a lamp, as the packaged lamps are scaled for
_FILM_35_MM = (36.0, 24.0)  # the format of Mitsuba's `focal_length`


@checked_methods
@dataclass(frozen=True)
class Scene:
    """A Mitsuba scene: its file, its parameters, and the variant that renders it.

    path : of the XML
    parameters : given values of <default> parameters
    names : of all parameters in the XML, and of a target's
    sensor_id : id of the sensor, or None if there is only one
    choice : Mitsuba variant, and why it was chosen
    white_cd_per_m2 : luminance that the display shows as white, if the file states it
    white_lamps : ids of the emitters that shine on the white together, if the file names them
        in its <default> white_lamps
    shows_csf : whether its chart is the packaged CSF chart, whose highest frequency the parameter
        `max_lp_per_mm` sets
    shows_target : whether its chart is a target, which parameters set and `for_camera` draws on the
        cells of the film
    beyond_tables : what a surface is where its spectrum ends within the range that is computed:
        "hold" its last value, or "zero". None where the user does not state it
    strength : factor on all lamps that the parameter `lux` asks for
    lamp_factor : radiance of white over the irradiance of the lamp that the parameter `lamp` names,
        of a chart that shines; None where the XML has all of its light
    diffuser : whether a render also says what a white plate at the object's distance would show,
        for `display.white`
    plate : transform of a white plate in the scene, 16 numbers, row by row
    own_chart : a picture that takes the place of the parameter `chart`, which names it
    resolution : film samples across the die, in place of the film's width in the XML
    _texts : its inspected texts so far, by their parameters
    """

    path: Path
    parameters: dict[str, str]
    names: frozenset[str]
    sensor_id: str | None
    choice: variants.ChosenVariant
    white_cd_per_m2: Luminance | None = None
    white_lamps: tuple[str, ...] = ()
    own_chart: OwnChart | None = None
    resolution: FilmSamples | None = None
    shows_csf: bool = False
    shows_target: bool = False
    strength: float | None = None
    lamp_factor: float | None = None
    beyond_tables: Beyond | None = None
    diffuser: bool = False
    plate: tuple[float, ...] | None = None
    _texts: dict[str, SceneText] = field(default_factory=dict, repr=False, compare=False)

    def text(self, **defaults: object) -> SceneText:
        """Return the inspected text of the scene.

        defaults : values of parameters that the user did not set
        """
        values = {name: str(value) for name, value in defaults.items()} | self.parameters
        # Parameters of pixsim alone: `for_camera` makes the chart.
        chart = _TARGET_FILE if self.shows_target else _CSF_FILE if self.shows_csf else ""
        for name in _PARAMETERS_OF_CHARTS.get(chart, ()):
            values.pop(name, None)
        if self.strength is not None:
            values.pop(ILLUMINANCE, None)
        if self.own_chart:
            values[CHART] = str(defaults.get(CHART) or self.own_chart.texture(1.0))

        changes = self.strength, self.plate, self.lamp_factor
        key = _key_of_text(values, *changes)
        if key not in self._texts:  # a render needs it ten times
            self._texts[key] = open_scene(self.path, values, *changes)
        return self._texts[key]

    def parse(self, **defaults: object) -> Tree:
        """Return the parsed tree of the inspected text.

        defaults : values of parameters that the user did not set
        """
        return self._tree(self.text(**defaults))

    def camera(
        self, options: CameraOptions | None = None, lens: LensOptions | None = None
    ) -> Camera:
        """Return the camera of the file, overridden by the options, with a real lens if `lens`
        names one.

        A Mitsuba scene does not state the die. If its lens is given by numbers, a die option scales
        the focal length; if the lens is given by parameters, the focal length stays and the field
        of view changes. The die has the shape of the film, unless an option gives its height.

        Raises PixsimError if the lens is invalid, and as `camera_with_lens` does.
        """
        options = options or CameraOptions()
        lens = lens or LensOptions()
        lens_is_fixed = any(
            name not in self.names or name in self.parameters for name in _LENS_PARAMETERS
        )
        die_mm = options.die_mm if lens_is_fixed and options.die_mm else Camera().die_mm
        state = self.parse()
        sensor = sensor_node(state, self.sensor_id)[1]
        height, width = self.film_size(state)

        # A real lens replaces the aperture as an option does.
        scene_options = options
        if lens.file and options.f_number is None:
            scene_options = options.model_copy(update={"f_number": Camera().f_number})
        scene_camera = _read_camera(sensor, die_mm, width / max(height, 1), scene_options)

        if options.die_height_mm is None and height != width and height > 0:
            width_mm = scene_camera.die_mm if options.die_mm is None else options.die_mm
            options = options.model_copy(update={"die_height_mm": width_mm * height / width})
        return camera_with_lens(options.over(scene_camera), options, lens)

    def for_camera(self, camera: Camera) -> Tree:
        """Return the parsed tree with the scene's lens and chart parameters set for a camera."""
        return self._tree(self.text_for_camera(camera))

    def _tree(self, text: SceneText) -> Tree:
        """Return the parsed tree of an inspected text. Raises PixsimError with the place of what
        Mitsuba cannot parse.
        """
        try:
            return parse_tree(text.text, self.choice.reading)
        except PixsimError as error:
            raise PixsimError(text.with_place(str(error))) from None

    def text_for_camera(self, camera: Camera) -> SceneText:
        """Return the inspected text with the scene's lens and chart parameters set for a camera."""
        # Lens
        lens_values = (camera.fov_deg, camera.aperture_radius_m, camera.object_distance_m)
        values = {
            name: repr(value)
            for name, value in zip(_LENS_PARAMETERS, lens_values, strict=True)
            if name in self.names
        }

        # Film. Its whole cells may end a little beyond the die.
        film_camera = camera
        shape = (1, 1)
        if camera.die_height_mm is not None or self.shows_target:
            shape = self.film_shape(camera, self.parse(**values))
        if camera.die_height_mm is not None:
            height_mm = camera.die_mm * shape[0] / max(shape[1], 1)
            film_camera = camera.model_copy(update={"die_height_mm": height_mm})

        # Chart
        for name, length in _chart_parameters(film_camera).items():
            if name in self.names:
                values[name] = repr(length)
        if self.own_chart:
            # Where the chart follows the height of the die, the picture's border does so too.
            follows_height = _CHART_HALF_HEIGHT in self.names
            height_mm = film_camera.height_mm if follows_height else film_camera.die_mm
            picture = self.own_chart.texture(film_camera.die_mm / height_mm, warn=True)
            values[CHART] = str(picture)
        if charts.MAX_LP_PER_MM in self.parameters:
            values[CHART] = str(self._csf_file(camera))
        if self.shows_target:
            values[CHART] = str(self._target_file(camera, _chart_parameters(film_camera), shape))
        return self.text(**values)

    def _csf_file(self, camera: Camera) -> Path:
        """Return the texture of its CSF chart, which ends at the frequency of its parameter."""
        width_mm = camera.die_mm
        if _CHART_HALF_WIDTH in self.parameters:
            width_mm *= float(self.parameters[_CHART_HALF_WIDTH]) / camera.chart_half_width_m
        return charts.csf_file(float(self.parameters[charts.MAX_LP_PER_MM]), width_mm)

    def _target_file(
        self, camera: Camera, fitting: dict[str, float], film: tuple[int, int]
    ) -> Path:
        """Return the texture of its target, whose texels are the cells of a film (H, W).

        fitting : parameters of a chart that fills the film; a larger one has more texels
        """
        for side in film:
            check_resolution(side)

        # Sides of the chart in texels and in mm, height first
        texels = []
        sides_mm = []
        for cells, name in zip(film, (_CHART_HALF_HEIGHT, _CHART_HALF_WIDTH), strict=True):
            half_m = float(self.parameters.get(name, fitting[name]))
            count = round(cells * half_m / fitting[name])
            texels.append(min(max(count, 1), _ALLOWED_RESOLUTION[1]))
            sides_mm.append(2e3 * half_m)

        target = self.target
        target_mm = target.lengths_in_scene_mm(camera.magnification, camera.object_distance_m)
        content = ["target", target.content_hash, *target_mm, *sides_mm, *texels]
        shape = (texels[0], texels[1])
        field_mm = (sides_mm[0], sides_mm[1])
        return charts.texture_file(content, partial(target.texels, shape, field_mm, *target_mm))

    @property
    def target(self) -> Target:
        """The target that its chart shows. Raises PixsimError for parameters that are none, and for
        another chart.
        """
        if not self.shows_target:
            raise invalid(
                "target",
                f"the chart of '{self.path.name}', which is a different one",
                f"a scene whose chart is {_TARGET_FILE}",
            )
        return Target.from_parameters(self.parameters, self.text().defaults)

    def film_shape(self, camera: Camera, state: Tree) -> tuple[int, int]:
        """Return (height, width) of the film in samples; the renderer checks their range.

        The width is `resolution`, or else that in the XML. The height follows the die's shape,
        rounded up; without a `die_height_mm` it follows the shape of the film in the XML.

        state : the parsed tree, as from `parse`
        """
        height, width = self.film_size(state)
        if self.resolution is None and camera.die_height_mm is None:
            return height, width

        ratio = height / max(width, 1)
        if camera.die_height_mm is not None:
            ratio = camera.height_mm / camera.die_mm
        film_width = width if self.resolution is None else self.resolution
        return max(1, math.ceil(film_width * ratio - FILM_ROUNDING)), film_width

    def film_size(self, state: Tree) -> tuple[int, int]:
        """Return (height, width) of the scene's film in samples.

        state : the parsed tree, as from `parse`

        Raises PixsimError if one is out of range.
        """
        film = _child(state, sensor_node(state, self.sensor_id)[1], "Film")
        height = _whole(film, "height", 576)
        width = _whole(film, "width", 768)
        across = self._number_beside_xml(RESOLUTION)
        if across is not None:
            height = max(1, math.ceil(across * height / max(width, 1) - FILM_ROUNDING))
            width = across
        for side in (width, height):
            check_resolution(side)
        return height, width

    def sample_count(self, state: Tree) -> int:
        """Return the samples per film cell.

        state : the parsed tree, as from `parse`

        Raises PixsimError if they are out of range.
        """
        sampler = _child(state, sensor_node(state, self.sensor_id)[1], "Sampler")
        count = self._number_beside_xml(SAMPLES_PER_CELL)
        if count is None:
            count = _whole(sampler, "sample_count", 4)
        low, high = _ALLOWED_SAMPLES
        if not low <= count <= high:
            raise invalid(SAMPLES_PER_CELL, count, f"{low} to {high}")
        return count

    def _number_beside_xml(self, name: str) -> int | None:
        """Return the whole number of a parameter that the XML does not use; None if it is not
        stated, or the XML uses it.
        """
        text = self.parameters.get(name)
        if text is None or name in self.names:
            return None
        if not text.isdecimal() or len(text) > _MAX_DIGITS:
            raise invalid(name, value_text(text), "a whole number")
        return int(text)

    def with_resolution(self, resolution: FilmSamples) -> Scene:
        """Return the scene on a film of `resolution` samples across."""
        return replace(self, resolution=resolution)

    def with_parameters(self, **values: object) -> Scene:
        """Return the scene with other values of some parameters."""
        texts = {name: str(value) for name, value in values.items()}
        return replace(self, parameters=self.parameters | texts)

    @property
    def shown_parameters(self) -> dict[str, str]:
        """The parameters for a header: files by their name, without the folder."""
        files = {
            name: Path(value).name for name, value in self.parameters.items() if os.sep in value
        }
        linear = {_CHART_LINEAR: "1"} if self.own_chart and self.own_chart.linear else {}
        beyond = {_BEYOND_TABLES: self.beyond_tables} if self.beyond_tables else {}
        return self.parameters | files | linear | beyond

    @property
    def is_packaged(self) -> bool:
        """Whether its file is a packaged one, which is made for the default die."""
        return self.path in _packaged_files()

    @property
    def content_hash(self) -> str:
        """Hash of the parsed tree and the bytes of its textures."""
        tree = hash_of_tree(self.parse())
        return content_hash([tree, self.target.content_hash]) if self.shows_target else tree

    def __repr__(self) -> str:
        parameters = "".join(f", {k}={v}" for k, v in self.parameters.items())
        return f"<Scene {self.path.name}{parameters}, {self.choice.variant}>"


def _key_of_text(
    values: dict[str, str],
    strength: float | None = None,
    plate: tuple[float, ...] | None = None,
    lamp_factor: float | None = None,
) -> str:
    return repr((sorted(values.items()), strength, plate, lamp_factor))


def _chart_parameters(camera: Camera) -> dict[str, float]:
    """Return the values of scene parameters that fit a chart to a camera's die; lengths in m, in
    the plane in focus.
    """
    width = camera.chart_half_width_m
    height = camera.chart_half_height_m
    shorter = min(width, height)
    return {
        "chart_half_width": width,
        "chart_half_height": height,
        "chart_half_side": max(width, height),
        "chart_ratio_x": width / shorter,
        "chart_ratio_y": height / shorter,
    }


@lru_cache
def _packaged_files() -> frozenset[Path]:
    return frozenset(path.resolve() for path in packaged_scenes().values())


@lru_cache
def _packaged_texts() -> frozenset[str]:
    return frozenset(path.read_text(encoding="utf-8") for path in packaged_scenes().values())


def is_packaged(text: SceneText, files: Sequence[Path]) -> bool:
    """Return whether a scene's XML is a packaged one's, and its files are packaged or
    made by pixsim.

    files : absolute paths of those that its text names
    """
    if text.content not in _packaged_texts():
        return False
    folders = [Path(os.path.realpath(folder)) for folder in (packaged_folder(), cache_folder())]
    targets = [Path(os.path.realpath(file)) for file in files]
    return all(any(target.is_relative_to(folder) for folder in folders) for target in targets)


def scene_path(scene: str | os.PathLike[str]) -> Path:
    """Return the file of a scene, which may be a packaged one. Raises PixsimError if there is
    none.
    """
    names = packaged_scenes()
    path = names.get(str(scene)) or Path(scene)
    allowed = f"an XML file, or one of {', '.join(names)}"
    if path.suffix == ".toml":
        hint = f"To use a parameter file: pixsim run csf --config {path}"
        raise invalid("scene", f"'{scene}', a TOML file", allowed, hint)
    if os.path.lexists(path) and not path.is_dir():
        return path

    got = f"'{scene}'"
    if path.is_dir():
        got = f"'{scene}', a folder"
    elif path.parent != Path() or path.suffix:
        got = missing(path)
    hint = did_you_mean(str(scene), names)
    if path.suffix.lower() in SUFFIXES:
        hint = f"A picture is the chart of a scene: csf with {caller.parameter(CHART, str(path))}."
    raise invalid("scene", got, allowed, hint)


def load_scene(
    scene: str | os.PathLike[str] | Mapping[str, Any],
    *,
    variant: str | None = None,
    sensor: str | None = None,
    **parameters: object,
) -> Scene:
    """Load a scene from an XML file or a dictionary, or a packaged one by its name.

    Parameters
    ----------
    scene : path, or a name as in `pixsim run`; or a dictionary of plain values as for
        `mitsuba.load_dict`, with a transform as its 16 numbers, row by row
    variant : Mitsuba variant. None takes the graphics card if it passed its trial, else the
        processors
    sensor : id of the sensor, if the scene has several
    parameters : values of the scene's <default> parameters. In any scene, `resolution` sets the
        film's samples across the die, and `spp` the samples for each of its cells. `lux` is the
        illuminance on the part or place that a scene shows, where white, a diffuser of reflectance
        1, has lux/π cd/m², and reflectance ρ has ρ lux/π. In a scene with a parameter
        `emitter_scale`, whose chart shines as white does at texel value 1, `luminance_cd_per_m2` or
        `irradiance_w_per_m2` may state this light too, and `lamp` names a file with its spectrum,
        as the irradiance of a beam that meets the normal at `incidence_deg` (45); in a scene with a
        <default> `lux`, which only pixsim reads, `lux` scales all lamps and the luminance of white
        by one factor; `max_lp_per_mm` sets the highest frequency on the sensor of the CSF chart,
        and the fields of `scene.target.Target` set what the scene target shows; `chart` may name a
        picture (`scene.own_chart.read_luminance`), decoded as sRGB unless `chart_linear` is true;
        `beyond_tables`, "hold" or "zero", says what surfaces are where lamps shine and their
        spectra end; `assets` names a folder whose files the scene may name, besides its own; of a
        dictionary, by default the working directory

    Raises PixsimError if the file or a texture is missing or damaged, a parameter is unknown, there
    is no sensor or more than one, the sensor is not a thin lens, or LLVM is too old.

    >>> load_scene("csf", resolution=64).camera().focal_length_mm
    3.86
    """
    file, parameters = scene_and_parameters(scene, parameters)
    path = scene_path(file)

    # Parameters that pixsim reads itself, and those of the XML
    special = {
        name: parameters.pop(name, None)
        for name in (LUMINANCE, WHITE, WHITE_LAMPS, charts.MAX_LP_PER_MM)
    }
    linear = _flag(_CHART_LINEAR, parameters.pop(_CHART_LINEAR, False))
    beyond = _beyond(parameters.pop(_BEYOND_TABLES, None))
    values = {name: str(value) for name, value in parameters.items()}
    picture = _picture_of_chart(path, values)
    text = open_scene(path, values)
    for name in (ILLUMINANCE, IRRADIANCE):
        special[name] = None if name in text.names else values.pop(name, None)
    packaged_chart = ""
    if CHART in text.names and CHART not in values:
        packaged_chart = Path(text.defaults.get(CHART, "")).name
    special_names = [name for name, value in special.items() if value is not None]
    _check_names(text, [*values, *special_names], packaged_chart)
    light = _stated_light(special)

    # The scene with its chart. Its text is that of the resolved file, unless a link's folder has
    # the files that it names.
    choice = variants.choose(variant)
    white = special[WHITE]
    stated_white = text.defaults.get(WHITE) if white is None else white
    loaded = Scene(
        path=path.resolve(),
        parameters=values,
        names=text.names,
        sensor_id=sensor,
        choice=choice,
        white_cd_per_m2=None if stated_white is None else _positive(WHITE, stated_white),
        lamp_factor=_lamp_factor(text, values, light),
        shows_csf=packaged_chart == _CSF_FILE,
        _texts={_key_of_text(values): text} if picture is None and path == path.resolve() else {},
    )
    if packaged_chart == _TARGET_FILE:
        loaded = _with_target(loaded)
    loaded = replace(_with_own_chart(loaded, text, picture, linear), beyond_tables=beyond)
    loaded = _with_white_lamps(loaded, text, special[WHITE_LAMPS])
    _check_renderable(loaded)

    # Parameters that scale it
    if loaded.lamp_factor is not None and white is None:
        loaded = replace(loaded, white_cd_per_m2=None)  # white is the chart's texel value 1
    if light is not None:
        is_placed = light[0] == ILLUMINANCE and ILLUMINANCE in text.defaults
        scaled = _with_illuminance if is_placed else _with_light_of_white
        loaded = scaled(loaded, text, *light, keeps_white=white is not None)
    highest = special[charts.MAX_LP_PER_MM]
    if highest is not None:
        highest_lp_per_mm = repr(_positive(charts.MAX_LP_PER_MM, highest))
        loaded = loaded.with_parameters(**{charts.MAX_LP_PER_MM: highest_lp_per_mm})
    return loaded


def _stated_light(special: Mapping[str, object]) -> tuple[str, object] | None:
    """Return the parameter that states the light of a scene, and its value; None without one.

    special : values of the parameters that pixsim reads itself
    """
    stated = [(name, special[name]) for name in _LIGHTS if special[name] is not None]
    if len(stated) > 1:
        (first, _), (name, value), *_ = stated
        raise invalid(
            name,
            f"'{value}' together with {first}",
            "one of them",
            "A white diffuser at E lx has a luminance of E / π cd/m².",
        )
    return stated[0] if stated else None


def _lamp_factor(
    text: SceneText, values: Mapping[str, str], light: tuple[str, object] | None
) -> float | None:
    """Return the radiance of white over the irradiance of the beam that the parameter `lamp` of a
    chart names; None without it.

    light : of `_stated_light`
    """
    has_lamp = LAMP in values and LAMP not in text.names
    if has_lamp and EMITTER_SCALE in values:
        raise invalid(
            LAMP, f"a lamp together with {EMITTER_SCALE}, the scale of D65", "one of them"
        )
    if INCIDENCE not in values or INCIDENCE in text.names:
        return math.cos(math.radians(_INCIDENCE_DEG)) / math.pi if has_lamp else None

    if not has_lamp or light is not None:
        got = f"together with {light[0]}" if light else f"without a {LAMP}"
        hint = "A matt part looks the same from any direction of the light that falls on it."
        raise invalid(INCIDENCE, got, f"the angle of a {LAMP} of its own irradiance", hint)
    try:
        incidence_deg = float(values[INCIDENCE])
    except ValueError:
        incidence_deg = math.nan
    if not 0 <= incidence_deg <= _MAX_INCIDENCE_DEG:
        allowed = f"0, along the normal, to {_MAX_INCIDENCE_DEG:g} degrees"
        raise invalid(INCIDENCE, value_text(values[INCIDENCE]), allowed)
    return math.cos(math.radians(incidence_deg)) / math.pi


def _with_white_lamps(scene: Scene, text: SceneText, names: object) -> Scene:
    """Return the scene with the ids of the emitters that are its white.

    names : of the user. None takes the file's
    """
    state = scene.parse()
    words = text.defaults.get(WHITE_LAMPS, "") if names is None else str(names)
    white_lamps = tuple(dict.fromkeys(words.replace(",", " ").split()))
    if not white_lamps:
        return scene
    white_spectra(state, find_lamps(state, scene.choice.reading), white_lamps)
    return replace(scene, white_lamps=white_lamps)


def _check_renderable(scene: Scene) -> None:
    """Raise PixsimError for what cannot be rendered."""
    state = scene.parse()
    sensor = sensor_node(state, scene.sensor_id)[1]
    # Another f-number may be chosen.
    options = CameraOptions(f_number=Camera().f_number)
    _read_camera(sensor, Camera().die_mm, options=options)
    scene.film_size(state)
    scene.sample_count(state)
    _check_air(state)
    check_textures(state)


def _check_names(text: SceneText, names: Sequence[str], packaged_chart: str) -> None:
    """Raise PixsimError for a name that is no parameter of a scene.

    packaged_chart : file of a packaged chart that the scene shows; empty for others
    """
    needed = {
        **{name: {EMITTER_SCALE} for name in (LUMINANCE, IRRADIANCE, LAMP, INCIDENCE)},
        ILLUMINANCE: {EMITTER_SCALE, ILLUMINANCE},
        WHITE: {WHITE},
        WHITE_LAMPS: {WHITE_LAMPS},
        _CHART_LINEAR: {CHART},
    }
    stated = text.names | text.defaults.keys()
    allowed = text.names | {name for name, others in needed.items() if others & stated}
    allowed |= {
        ASSETS,
        RESOLUTION,
        SAMPLES_PER_CELL,
        *_PARAMETERS_OF_CHARTS.get(packaged_chart, ()),
    }
    unknown = [name for name in names if name not in allowed]
    if not unknown:
        return

    hint = did_you_mean(unknown[0], allowed)
    settings = [".".join(path) for path in names_meant(Run.__name__, ["scene"], unknown[0])]
    if settings and not hint:
        hint = (
            f"The setting with this name is {' or '.join(settings)}, not a parameter of the scene."
        )
    raise invalid("scene parameter", f"'{unknown[0]}'", ", ".join(sorted(allowed)), hint)


def _picture_of_chart(path: Path, values: dict[str, str]) -> Path | None:
    """Return the file that the parameter `chart` names, if it is a picture to convert."""
    name = values.get(CHART, "")
    if not name or "\0" in name:
        return None
    folder = Path(os.path.realpath(path)).parent
    for file in (folder / name, Path(name)):
        if file.is_file():
            return Path(os.path.abspath(file)) if is_own_chart(file) else None
    return None


def _with_own_chart(scene: Scene, text: SceneText, picture: Path | None, linear: bool) -> Scene:
    """Return the scene with a picture as its chart, where the scene takes neutral textures
    there.
    """
    takes_picture = False
    if picture:
        textures = nodes_of(parse_tree(text.text, scene.choice.reading), "Texture")
        takes_picture = any(
            is_neutral(node) and str(node.get("filename", "")) == str(picture)
            for _, node in textures
        )

    is_encoded = picture is not None and picture.suffix.lower() not in LINEAR_SUFFIXES
    if linear and not (takes_picture and is_encoded):
        name = scene.parameters.get(CHART, "")
        chart = f"with the chart '{Path(name).name}'" if name else "without a chart"
        raise invalid(
            _CHART_LINEAR,
            f"1 (--linear) {chart}",
            "a PNG, JPEG or TIFF as -D chart=FILE; other charts are linear already",
        )
    if not takes_picture or picture is None:
        return scene
    return replace(scene, own_chart=OwnChart(picture, linear))


def _with_target(scene: Scene) -> Scene:
    """Return the scene with the target of its parameters as its chart."""
    if absent := {_CHART_HALF_WIDTH, _CHART_HALF_HEIGHT} - scene.names:
        got = f"'{scene.path.name}' without the parameter {min(absent)}"
        raise invalid(
            "target",
            got,
            f"a chart plane scaled by ${_CHART_HALF_WIDTH} and ${_CHART_HALF_HEIGHT}, whose size is"
            " known",
        )
    with_target = replace(scene, shows_target=True, names=scene.names.union(Target.model_fields))
    _ = with_target.target  # raises for wrong parameters
    return with_target


def _beyond(value: object) -> Beyond | None:
    if value is None or value == "hold" or value == "zero":
        return value
    raise invalid(f"scene.{_BEYOND_TABLES}", value_text(value), "'hold' or 'zero'")


def _flag(name: str, value: object) -> bool:
    words = str(value).lower()
    if words in ("1", "1.0", "true"):  # TOML's true may come as 1.0
        return True
    if words in ("0", "0.0", "false"):
        return False
    raise invalid(name, repr(value), "1 or 0")


def _with_light_of_white(
    scene: Scene, text: SceneText, name: str, stated: object, keeps_white: bool
) -> Scene:
    """Return the scene with the light of texel value 1, a white diffuser, which a white of its file
    follows.

    name : `LUMINANCE` of white; `ILLUMINANCE` or `IRRADIANCE` on it, π times its radiance
    keeps_white : whether the user set the luminance of white
    """
    value = _positive(name, stated)
    if name != LUMINANCE:
        value /= math.pi
    unit = scene.with_parameters(**{EMITTER_SCALE: "1"}).parse()
    lamp = find_lamp(unit, scene.choice.reading)
    unit_value = 0.0
    if lamp is not None and name == IRRADIANCE:
        unit_value = lamp.radiance_w_per_m2_sr
    elif lamp is not None and lamp.has_luminance:
        unit_value = lamp.luminance_cd_per_m2
    if not unit_value > 0:
        got = f"{value_text(stated)}, but the {'irradiance' if name == IRRADIANCE else 'luminance'}"
        allowed = "emitters that share one spectrum and are brighter than 0"
        hint = f"The light of an infrared lamp is stated as {caller.parameter(IRRADIANCE, '5')}."
        raise invalid(name, f"{got} of the emitters is unknown or 0", allowed, hint)

    scale = value / unit_value
    if scene.lamp_factor is not None:
        return replace(scene, strength=scale)
    white_cd_per_m2 = scene.white_cd_per_m2
    if white_cd_per_m2 is not None and not keeps_white and EMITTER_SCALE in text.defaults:
        white_cd_per_m2 *= scale / _positive(EMITTER_SCALE, text.defaults[EMITTER_SCALE])
    scaled = scene.with_parameters(**{EMITTER_SCALE: repr(scale)})
    return replace(scaled, white_cd_per_m2=white_cd_per_m2)


def _with_illuminance(
    scene: Scene, text: SceneText, name: str, lux: object, keeps_white: bool
) -> Scene:
    """Return the scene with all lamps times one factor, so that the place of its <default> lux has
    this illuminance.

    text : of the scene
    keeps_white : whether the user set the luminance of white, which otherwise follows the light
    """
    value = _positive(name, lux)
    place = f"{ILLUMINANCE} in '{scene.path.name}'"
    stated = _positive(place, text.defaults[ILLUMINANCE])

    reading = scene.choice.reading
    parameter_names = list(scene.parameters)
    lamps = find_lamps(scene.parse(), reading)
    written_lamps = lamps
    if parameter_names:
        written_lamps = find_lamps(replace(scene, parameters={}).parse(), reading)
    factor = strength(value, stated, written_lamps, lamps, parameter_names)

    white_cd_per_m2 = scene.white_cd_per_m2
    if white_cd_per_m2 is not None and not keeps_white:
        white_cd_per_m2 *= value / stated
    scaled = replace(
        scene.with_parameters(**{ILLUMINANCE: lux}),
        strength=factor,
        white_cd_per_m2=white_cd_per_m2,
    )
    scaled.text()  # raises for lamps without a number to scale
    return scaled


# Luminances in cd/m² and illuminances in lux: below a photon a year on a pixel, to a million suns.
_LIGHT_RANGE = (1e-12, 1e15)


def _positive(name: str, value: object) -> float:
    try:
        number = float(str(value))
    except ValueError:
        number = math.nan
    low, high = _LIGHT_RANGE if name in (*_LIGHTS, WHITE) else (SMALLEST, LARGEST)
    if not low <= number <= high:
        raise invalid(name, value_text(value), f"a positive number, {low:g} to {high:g}")
    return number


def _check_air(state: Tree) -> None:
    """Raise PixsimError for a camera in a medium."""
    for _, node in nodes_of(state, "Sensor"):
        if any(state.nodes[index].kind == "Medium" for index in children(node, state).values()):
            raise invalid(
                "sensor",
                "a camera in a medium",
                "a camera in air",
                "Let the medium begin in front of the lens.",
            )


def sensor_node(state: Tree, sensor_id: str | None) -> tuple[int, Node]:
    """Return the index and the node of the scene's sensor. Raises PixsimError if it is missing,
    ambiguous or not a thin lens.
    """
    sensors = nodes_of(state, "Sensor")
    ids = ", ".join(f"'{node.id}'" for _, node in sensors)
    if sensor_id is not None:
        sensors = [(index, node) for index, node in sensors if node.id == sensor_id]
    if len(sensors) != 1:
        got = f"sensors {ids}" if ids else "no sensor"
        if ids and sensor_id:
            got += f", none named '{sensor_id}'"
        hint = "Choose one with --sensor ID." if ids else ""
        raise invalid("scene", got, "one thinlens sensor", hint)

    index, node = sensors[0]
    if node.plugin != SENSOR:
        raise invalid("sensor", f"'{node.plugin}'", ALLOWED_SENSOR, REASONS["sensor"])
    for name in ("principal_point_offset_x", "principal_point_offset_y"):
        offset = float(node.get(name, 0.0))
        if offset:
            allowed = "0, since the die is centred on the lens axis"
            raise invalid("sensor", f"{name} = {offset:g}", allowed)
    for name in ("aperture_radius", "focus_distance"):
        if name not in node:
            allowed = "fov, aperture_radius and focus_distance, in metres"
            raise invalid("sensor", f"a thinlens without {name}", allowed)
    return index, node


def check_resolution(side: int) -> None:
    """Raise PixsimError for a film with a side of that many samples that cannot be rendered."""
    low, high = _ALLOWED_RESOLUTION
    if not low <= side <= high:
        raise invalid(RESOLUTION, side, f"{low} to {high}")


def _child(state: Tree, sensor: Node, kind: str) -> Node | None:
    """Return the sensor's film or sampler, or None."""
    for index in children(sensor, state).values():
        if state.nodes[index].kind == kind:
            return state.nodes[index]
    return None


def _whole(node: Node | None, name: str, default: int) -> int:
    if node is None or name not in node:
        return default
    value: int = node[name]
    return value


def _fov_x_deg(sensor: Node, aspect: float = 1.0) -> float:
    """Return the horizontal field of view, from `fov` along its axis or `focal_length` (35 mm
    equivalent).

    aspect : width of the film over its height
    """
    axis = str(sensor.get("fov_axis", "x"))
    if "focal_length" in sensor:
        equivalent_mm = _positive("focal_length", str(sensor["focal_length"]).removesuffix("mm"))
        tangent = math.hypot(*_FILM_35_MM) / 2 / equivalent_mm
        axis = "diagonal"
    elif "fov" in sensor:
        fov_deg = _positive("fov", sensor["fov"])
        if fov_deg >= 180:
            raise invalid("fov", f"{fov_deg:g}", "between 0 and 180 degrees")
        tangent = math.tan(math.radians(fov_deg) / 2)
    else:
        raise invalid("sensor", "a thinlens without fov", "fov, aperture_radius and focus_distance")

    if axis == "smaller":
        axis = "y" if aspect > 1 else "x"
    elif axis == "larger":
        axis = "y" if aspect < 1 else "x"
    factor = 1.0
    if axis == "y":
        factor = aspect
    elif axis == "diagonal":
        factor = 1 / math.hypot(1, 1 / aspect)
    return math.degrees(2 * math.atan(tangent * factor))


def _read_camera(
    sensor: Node, die_mm: float, aspect: float = 1.0, options: CameraOptions | None = None
) -> Camera:
    """Return the camera of a thinlens node; f and N are rounded to six digits, since XMLs round the
    field of view.

    aspect : width of the film over its height
    options : whose values replace the node's, before these are checked
    """
    aperture_m = _positive("aperture_radius", sensor["aperture_radius"])
    focus_m = _positive("focus_distance", sensor["focus_distance"])
    geometry = values_of_lens_geometry(_fov_x_deg(sensor, aspect), aperture_m, focus_m, die_mm)
    for name in ("focal_length_mm", "f_number"):
        geometry[name] = float(f"{geometry[name]:.6g}")
    if options:
        names = {"focal_length_mm", "f_number", "object_distance_m"}
        geometry |= options.model_dump(exclude_none=True, include=names)
    try:
        return Camera(**geometry)
    except PixsimError as error:
        raise PixsimError(f"the scene's lens with a die of {die_mm:g} mm: {error}") from None


def hash_of_tree(state: Tree) -> str:
    """Return a hash of a parsed tree and its textures, 16 hexadecimal digits. Raises PixsimError if
    a file is missing.
    """
    tree = []
    for node in state.nodes:
        values = []
        for name, value in plain_values(node, numbers_only=False):
            text = _all_digits(value)
            if name == "filename" and os.path.isabs(text):
                # Not the folder of a file, such as the cache of charts: its bytes follow.
                text = Path(text).name
            values.append((name, text))
        tree.append([node.kind, node.plugin, sorted(values), sorted(children(node, state).items())])
    return content_hash([tree, [digest_of(path) for path in files_of_scene(state)]])


def _all_digits(value: object) -> str:
    """Return a property with all its digits."""
    return f"{value.wavelengths} {value.values}" if isinstance(value, SpectrumTable) else str(value)
