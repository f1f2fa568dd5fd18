"""Access to Mitsuba: import, errors as PixsimError, the parsed tree, and spectra of plugins. No
other module imports it.
"""

from __future__ import annotations

import importlib.util
import math
import os
import re
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext
from functools import lru_cache
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from pixsim.base import cache
from pixsim.base.arrays import Array
from pixsim.base.errors import PixsimError, invalid
from pixsim.base.hashes import content_hash
from pixsim.light.spectral import VISIBLE, Span, grid_nm
from pixsim.scene.variants import graphics
from pixsim.scene.variants.variant import UNUSABLE_HINT

if TYPE_CHECKING:
    from mitsuba import Spectrum, SurfaceInteraction3f
    from mitsuba.parser import ParserState

_process: int | None = None  # in which Mitsuba works


@lru_cache
def mitsuba_folder() -> Path:
    """Return the folder of Mitsuba's package, which holds its plugins and tables, without importing
    it.
    """
    spec = importlib.util.find_spec("mitsuba")
    assert spec is not None
    assert spec.origin is not None
    return Path(spec.origin).parent


def import_mitsuba(variant: str) -> ModuleType:
    """Import Mitsuba and set its variant; call `pixsim.scene.variants.variant.choose` first.

    A process whose first variant is not for graphics cards cannot take one later.

    Raises PixsimError in a process that was forked from one in which Mitsuba works: its threads are
    not there, and it would hang.
    """
    global _process
    if _process not in (None, os.getpid()):
        hint = "Start it with multiprocessing.get_context('spawn')."
        raise invalid(
            "process",
            "a process that was forked after a render",
            "a separate process for Mitsuba",
            hint,
        )
    _process = os.getpid()
    with nullcontext() if variant == graphics.CUDA else graphics.without_driver():
        import drjit as dr

        dr.has_backend(dr.JitBackend.CUDA)  # it is imported as soon as it can answer
    import mitsuba as mi

    if mi.variant() != variant:
        try:
            mi.set_variant(variant)
        except ImportError as error:
            reason = " ".join(str(error).split())
            raise invalid(
                "variant", f"'{variant}' ({reason})", "a variant that runs here", UNUSABLE_HINT
            ) from None
    # It writes warnings to stdout, which is reserved for results.
    mi.set_log_level(mi.LogLevel.Error)
    if dr.thread_count() < 2:
        dr.set_thread_count(2)  # Mitsuba 3.9 blocks for ever on an EXR texture with one thread
    return mi


def drjit() -> ModuleType:
    """Return Dr.Jit, whose types vary with Mitsuba's variant; call `import_mitsuba` first."""
    import drjit as dr

    return dr


def read_bitmap(path: Path, variant: str) -> NDArray[Any]:
    """Read a picture as stored, (H, W, channels). Raises PixsimError if Mitsuba cannot."""
    with mitsuba_session(variant) as mi:
        return np.array(mi.Bitmap(os.path.abspath(path)), copy=True)


@contextmanager
def mitsuba_session(variant: str) -> Iterator[ModuleType]:
    """Give Mitsuba with only its own folder on its search path, and turn its errors into
    PixsimError.

    Mitsuba looks for its plugins on that path too, and runs what it finds there.
    """
    mi = import_mitsuba(variant)
    before = mi.file_resolver()
    resolver = mi.FileResolver()
    resolver.clear()
    resolver.append(str(mitsuba_folder()))
    mi.set_file_resolver(resolver)
    try:
        yield mi
    except UnicodeDecodeError:  # Mitsuba quotes a file that is no text
        raise PixsimError(
            "Mitsuba cannot load or render the scene: a file in it is damaged"
        ) from None
    except RuntimeError as error:
        chain = list(_causes(error))
        # Ctrl-C while a kernel of Dr.Jit runs
        if any(isinstance(cause, KeyboardInterrupt) for cause in chain):
            raise KeyboardInterrupt from None
        # Dr.Jit says "(see above)" of an error in a kernel, whose cause has the words.
        cause = next((cause for cause in chain if "(see above)" not in str(cause)), error)
        text = re.sub(r'\[\w+\.(cpp|h):\d+\] |At dictionary node "root": ', "", str(cause).strip())
        raise PixsimError(
            "Mitsuba cannot load or render the scene: " + " ".join(text.split())
        ) from None
    finally:
        mi.set_file_resolver(before)


def _causes(error: BaseException | None) -> Iterator[BaseException]:
    """Iterate over an error and those that it wraps."""
    while error is not None:
        yield error
        error = error.__cause__ or error.__context__


