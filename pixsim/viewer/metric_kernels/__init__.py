"""Kernels of the metrics beside ΔE, `pixsim.metrics`: pure functions of arrays and numbers.

`linear_observer` (a target in a raw frame) and `non_prewhitening` (one in a shown picture),
`information_density` (bits per area of the sensor), `sharpness` (MTF of an edge, MTF50, acutance),
`visible_noise` (of the shown picture), `snr_illuminance` (the light for an SNR of 10),
`interpretability` (NIIRS), `contrast_detection` (CDP of two patches). Names are imported on first
use.
"""

TYPE_CHECKING = False
if TYPE_CHECKING:
    from pixsim.viewer.metric_kernels.contrast_detection import (
        contrast_detection_probability as contrast_detection_probability,
        contrast_detection_share as contrast_detection_share,
    )
    from pixsim.viewer.metric_kernels.information_density import (
        folded_spectrum as folded_spectrum,
        information_bits_per_mm2 as information_bits_per_mm2,
        natural_spectrum as natural_spectrum,
        neq as neq,
        radial_spectrum as radial_spectrum,
    )
    from pixsim.viewer.metric_kernels.interpretability import (
        niirs as niirs,
        relative_edge_response as relative_edge_response,
    )
    from pixsim.viewer.metric_kernels.linear_observer import detectability as detectability
    from pixsim.viewer.metric_kernels.non_prewhitening import (
        npwe as npwe,
        npwe_template as npwe_template,
    )
    from pixsim.viewer.metric_kernels.sharpness import (
        acutance as acutance,
        edge_mtf as edge_mtf,
        mtf50 as mtf50,
    )
    from pixsim.viewer.metric_kernels.snr_illuminance import snr10_lx as snr10_lx
    from pixsim.viewer.metric_kernels.visible_noise import visual_noise as visual_noise

_NAMES_OF = {
    "contrast_detection": "contrast_detection_probability contrast_detection_share",
    "information_density": (
        "folded_spectrum information_bits_per_mm2 natural_spectrum neq radial_spectrum"
    ),
    "interpretability": "niirs relative_edge_response",
    "linear_observer": "detectability",
    "non_prewhitening": "npwe npwe_template",
    "sharpness": "acutance edge_mtf mtf50",
    "snr_illuminance": "snr10_lx",
    "visible_noise": "visual_noise",
}
_HOME = {name: module for module, names in _NAMES_OF.items() for name in names.split()}

__all__ = sorted(_HOME)


def __getattr__(name: str) -> object:
    if name not in _HOME:
        raise AttributeError(f"module '{__name__}' has no attribute '{name}'")
    from importlib import import_module

    return getattr(import_module(f"pixsim.viewer.metric_kernels.{_HOME[name]}"), name)


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
