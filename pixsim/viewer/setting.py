"""All that a frame and its score depend on, for a run and a study alike."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Annotated, Any, Self

from pydantic import Field, model_validator

from pixsim.base.layers import Layer
from pixsim.base.problems import Words
from pixsim.base.records import NumberOrText, Record
from pixsim.light.quantities import FilmSamples
from pixsim.optics.camera import PIXELS_OR_FILM, CameraOptions
from pixsim.optics.lens_options import LensOptions
from pixsim.optics.quantities import DieWidth
from pixsim.sensor.correction_options import Correction
from pixsim.sensor.exposure import Exposure
from pixsim.sensor.motion_options import Motion, motion_text
from pixsim.sensor.pixel_options import Pixel, PixelOptions
from pixsim.sensor.quantities import Seconds
from pixsim.viewer.develop_options import Develop, check_develop
from pixsim.viewer.display_options import Display
from pixsim.viewer.merging import merged
from pixsim.viewer.metric_options import METRIC_OPTIONS, MetricNames, MetricOptions
from pixsim.viewer.requirements import RequirementText, requirement_of

Seed = Annotated[int, Field(ge=0, lt=2**63)]  # as TOML holds


_PIXEL_WORDS = Words(also=("sensor",))


class Effort(Record):
    """What a result may cost: error tolerances, the film, the time limit, and the part of the
    die.
    """

    tolerance_e: Annotated[float, Field(ge=1e-9, lt=1)] = Field(
        1e-3,
        description=(
            "largest relative error of the mean electrons from simplifications of the render"
        ),
    )
    tolerance_delta_e: Annotated[float, Field(ge=1e-9, le=1e3)] | None = Field(
        None,
        description=(
            "largest error of the mean ΔE by the film, and by the noise of the render (absent: the"
            " larger of 0.01 and 2 %; 100 accepts any noise)"
        ),
    )
    render_noise: Annotated[float, Field(ge=1e-6, le=1e6)] | None = Field(
        None,
        description=(
            "largest render noise, as a fraction of the sensor's temporal noise, beside the"
            " tolerances of the metrics (absent: these alone end a render)"
        ),
    )
    resolution: Annotated[FilmSamples | None, Words(instead={"resolution": PIXELS_OR_FILM})] = (
        Field(
            None,
            description=(
                "film samples across the die (absent: chosen from the pixel, the lens and the"
                " display)"
            ),
        )
    )
    max_seconds: Seconds | None = Field(
        None,
        description=(
            "time after which a render ends, with a warning that states its noise; unfinished"
            " work is discarded (absent: a number of samples limits it, which does not depend on"
            " the machine)"
        ),
    )
    window_mm: DieWidth | None = Field(
        None,
        description=(
            "width of a central part of the die in mm: the same lens and pixels on a smaller die"
            " (absent: the whole die)"
        ),
    )


class RunScene(Record):
    """The scene of a run."""

    file: str | None = Field(
        None,
        description=(
            "XML file or name of a packaged scene, or a spectral image from another program (.exr,"
            " .npz, .hdr)"
        ),
    )
    parameters: dict[str, NumberOrText] = Field(
        default_factory=dict, description="values of the scene's <default> parameters"
    )


class Setting(Effort):
    """All that a frame depends on, for a run and a study alike; a study has the size of its pixel
    elsewhere.
    """

    seed: Seed = Field(0, description="seed of the render, the sensors and their noise")
    scene: RunScene = Field(RunScene(), description="scene and its parameters")
    camera: CameraOptions = Field(CameraOptions(), description="camera; replaces that of the scene")
    lens: LensOptions = Field(
        LensOptions(),
        description=(
            "veil and fall-off of the lens, and a real one in place of the camera's thin one"
        ),
    )
    pixel: Annotated[PixelOptions, _PIXEL_WORDS] = Field(
        PixelOptions(), description="pixel, without technology and pitch"
    )
    exposure: Exposure = Field(Exposure(), description="exposure of each frame")
    motion: Motion = Field(Motion(), description="how fast the scene moves in each exposure")
    correction: Correction = Field(
        Correction(), description="correction of each frame by the camera"
    )
    develop: Develop = Field(
        Develop(), description="how frames with colour filters become pictures"
    )
    display: Display = Field(Display(), description="display, viewer and metric")
    metrics: MetricNames = Field(
        ("delta_e",),
        description=(
            "metrics of each frame; a study finds the best pixel by each, and reports the first"
        ),
    )
    metric: MetricOptions = Field(METRIC_OPTIONS, description="settings of the metrics")
    noise_budget: bool = Field(
        False,
        description=(
            "also report electrons and ΔE by cause for the first sensor, each cause switched off"
            " in turn"
        ),
    )

    @classmethod
    def _merged(cls, layers: Iterable[Layer]) -> dict[str, Any]:
        """Merge the tables of all layers, as `pixsim.viewer.merging.merge`; later layers take
        precedence.
        """
        return merged(layers)


def stage_words(setting: Setting) -> list[str]:
    """What is on between the light on the sensor and the frame, in words for headlines, in the
    order of the light.
    """
    exposure = setting.exposure
    veil = setting.lens.veiling_glare
    words = []
    if veil:
        amount = f"{100 * veil:.3g} %" if isinstance(veil, float) else "by wavelength"
        words.append(f"veiling glare {amount}")
    if setting.motion.is_on:
        words.append(motion_text(setting.motion))
    if exposure.line_time_s:
        words.append(f"rolling shutter, {exposure.line_time_us:g} µs a row")
    if exposure.flickers:
        words.append(
            f"light flickers at {exposure.flicker_hz:g} Hz by"
            f" {100 * (exposure.flicker_depth or 0.0):.3g} %"
        )
    if exposure.frames > 1:
        words.append(f"each frame the sum of {exposure.frames} exposures")
    return words


class Run(Setting):
    """The options of `pixsim run`, as tables."""

    pixel: Annotated[Pixel, _PIXEL_WORDS] = Field(Pixel(), description="pixel of the sensor")
    require: tuple[RequirementText, ...] | None = Field(
        None,
        description=(
            "limits on metrics of the run, such as detectability>=5; the result says whether it"
            " meets each"
        ),
    )

    @model_validator(mode="after")
    def _requires_its_metrics(self) -> Self:
        for text in self.require or ():
            name = requirement_of(text).metric
            if name not in self.metrics:
                raise ValueError(
                    f"got require = {text!r}; allowed: limits on the run's metrics,"
                    f" {', '.join(self.metrics)}. Add {name} to metrics"
                )
        return self

    @model_validator(mode="after")
    def _frame_can_be_developed(self) -> Self:
        check_develop(self.develop, self.pixel)
        return self

    @model_validator(mode="after")
    def _pixels_make_the_die(self) -> Self:
        self.__dict__["camera"] = self.camera.with_die(
            self.pixel.pitch_um if "pitch_um" in self.pixel.model_fields_set else None
        )
        return self