def parse(text: str, variant: str) -> ParserState:
    """Return Mitsuba's parser state, the tree of nodes before objects are built, of an inspected
    text.
    """
    with mitsuba_session(variant) as mi:
        return mi.parser.parse_string(mi.parser.ParserConfig(variant), text)


def evaluate_spectrum(description: dict[str, Any], variant: str) -> Array:
    """Evaluate a spectrum plugin or an emitter in Mitsuba at 360 … 830 nm in steps of 1 nm; from
    the cache where it is known.
    """

    def compute() -> Array:
        with mitsuba_session(variant) as mi:
            return _at_each_wavelength(mi, variant, mi.load_dict(description).eval)

    def read(content: dict[str, Any]) -> Array:
        return np.array(content["values"], float)

    key = content_hash([cache.version_fingerprint("mitsuba", "drjit"), variant, description])
    return cache.load_or_compute(
        "spectra", key, read, compute, lambda values: {"values": values.tolist()}
    )


def plugin_warnings(description: dict[str, Any], variant: str) -> list[str]:
    """Return what Mitsuba warns of while it builds a plugin; from the cache where it is known.

    description : values as JSON has them; `to_world` as the rows of a matrix
    """

    def compute() -> list[str]:
        with mitsuba_session(variant) as mi:
            values = description.copy()
            if "to_world" in values:
                values["to_world"] = mi.ScalarTransform4f(np.array(values["to_world"]))
            listener = _listener(mi)
            logger = mi.logger()
            others = [logger.appender(index) for index in range(logger.appender_count())]
            logger.clear_appenders()
            logger.add_appender(listener)
            mi.set_log_level(mi.LogLevel.Warn)
            try:
                mi.load_dict(values)
            finally:
                mi.set_log_level(mi.LogLevel.Error)
                logger.clear_appenders()
                for other in others:
                    logger.add_appender(other)
            return listener.texts

    key = content_hash([cache.version_fingerprint("mitsuba", "drjit"), variant, description])
    return cache.load_or_compute(
        "warnings",
        key,
        lambda content: list(map(str, content["texts"])),
        compute,
        lambda texts: {"texts": texts},
    )


def _listener(mi: ModuleType) -> Any:
    """Return an appender of Mitsuba's log that keeps the texts of warnings, without time and
    class.
    """

    class Listener(mi.Appender):  # type: ignore[misc,name-defined]
        def __init__(self) -> None:
            super().__init__()
            self.texts: list[str] = []

        def append(self, level: Any, text: str) -> None:
            if level == mi.LogLevel.Warn:
                self.texts.append(re.sub(r"^.*?\bWARN\s+(\[\w+\] )?", "", " ".join(text.split())))

        def log_progress(self, *_: object) -> None:
            """Mitsuba asks for it."""

    return Listener()


def evaluate_reflection(
    description: dict[str, Any], cosine: float, variant: str, span: Span = VISIBLE
) -> Array:
    """Return the reflectance of a smooth conductor at an angle to its normal, over a range in steps
    of 1 nm.
    """
    with mitsuba_session(variant) as mi:
        bsdf = mi.load_dict(description)
        context = mi.BSDFContext()
        towards = [math.sqrt(1 - cosine**2), 0.0, cosine]

        def reflected(interaction: SurfaceInteraction3f) -> Spectrum:
            interaction.wi = mi.Vector3f(*towards)
            return bsdf.sample(context, interaction, 0.5, mi.Point2f(0.5, 0.5))[1]

        return _at_each_wavelength(mi, variant, reflected, span)


def _at_each_wavelength(
    mi: ModuleType,
    variant: str,
    value: Callable[[SurfaceInteraction3f], Spectrum],
    span: Span = VISIBLE,
) -> Array:
    """Evaluate `value` for surface interactions that differ in wavelength only, (G,) over a range
    in steps of 1 nm.
    """
    import drjit as dr

    wavelengths = grid_nm(span=span)
    # A ray of Mitsuba has four wavelengths.
    rows = np.resize(wavelengths, (-(-wavelengths.size // 4), 4))
    if variant.startswith("scalar"):
        values = []
        for row in rows:
            interaction = dr.zeros(mi.SurfaceInteraction3f)
            interaction.wavelengths = row.tolist()
            values.append(np.asarray(value(interaction), float).ravel())
    else:
        interactions = dr.zeros(mi.SurfaceInteraction3f, len(rows))
        interactions.wavelengths = mi.Spectrum(np.ascontiguousarray(rows.T, np.float32))
        values = [np.asarray(value(interactions), float).T.ravel()]
    return np.concatenate(values)[: wavelengths.size]
