"""From a frame to its score: development, the dots of a screen, and the difference from the ideal
picture.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from pixsim.base.arrays import Array
from pixsim.base.errors import PixsimError, invalid
from pixsim.base.lazy import cached_property
from pixsim.sensor.collection import Collection, ColourCollection, shading_of
from pixsim.sensor.exposure import Exposure
from pixsim.sensor.reading import Readout
from pixsim.sensor.readout import Frame, integration_time_s, make_frame, with_shared_time
from pixsim.viewer import display as displays
from pixsim.viewer.colour_matrix import metamerism_index
from pixsim.viewer.develop import ColourChart
from pixsim.viewer.develop_steps import (
    UndevelopedFrame,
    developed_planes,
    light_of_dots,
    noise_covariance,
)
from pixsim.viewer.imaging import Imaging
from pixsim.viewer.score import FrameScore
from pixsim.viewer.screen import Screen, display_image, is_coloured
from pixsim.viewer.sharpening import noise_gain
from pixsim.viewer.tone import toned

MIN_RADIUS_PX, MAX_RADIUS_PX = 0.1, 100.0  # of the blur of sharpening


@dataclass(frozen=True)
class Development:
    """How the frames of one pixel type become pictures on a screen, and their scores.

    readout : how its pixels are read, at the gain of the exposure
    exposure : of the frames, whose time may be known
    signal_e_per_s : expected light of every value of a frame, (rows, columns)
    whites_e_per_s : electrons per second of the scene's white, on axis, in each channel
    colour_chart : what the channels respond to its patches, or None for a monochrome sensor
    collection : light that reaches the photodiodes through the pixels' stack, or None without a
        stack
    """

    imaging: Imaging
    readout: Readout
    exposure: Exposure
    signal_e_per_s: Array = field(repr=False)
    whites_e_per_s: tuple[float, ...]
    screen: Screen
    colour_chart: ColourChart | None = None
    collection: Collection | ColourCollection | None = field(default=None, repr=False)

    @property
    def white_e_per_s(self) -> float:
        """Electrons per second of the scene's white on axis, in the mean over the channels'
        pixels.
        """
        layout = self.readout.physics.layout
        whites = self.whites_e_per_s
        return whites[0] if layout is None else float((layout.shares * np.array(whites)).sum())

    @cached_property
    def flat_field(self) -> Array | None:
        """Light that each pixel collects of a uniform field, relative to a pixel on axis, (rows,
        columns), or None without a stack.
        """
        return (
            None if self.collection is None else self.collection.relative(self.signal_e_per_s.shape)
        )

    @cached_property
    def shading(self) -> Array | None:
        """Factors by which a frame is divided before display, (rows, columns), or None."""
        if not self.screen.display.shading_correction:
            return None
        return shading_of(self.collection, self.signal_e_per_s.shape, self.imaging.correction)

    @cached_property
    def matrix(self) -> Array:
        """Matrix from balanced channels to the light of the display's primaries, (3, C); only for
        colour sensors.

        Raises PixsimError as `ColourChart.matrix` does, with the pixel's pitch.
        """
        try:
            return self._fitted_matrix()
        except PixsimError as error:
            message = f"pixels of {self.readout.physics.read_pitch_um:g} µm: {error}"
            if self.collection is not None:
                message += (
                    " Crosstalk between neighbours matters: larger pixels mix the channels less."
                )
            raise type(error)(message) from None

    def _fitted_matrix(self) -> Array:
        assert self.colour_chart is not None
        develop = self.imaging.develop
        if develop.matrix != "noise_aware":
            return self.colour_chart.matrix(develop)
        time_s = integration_time_s(self.exposure, self.readout, float(self.signal_e_per_s.max()))
        return self.colour_chart.matrix(develop, self.channel_covariance(time_s))

    def channel_covariance(self, integration_s: float) -> Array:
        """Return the covariance of the balanced channels on each patch of the chart, (P, C, C), as
        means over a dot.

        In closed form, without what noise reduction that adapts to the picture takes away.
        """
        assert self.colour_chart is not None
        empty = np.zeros(self.signal_e_per_s.shape, np.int32)
        frame = make_frame(
            empty,
            0.0,
            self.signal_e_per_s,
            self.readout,
            with_shared_time(self.exposure, integration_s),
        )
        return noise_covariance(
            self.undeveloped(frame, matrix=None), self.colour_chart.responses, self.screen.dot_um
        )

    def colour_facts(self, integration_s: float) -> dict[str, Any]:
        """Return the entries of a colour sensor in score.json: its channels, matrix and noise in an
        exposure.
        """
        layout = self.readout.physics.layout
        assert self.colour_chart is not None
        assert layout is not None
        errors = self.colour_chart.errors(self.matrix)
        dot_um = self.screen.dot_um
        pitch_um = self.readout.physics.read_pitch_um
        whites_e = (np.array(self.whites_e_per_s) * integration_s).tolist()
        return {
            "layout": str(layout),
            "white_spectrum": self.colour_chart.lamp,
            "white_e": dict(zip(layout.channels, whites_e, strict=True)),
            "matrix_to_display": self.matrix.tolist(),
            "noise_gains": np.sqrt((self.matrix**2).sum(axis=1)).tolist(),
            "patches_mean_delta_e": float(errors.mean()),
            "sensitivity_metamerism_index": metamerism_index(errors),
            "ideal_is_coloured": is_coloured(self.screen.ideal),
            "dots_per_pixel": 1.0 if dot_um is None else pitch_um / dot_um,
        }

    @property
    def sharpen_px(self) -> float:
        """Standard deviation, in pixels, of the blur of sharpening. Raises PixsimError for one that
        is too wide.
        """
        develop = self.imaging.develop
        pitch_um = self.readout.physics.read_pitch_um
        if develop.sharpen_radius_cy_per_deg is None:
            return develop.sharpen_radius_px or 1.0
        dots = self.screen.display.samples_per_deg / (
            2 * math.pi * develop.sharpen_radius_cy_per_deg
        )
        pixels = dots * (self.screen.dot_um or pitch_um) / pitch_um
        if not pixels <= MAX_RADIUS_PX:
            got = (
                f"{develop.sharpen_radius_cy_per_deg:g}, a blur of {pixels:.3g} pixels of"
                f" {pitch_um:g} µm"
            )
            raise invalid(
                "develop.sharpen_radius_cy_per_deg",
                got,
                f"up to {MAX_RADIUS_PX:g} pixels",
                "Raise it.",
            )
        return max(pixels, MIN_RADIUS_PX)

    @property
    def sharpening_noise_gain(self) -> float:
        """By how much sharpening amplifies the standard deviation of noise that is independent from
        pixel to pixel.
        """
        return noise_gain(self.imaging.develop.sharpen_amount, self.sharpen_px)

    def undeveloped(self, frame: Frame, matrix: Array | None) -> UndevelopedFrame:
        """Return a frame with the inputs of its development.

        matrix : from the channels to the display's primaries. None leaves it out
        """
        develop = self.imaging.develop
        time_s = frame.integration_s
        return UndevelopedFrame(
            frame,
            self.imaging,
            self.readout,
            np.array(self.whites_e_per_s) * time_s,
            self.shading,
            self.screen.in_float32,
            self.signal_e_per_s * time_s if develop.denoise == "wiener_bound" else None,
            self.sharpen_px if develop.sharpens else 1.0,
            matrix,
        )

    def light(self, frame: Frame, window: Callable[[Array], Array] | None = None) -> Array:
        """Return a frame's picture before the display clips and rounds it: luminance (H, W), or
        light of the primaries (3, H, W), 1 for white.

        window : selects a part of the dots. None takes all
        """
        return self.toned(self.light_before_tone(frame, window))

    def toned(self, light: Array) -> Array:
        """Return light behind the tone curve."""
        return toned(light, self.imaging.develop, self.screen.display)

    def light_before_tone(
        self, frame: Frame, window: Callable[[Array], Array] | None = None
    ) -> Array:
        """Return `light` without the tone curve."""
        undeveloped = self.undeveloped(frame, None if self.colour_chart is None else self.matrix)
        return self.mixed_on_dots(developed_planes(undeveloped), undeveloped, window)

    def mixed_on_dots(
        self,
        planes: Sequence[Array],
        undeveloped: UndevelopedFrame,
        window: Callable[[Array], Array] | None = None,
    ) -> Array:
        """Return the light of developed planes on the dots, before the tone curve.

        undeveloped : their frame, with the matrix
        """
        screen = self.screen
        frame = undeveloped.frame
        means = [
            displays.on_dots(
                plane,
                frame.pitch_um,
                screen.size_um,
                screen.display,
                screen.dot_edges_um,
                frame.registration,
            )
            for plane in planes
        ]
        light = light_of_dots(means, undeveloped)
        if window is None:
            return light
        return window(light) if light.ndim == 2 else np.stack([window(plane) for plane in light])

    def score(self, frame: Frame) -> FrameScore:
        """Return the score of a frame as shown on the screen, with ΔE alone."""
        screen = self.screen
        light = self.light_before_tone(frame)
        out_of_gamut = None
        if light.ndim == 3:
            share = displays.out_of_gamut_share(np.moveaxis(light, 0, -1))
            out_of_gamut = screen.ideal_out_of_gamut, share
        image = display_image(self.toned(light), screen.display, in_place=True)

        # Pixels that fill the picture exactly may begin at -1e-18 µm.
        rows_um, columns_um = screen.dot_edges_um
        border_um = max(0.0, float(rows_um[0])), max(0.0, float(columns_um[0]))
        return FrameScore(
            screen.delta_e_map(image),
            screen.ideal,
            image,
            screen.display,
            frame=frame,
            readout=self.readout,
            border_um=border_um,
            out_of_gamut=out_of_gamut,
        )
