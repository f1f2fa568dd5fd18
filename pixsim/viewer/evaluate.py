"""From settings and light to a score: `evaluate`, and its steps, which commands share."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import TypeVar

from pixsim.base.bounds import Whole
from pixsim.base.hashes import content_hash
from pixsim.base.notes import Note, warn
from pixsim.light.spectral import SpectralImage
from pixsim.optics.camera import Camera
from pixsim.sensor.correction_options import Correction
from pixsim.sensor.exposure import Exposure
from pixsim.sensor.integration import electrons_per_joule
from pixsim.sensor.motion_options import Motion
from pixsim.sensor.pixel_options import Pixel
from pixsim.viewer.causes import causes_of, lightness_range
from pixsim.viewer.chain import ImagingChain, make_chain
from pixsim.viewer.develop_options import Develop, check_develop
from pixsim.viewer.display_options import Display
from pixsim.viewer.frame_under_test import FrameUnderTest, numbers_of
from pixsim.viewer.imaging import Imaging
from pixsim.viewer.metric_options import METRIC_OPTIONS, MetricOptions
from pixsim.viewer.metric_registry import metrics_named
from pixsim.viewer.metrics import (
    Metric,
    MetricContext,
    MetricRequest,
    NoNumberError,
    columns_with_numbers,
)
from pixsim.viewer.review import review
from pixsim.viewer.scene_light import SceneLight, prepare_scene
from pixsim.viewer.score import FrameScore, Score, noise_error_and_limit
from pixsim.viewer.screen import warn_of_clipping, white_header, with_white
from pixsim.viewer.without_effect import warn_of_settings

S = TypeVar("S", bound=Score)
# Chains that stay in memory.
MAX_CHAINS = 8
_MAX_CHAIN_BYTES = 1 << 27
_MAX_DIGESTED_BYTES = 1 << 27  # of light; a tenth of a second
# In the order of their last use; with `PreparedScene.beyond_white`.
_recent_chains: dict[str, tuple[ImagingChain, float]] = {}


def reviewed(imaging: Imaging, light: SceneLight) -> Imaging:
    """Check settings, and return them with the white of the light; warns for each note of the
    review.

    Warns, too, if the scene's white is estimated (`white_header`).
    """
    check_develop(imaging.develop, imaging.pixel)
    for note in review(imaging, light):
        warn(note)
    imaging = imaging.changed(
        display=with_white(imaging.display, white_header([(imaging, light.irradiance)]))
    )
    imaging.metrics.check(
        MetricContext(imaging.physics.layout is not None, light.background is not None)
    )
    return imaging


def reviewed_chain(imaging: Imaging, light: SceneLight, *, is_recent: bool = False) -> ImagingChain:
    """Check settings, and return their imaging chain; warns for each note of the review.

    is_recent : whether the chain stays in memory, with the last few others, for the same light and
        settings

    Warns, too, if the scene's white is estimated (`white_header`), and if the display clips the
    scene.
    """
    imaging = reviewed(imaging, light)
    irradiance = light.irradiance
    key = None
    if is_recent and not imaging.metrics.needs_light:
        key = _key_of_chain(imaging, irradiance)
    if key is not None and key in _recent_chains:
        chain, beyond_white = _recent_chains.pop(key)
        if chain.imaging.metrics != imaging.metrics:  # which decide nothing of the chain
            chain = replace(chain, imaging=imaging)
    else:
        scene = prepare_scene(imaging, light)
        chain = make_chain(imaging, scene)
        beyond_white = scene.beyond_white
        if key is not None:
            chain = replace(chain, scene=None)
    if key is not None:
        _add_recent(key, chain, beyond_white)
    warn_of_clipping(beyond_white, irradiance.header, imaging.display)
    return chain


def _key_of_chain(imaging: Imaging, irradiance: SpectralImage) -> str | None:
    """Return a key for all that a chain depends on, or None for large light and for chief ray
    angles from a file.
    """
    samples = irradiance.data if irradiance.factors is None else irradiance.factors[1]
    if samples.nbytes > _MAX_DIGESTED_BYTES or imaging.camera.chief_ray_angle is not None:
        return None
    physics = imaging.physics
    responses = [electrons_per_joule(channel, irradiance).tolist() for channel in physics.channels]
    charge = physics.charge.content_hash if physics.charge else ""
    names = "camera", "exposure", "display", "correction", "develop", "motion"
    records = [getattr(imaging, name).model_dump(mode="json") for name in names]
    pixel = [
        imaging.pixel.model_dump(mode="json"),
        imaging.technology.content,
        repr(physics),
        responses,
        charge,
    ]
    return content_hash(
        [
            irradiance.digest(),
            records,
            *pixel,
            imaging.border_um,
            imaging.in_float32,
            imaging.without_shortcuts,
        ]
    )


def _add_recent(key: str, chain: ImagingChain, beyond_white: float) -> None:
    """Add a chain, and drop the oldest ones if there are too many or they are too large."""
    _recent_chains[key] = chain, beyond_white
    sizes = [
        other.signal_e_per_s.nbytes + 3 * other.screen.ideal.nbytes
        for other, _ in _recent_chains.values()
    ]
    while len(sizes) > MAX_CHAINS or sum(sizes) > _MAX_CHAIN_BYTES:
        _recent_chains.pop(next(iter(_recent_chains)), None)
        sizes.pop(0)


def _evaluate_frame(
    chain: ImagingChain, key: tuple[object, ...], missing: dict[str, str] | None = None
) -> FrameScore:
    """Return the score of a new sensor and a new frame for a key, with the numbers of the metrics.

    missing : gets the reason, by the metric's name, why one has no number, which is NaN then. None
        raises a NoNumberError

    Raises NoNumberError if no metric has a number.
    """
    metrics = chain.imaging.metrics.chosen
    under_test = FrameUnderTest.of(chain, chain.capture(*key), stream=key)
    score = with_numbers(under_test.score, metrics, under_test, missing)
    if missing and len(missing) == len(metrics):
        raise NoNumberError(next(iter(missing.values())))
    return score


def with_numbers(
    score: S,
    metrics: Sequence[Metric],
    under_test: FrameUnderTest | Score,
    missing: dict[str, str] | None = None,
) -> S:
    """Return a score with the numbers of metrics.

    under_test : the frame of the score, or the score alone for metrics that need no frame
    missing : as for `_evaluate_frame`
    """
    others = [metric for metric in metrics if not metric.is_delta_e]  # a score has ΔE
    numbers = numbers_of(others, under_test, missing)
    further = {name: numbers[name] for name in columns_with_numbers(others, numbers)}
    first = {metric.name: further.get(metric.columns[0], score.mean_delta_e) for metric in metrics}
    return replace(score, metrics=first, further=further)


def evaluate(
    irradiance: SpectralImage,
    camera: Camera,
    pixel: Pixel,
    exposure: Exposure | None = None,
    display: Display | None = None,
    *,
    correction: Correction | None = None,
    develop: Develop | None = None,
    motion: Motion | None = None,
    seed: Whole = 0,
    full: bool = False,
    metrics: Sequence[str | Callable[[Score], float]] = ("delta_e",),
    metric: MetricOptions | None = None,
    without: SpectralImage | None = None,
) -> FrameScore:
    """Simulate one frame of one sensor, show it on a display, and compare it with the ideal image
    by S-CIELAB.

    camera : the one that the irradiance was rendered with
    exposure, display : None means the defaults
    correction : of the frame by the camera. None means none
    develop : of a frame into a picture. None means the default
    motion : of the scene. None means that it stands still
    seed : of the sensor's fixed pattern and its temporal noise
    full : use no shortcut for grey images (the result differs by rounding only)
    metrics : names of metrics, or functions of a Score, each a number in its own unit; they are the
        score's `metrics`. One that has no number for this frame, as NIIRS for one that is
        overexposed, is NaN, with a warning that says why
    metric : settings of the metrics. None means the defaults
    without : irradiance of the scene without its target, for the metric detectability

    Where neither the display nor the scene states its white, it is estimated, with a warning, as in
    `pixsim run`. What the frames of one sensor and one light share stays in memory for the next
    calls.

    Raises PixsimError if the pitch is too small or larger than the die, if white has no luminance,
    or the sensor no response to it.

    >>> import numpy as np
    >>> data = np.full((32, 32, 1), 1e-3)
    >>> light = SpectralImage([550.0], 10.0, 84.8, data=data, header={"diffraction": False})
    >>> pixel, display = Pixel(pitch_um=84.8, prnu=0), Display(white_cd_per_m2=1000, dots=32)
    >>> score = evaluate(light, Camera(), pixel, display=display)
    >>> score.delta_e.shape, round(float(score.image.mean() / score.ideal.mean()), 2)
    ((28, 28), 1.0)
    """
    imaging = Imaging.from_records(
        camera,
        pixel,
        exposure=exposure,
        display=display,
        correction=correction,
        develop=develop,
        motion=motion,
        metrics=MetricRequest(metrics_named(metrics), metric or METRIC_OPTIONS),
    ).changed(without_shortcuts=full)
    chain = reviewed_chain(imaging, SceneLight(irradiance, without), is_recent=True)
    warn_of_settings(imaging, irradiance)
    undefined: dict[str, str] = {}
    score = _evaluate_frame(chain, ("evaluate", seed), undefined)
    for reason in undefined.values():
        warn(Note("undefined_metric", words=reason))

    frame = score.frame
    causes = causes_of(
        chain.imaging,
        irradiance.header,
        white_e=chain.white_e_per_s * frame.integration_s,
        integration_s=frame.integration_s,
        lightness=lightness_range(score.ideal),
        saturated_fraction=frame.saturated_fraction,
    )
    for cause in causes:
        if cause.is_uninformative:
            warn(cause.note)
    light, limit = noise_error_and_limit(irradiance.header)
    ideal = score.ideal.copy()  # that of the chain stays in memory
    return replace(score, ideal=ideal, light=light, light_limit=limit, causes=causes)
