"""What any result in Python answers: words in one line, a figure, a table and a notebook's cell."""

import csv
import io
import re
from collections.abc import Callable
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from helpers.edges import gaussian_edge
from helpers.lights import camera, chart
from helpers.sheets import two_sheets

import pixsim
from pixsim.base.result import Result
from pixsim.measure.datasheet import make_datasheet

SMALL: dict = {"resolution": 48, "camera": {"die_mm": 1.3568}, "display": {"dots": 48}}
COLOUR = {"sensitivities": "Sony_ILCE-7M4", "peak_quantum_efficiency": 0.65}
BINNED = pixsim.Pixel(
    technology="4t-bsi",
    pitch_um=3.0,
    black_level_dn=1.0,
    colour=COLOUR | {"pattern": "quad_rggb", "binning": True},
)
GREY = np.full((24, 24), 0.5)


@cache
def run(pitch_um: float = 16.0) -> Result:
    """A frame of a colour sensor, sharpened, at a metered gain."""
    return pixsim.run(
        "csf",
        repeats=1,
        pixel={"technology": "4t-bsi", "pitch_um": pitch_um, "colour": COLOUR},
        develop={"sharpen_amount": 1.0},
        exposure={"gain_db": "auto"},
        **SMALL,
    )


def comparison(folder: Path) -> Result:
    options: dict = {"develop": {"sharpen_amount": 1.0}, "display": {"dots": 48}, "resolution": 48}
    return pixsim.compare(two_sheets(folder), "flat", repeats=2, jobs=1, **options)


RESULTS: dict[str, Callable[[Path], Result]] = {
    "run": lambda _: run(),
    "comparison": comparison,
    "two runs": lambda _: pixsim.compare_results(run(), run(21.2)),
    "a run twice": lambda _: pixsim.compare_results(run(), run()),
    "data sheet": lambda _: make_datasheet(BINNED, shape=(16, 16), stack_frames=4),
    "edge": lambda _: pixsim.edge_response(gaussian_edge(height=100, width=60)),
    "lens": lambda _: pixsim.lens("singlet", reflectance=0.01),
    "score": lambda _: pixsim.evaluate(chart(), camera(chart()), pixsim.Pixel(pitch_um=42.4)),
    "score of pictures": lambda _: pixsim.score_pictures(GREY, GREY / 2, pixsim.Display(dots=24)),
    "sweep": lambda _: pixsim.sweep(
        chart(), [pixsim.Pixel(pitch_um=84.8)], display=pixsim.Display(dots=32)
    ),
}


@pytest.mark.parametrize("name", RESULTS)
def test_result_has_words_a_figure_a_table_and_a_cell(name: str, tmp_path: Path) -> None:
    result = RESULTS[name](tmp_path)
    assert re.fullmatch(r"<\w+ .+>", repr(result))
    assert result.plot().axes
    assert list(csv.DictReader(io.StringIO(result.to_csv())))
    assert "<strong>" in result._repr_html_()


def test_what_a_result_is_made_of_has_words_too() -> None:
    scene = pixsim.load_scene("csf", resolution=32)
    for thing in (scene, pixsim.make_plan(scene), chart()):
        assert re.fullmatch(rf"<{type(thing).__name__} .+>", repr(thing))


def test_run_has_its_channels_and_notes() -> None:
    entries = run().as_dict()
    notes = [{"id": note.id, "text": str(note)} for note in run().notes]
    assert (run().colour, notes) == (entries["colour"], entries["notes"])
    assert entries["sharpening_noise_gain"] > 1


def test_comparison_answers_for_each_pair(tmp_path: Path) -> None:
    result = comparison(tmp_path)
    verdicts = {other: result.verdict(other) for other in result.names[1:]}
    entries = result.as_dict()
    assert (verdicts, result.film_delta_e) == (entries["verdicts"], entries["film_delta_e"])


def test_figures_are_written_as_pdf_too(tmp_path: Path) -> None:
    pixsim.edge_response(gaussian_edge(height=100, width=60)).write(tmp_path, "pdf")
    assert len(list(tmp_path.rglob("*.pdf"))) == len(list(tmp_path.rglob("*.svg"))) > 0
