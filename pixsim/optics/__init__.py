"""Lenses: f-number, field and wavelength in, irradiance factor, optical transfer function and
wavefronts out.

What a user states: `camera`, `lens_options` (with `quantities`, `chief_rays`), which do not import
NumPy.

`thin_lens` turns radiance into irradiance, `diffraction` blurs by a circular pupil, `veil` has what
strays. `exchange` reads the light of other programs as irradiance on the sensor. `pupil` has the
directions of the light at a point of the sensor, `stack` the photodiodes that it reaches through
microlenses or openings. A real lens is read by `prescription`, with the media of `glass`; `lens`
traces it with the rays of `ray_trace`, and `lens_waves` hands its wavefronts to `field_blur`, which
makes PSFs of them. May import: base, light.
"""

TYPE_CHECKING = False
if TYPE_CHECKING:
    from pixsim.optics.diffraction import (
        cutoff_cy_per_mm as cutoff_cy_per_mm,
        diffract as diffract,
        diffract_sum as diffract_sum,
        diffraction_otf as diffraction_otf,
        square_aperture_mtf as square_aperture_mtf,
        white_otf as white_otf,
    )
    from pixsim.optics.stack import stack_collection as stack_collection
    from pixsim.optics.thin_lens import (
        field_factor as field_factor,
        irradiance_factor as irradiance_factor,
    )

_HOME = {
    "stack_collection": "stack",
    "field_factor": "thin_lens",
    "irradiance_factor": "thin_lens",
}  # others: diffraction

__all__ = [
    "cutoff_cy_per_mm",
    "diffract",
    "diffract_sum",
    "diffraction_otf",
    "field_factor",
    "irradiance_factor",
    "square_aperture_mtf",
    "stack_collection",
    "white_otf",
]


def __getattr__(name: str) -> object:
    """Import what needs NumPy on first use: settings, and with them `--help`, do not."""
    if name not in __all__:
        raise AttributeError(f"module '{__name__}' has no attribute '{name}'")
    from importlib import import_module

    from pixsim.base.door import public

    return public(
        getattr(import_module(f"pixsim.optics.{_HOME.get(name, 'diffraction')}"), name),
        f"pixsim.optics.{name}",
    )


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
