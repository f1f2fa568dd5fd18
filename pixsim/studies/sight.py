"""What the pixels of a study's cases see on their films: of those that see the same, the film of the clearest is measured.

The error of a film is detail that its samples miss, and noise hides detail. So where a film is fine enough in one case by a wide
margin (`FilmError.surely_met`), it is so in all cases that see the same picture with less light, more noise or more blur by
diffraction. Measured on films of 1024 samples with 3 sensors, f/1.4 to f/16, 4 displays and 1 to 1000 cd/m²: errors of 1e-9 to
8e-4 ΔE, in no order by light or lens.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import astuple, dataclass
from typing import Any

import numpy as np

from pixsim.base.records import content_hash
from pixsim.light.spectral import SpectralImage
from pixsim.scene.rules import Chart
from pixsim.sensor.integration import collecting_area_um2, electrons_per_joule
from pixsim.sensor.noise import SOURCES
from pixsim.studies.budget import without_warnings
from pixsim.studies.film_error import FilmSampling
from pixsim.viewer.display import white_rate
from pixsim.viewer.imaging import Imaging
from pixsim.viewer.score import SeenPicture, white_header

DIGITS = 9  # of the light relative to white; the rest are rounding errors
ROUNDING = 10.0**-DIGITS
# What a camera states of a lens that only diffraction blurs; anything else may blur the picture less at a larger f-number.
THIN_LENS = {"focal_length_mm", "f_number", "die_mm", "die_height_mm", "object_distance_m", "transmittance"}


@dataclass(frozen=True)
class Sight:
    """What pixels see of a picture on its film.

    what : hash of the picture relative to display white, of the camera without its f-number, of display, exposure, correction and
        pixels without their noise
    f_number : of a thin lens, which blurs the picture more the larger it is; 0 where it is in `what`, as for pixels with a stack,
        which see the angles of light
    white_e_per_s : photo-electrons of display white, for each channel of each pixel
    noise : for each pixel, its dark current and the standard deviations of its noise and its fixed pattern
    """

    what: str
    f_number: float
    white_e_per_s: tuple[float, ...]
    noise: tuple[tuple[float, ...], ...]

    @classmethod
    def of(cls, image: SpectralImage, measured: Sequence[Imaging], chart: Chart | None) -> Sight | None:
        """Return what pixels see of a picture; None if its film has too few samples for its details, or no factors.

        measured : the pixels, with one camera and display
        """
        first = measured[0]
        camera, display, exposure, pixels = first.camera, first.display, first.exposure, [each.physics for each in measured]
        samplings = [FilmSampling.of(image.shape[1], each, chart) for each in measured]
        if not image.factors or not all(sampling.is_fine for sampling in samplings):
            return None
        with without_warnings():  # the run itself warns of the white
            white = white_header([SeenPicture(image, camera, physics) for physics in pixels], display)
            shown = image.with_planes(image.whole.planes, header=image.header | white, margin=image.margin)
        whites = [[white_rate(shown, camera, channel, display) for channel in physics.channels] for physics in pixels]
        light = [
            electrons_per_joule(channel, image) * image.factors[0] / white
            for physics, of_channels in zip(pixels, whites, strict=True)
            for channel, white in zip(physics.channels, of_channels, strict=True)
        ]
        # A chart without the light's fall-off, which has no detail; a stack collects light by its angle.
        is_thin = not any(value for name, value in camera if name not in THIN_LENS)
        by_lens = chart is not None and is_thin and not any(p.stack for p in pixels)
        picture = chart.digest if chart and by_lens else np.ascontiguousarray(image.planes).data
        what: dict[str, Any] = {
            "picture": hashlib.blake2b(picture, digest_size=16).hexdigest(),
            "film": [image.shape, image.pitch_um, image.header.get("diffraction")],
            "light": [(values / values.max()).round(DIGITS).tolist() for values in light],
            "brightest": [f"{values.max():.{DIGITS}g}" for values in light],
            "camera": camera.model_dump(exclude={"f_number"} if by_lens else set()),
            "display": display.model_dump(exclude={"white_cd_per_m2"}),
            "exposure": [each.model_dump() for each in (exposure, first.motion, first.correction, first.develop)],
            # In a time that is set, bright light saturates pixels; an automatic one leaves them below their well.
            "whites": None if exposure.integration_s is None else whites,
            "pixels": [
                [
                    *(str(p.layout), p.pitch_um, p.photodiode_side_um, p.full_well_e, p.saturation_e, p.dn_per_e),
                    *(p.pixel.bits, p.pixel.black_level_dn, p.pixel.conversion, p.pixel.well_limit),
                    p.charge.content_hash if p.charge else "",
                    p.efficiency_f_number,
                    p.efficiency_stack and astuple(p.efficiency_stack),
                ]
                for p in pixels
            ],
        }
        noise = [(p.dark_current_e_per_s, *(source.of_frame(p) for source in SOURCES)) for p in pixels]
        areas_um2 = [collecting_area_um2(image, camera, p) for p in pixels]
        white_e_per_s = [white * area for each, area in zip(whites, areas_um2, strict=True) for white in each]
        return cls(content_hash(what), camera.f_number if by_lens else 0.0, tuple(white_e_per_s), tuple(noise))

    @property
    def order(self) -> tuple[Any, ...]:
        """A place for sorting, which is not behind those of sights that this is as clear as."""
        return self.f_number, [-white for white in self.white_e_per_s], self.noise

    def is_as_clear_as(self, other: Sight) -> bool:
        """Return whether this shows the same as the other, with no less light, and no more noise or blur."""
        if self.what != other.what:  # sensors of other filters have other numbers of channels
            return False
        brighter = np.array(self.white_e_per_s) >= np.array(other.white_e_per_s) * (1 - ROUNDING)
        cleaner = np.array(self.noise) <= np.array(other.noise) * (1 + ROUNDING)
        sharper = self.f_number <= other.f_number
        return sharper and bool(brighter.all() and cleaner.all())


def clearest(sights: Mapping[str, Sight]) -> dict[str, str]:
    """Return for each name the name of a sight that is as clear and shows the same, from as few different ones as possible."""
    clear_first = sorted(sights, key=lambda name: sights[name].order)
    chosen: dict[str, str] = {}
    for name in clear_first:
        others = (other for other in dict.fromkeys(chosen.values()) if sights[other].is_as_clear_as(sights[name]))
        chosen[name] = next(others, name)
    return chosen
