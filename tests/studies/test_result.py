"""Results in a notebook: cells, figures, and tables that round-trip."""

from __future__ import annotations

import base64
import csv
import io
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from helpers.looks import Elements

import pixsim
from pixsim.base.digits import number
from pixsim.light.spectral import d65
from pixsim.scene.charts import csf_value
from pixsim.show.pictures import scale_end
from pixsim.studies.result import StudyResult
from pixsim.viewer.score import Score

MARKUP = '<b>&"title"</b> $x$ µm'


@pytest.fixture(scope="module")
def score() -> Score:
    nm = np.arange(400.0, 701.0, 10.0)
    at = (np.arange(128) + 0.5) / 128
    factors = d65(nm)[None] * 2e-6, np.asarray(csf_value(at, at[:, None]), np.float32)[None]
    image = pixsim.SpectralImage(
        nm, 10.0, 2713.6 / 128, factors=factors, header={"luminance_cd_per_m2": 1000.0}
    )
    return pixsim.evaluate(
        image, pixsim.Camera(), pixsim.Pixel(pitch_um=21.2), display=pixsim.Display(dots=128)
    )


@pytest.fixture(scope="module")
def result(tiny_result: StudyResult) -> StudyResult:
    """With words that look like markup, and a second technology that has no optimum."""
    (curve,) = tiny_result.curves
    other = replace(
        curve,
        technology="0.25um",
        fit=replace(curve.fit, optimum=replace(curve.optimum, inside=False)),
    )
    return replace(
        tiny_result,
        study=tiny_result.study.model_copy(update={"title": MARKUP}),
        curves=(curve, other),
    )


def image_of(cell: str) -> str:
    (actual,) = re.findall(r'src="data:image/svg\+xml;base64,([^"]+)"', cell)
    return base64.b64decode(actual).decode()


def test_score_repr_html_shows_statistics(score: Score) -> None:
    cell = score._repr_html_()
    words = Elements(cell)
    message = " ".join(words.words)
    assert f"mean ΔE {score.mean_delta_e:.3f}" in message
    for name, value in score.statistics().items():
        assert f"{name} {number(value, 4)}" in message
    assert words.tags.count("tr") == len(score.statistics())
    assert "pitch_um = " in message
    assert len(cell) < 400_000, "a notebook keeps it"
    assert image_of(cell).count("<image") == 4, "ideal, sensor, map, scale"
    assert repr(score).startswith("<Score mean ΔE")


def test_score_plot_scale_ends_at_99th_percentile(score: Score) -> None:
    (shown,) = [
        image
        for axes in score.plot().axes
        for image in axes.images
        if axes.get_title().startswith("S-CIELAB")
    ]
    assert shown.get_clim() == (0.0, scale_end(score.statistics()["p99_delta_e"]))
    np.testing.assert_array_equal(shown.get_array(), score.delta_e)


def test_study_result_repr_html_escapes_markup(result: StudyResult) -> None:
    cell = result._repr_html_()
    words = Elements(cell)
    message = " ".join(words.words)
    labelled = Elements(replace(result.curves[0], label=MARKUP)._repr_html_())
    assert MARKUP in " ".join(labelled.words)
    assert set(words.tags) == {"div", "strong", "b", "img", "br", "p"}
    for curve in result.curves:
        best = curve.optimum
        assert curve.technology in message
        assert f"{best.pitch_um:.2f} µm" in message
    assert image_of(cell).startswith("<?xml")
    axes = result.plot().axes[0]
    assert axes.get_xlabel() == "pixel size (µm)"
    assert tuple(result.curves[0].pitch_um) in {
        tuple(np.round(line.get_xdata(), 6)) for line in axes.lines
    }


def test_to_csv_round_trips(score: Score, result: StudyResult, tmp_path: Path) -> None:
    (row,) = csv.DictReader(io.StringIO(score.to_csv()))
    assert {name: float(value) for name, value in row.items()} == score.statistics()
    text = result.to_csv(tmp_path / "rows.csv")
    assert (tmp_path / "rows.csv").read_bytes().decode() == text
    rows = list(csv.DictReader(io.StringIO(text)))
    assert len(rows) == 6 * 2
    for curve in result.curves[:1]:
        own = [row for row in rows if row["technology"] == curve.technology]
        np.testing.assert_array_equal(
            [float(row["mean_delta_e"]) for row in own], curve.delta_e.ravel()
        )
        assert [float(row["pitch_um"]) for row in own] == np.repeat(curve.pitch_um, 2).tolist()
