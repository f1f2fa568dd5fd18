"""The report of a study: self-contained, consistent with summary.json, and readable on a phone."""

import html
import json
import re
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from helpers.browser import assert_fits, assert_prints, assert_sliders_move, needs_browser
from helpers.looks import Elements, assert_short_headlines, text_of
from helpers.tiny import FINE, tiny

import pixsim
from pixsim.report.study import plates_of_curves, report_files
from pixsim.report.wording import blur_words
from pixsim.sensor.labels import label_of
from pixsim.show.sentences import capital
from pixsim.studies.light_level import LightLevel
from pixsim.studies.pixels import physics_of
from pixsim.studies.result import StudyResult

TITLE = "<script>alert(1)</script> \"quoted\" & 'Ångström' µm"
OTHER = "<b>&process.toml"


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[StudyResult, Path]]:
    folder = tmp_path_factory.mktemp("report")
    process = Path(pixsim.__file__).parent / "data/technologies/0.35um.toml"
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        other = process.read_text(encoding="utf-8").replace('name = "0.35um"', 'name = "other"')
        Path(OTHER).write_text(other, encoding="utf-8")
        result = pixsim.study(tiny(title=TITLE, technologies=["0.35um", OTHER], resolution=FINE), folder / "out", jobs=1)
        pixsim.write_report(result, folder / "out", {"render": 1.25})
        yield result, folder / "out"


def words_of(folder: Path) -> str:
    return " ".join("".join(Elements(text_of(folder)).words).split())


def test_write_report_is_self_contained(made: tuple[StudyResult, Path]) -> None:
    page = text_of(made[1])
    elements = Elements(page)
    assert elements.links
    assert all(link.startswith(("data:", "#")) for link in elements.links)
    assert {link[1:] for link in elements.links if link.startswith("#")} <= set(re.findall(r' id="([^"]+)"', page))
    assert not {"script", "link", "iframe", "object", "embed", "base"} & set(elements.tags)
    assert not re.search(r"url\(|@import", re.sub(r'"data:[^"]*"', "", page))
    assert str(made[1].parent) not in page, "a path of the machine it was made on"


def test_write_report_escapes_markup(made: tuple[StudyResult, Path]) -> None:
    """The title and a technology's name hold markup; a reader sees them letter by letter."""
    assert words_of(made[1]).count(TITLE) == 2  # <title> and <h1>
    assert "<b>&process" in words_of(made[1])


def test_write_report_matches_summary(made: tuple[StudyResult, Path]) -> None:
    result = made[0]
    words = words_of(made[1])
    for curve in json.loads((made[1] / "summary.json").read_text(encoding="utf-8"))["curves"]:
        best = curve["optimum"]
        assert best["inside"]
        physics = physics_of(result.study, curve["technology"], best["pitch_um"])
        blur = blur_words(result.irradiance, result.camera, physics, result.study.display)
        assert f"Blur of {best['pitch_um']:.2f} µm pixels, {label_of(curve['technology'])}. {blur}" in words
        (low, high), (from_um, to_um) = best["interval_um"], best["within_1_percent_um"]
        head = f"{label_of(curve['technology'])}: optimal pixel size {best['pitch_um']:.2f} µm (95 %: {low:.2f} to {high:.2f} µm)"
        assert f"{head}, mean ΔE {best['mean_delta_e']:.3f}; within 1 % of it: {from_um:.2f} to {to_um:.2f} µm" in words
        for pitch_um, delta_e in zip(curve["pitch_um"], curve["mean_delta_e"], strict=True):
            assert f"{pitch_um:.3f}" in words
            assert f"{delta_e:.4f}" in words


def test_write_report_minimum_at_end_is_not_best(made: tuple[StudyResult, Path], tmp_path: Path) -> None:
    result = made[0]
    curve = result.curves[0]
    at_the_end = replace(curve, fit=replace(curve.fit, optimum=replace(curve.optimum, inside=False, pitch_um=15.0)))
    pixsim.write_report(replace(result, curves=(at_the_end,)), tmp_path, {})
    words = words_of(tmp_path)
    assert "0.35um: no optimum between 5.30 and 15.00 µm; the error is smallest at 15.00 µm, the end of the range" in words
    assert "optimal pixel size" not in words


def figures(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in (folder / "figures").glob("*.svg")}


def test_write_report_figures_are_reproducible_and_notes_are_shown(made: tuple[StudyResult, Path], tmp_path: Path) -> None:
    """A warning of the render, such as of its noise, is a note of the result."""
    result, folder = made
    warned = "render noise is 0.31 of the sensor noise, target 0.2"
    pixsim.write_report(replace(result, warned=(warned,)), tmp_path, {"render": 99.0})
    assert warned in words_of(tmp_path)
    assert warned in json.loads((tmp_path / "summary.json").read_text(encoding="utf-8"))["notes"]
    assert figures(folder) == figures(tmp_path)
    for svg in figures(folder).values():
        assert b"dc:date" not in svg
        assert not re.search(rb"\d{4}-\d\d-\d\dT\d\d", svg)


def test_write_report_has_pictures_per_technology(made: tuple[StudyResult, Path]) -> None:
    assert {"delta_e_against_pitch.svg", "pictures_0.35um.svg", "pictures_<b>&process.svg"} <= figures(made[1]).keys()
    assert len(set(figures(made[1]).values())) == len(figures(made[1]))
    assert text_of(made[1]).count('src="data:image/svg+xml;') == len(figures(made[1]))


@pytest.mark.slow
def test_write_report_equal_file_names_are_numbered(made: tuple[StudyResult, Path], tmp_path: Path) -> None:
    process = Path(pixsim.__file__).parent / "data/technologies/0.35um.toml"
    paths = [tmp_path / folder / "mine.toml" for folder in ("first", "second")]
    for path in paths:
        path.parent.mkdir()
        text = process.read_text(encoding="utf-8")
        path.write_text(text.replace('name = "0.35um"', f'name = "{path.parent.name}"'), encoding="utf-8")
    study = tiny(title=TITLE, technologies=[str(path) for path in paths], resolution=FINE)
    result = pixsim.study(study, tmp_path / "out", jobs=1)
    assert [curve.technology for curve in result.curves] == [str(path) for path in paths]
    assert repr(result).count(str(tmp_path)) == 0
    page = pixsim.write_report(result, tmp_path / "out").read_text(encoding="utf-8")
    names = {path.name for path in (tmp_path / "out/figures").iterdir()}
    for label in ("mine", "mine-2"):
        assert {f"contact_sheet_{label}.png", f"pictures_{label}.svg"} <= names
        assert f"{capital(label)}: optimal pixel size" in " ".join(page.split())
    assert str(tmp_path) not in page
    assert {f"figures/{name}" for name in names} <= report_files(study)


def test_study_result_repr_without_optimum(made: tuple[StudyResult, Path]) -> None:
    curve = made[0].curves[0]
    best = curve.optimum
    low, high = best.interval_um
    assert f"0.35um: optimal pixel size {best.pitch_um:.2f} µm (95 %: {low:.2f} to {high:.2f} µm)" in repr(made[0])
    sheet = replace(
        curve, technology="none", data_sheet=True, fit=replace(curve.fit, optimum=replace(best, inside=False, pitch_um=15.0))
    )
    result = replace(made[0], curves=(sheet,))
    assert "data sheet: no optimum between 5.30 and 15.00 µm; the error is smallest at 15.00 µm, the end" in repr(result)
    assert sheet.as_dict()["optimum_features"] is None
    assert made[0].as_dict()["curves"][0]["optimum_features"] == pytest.approx(best.pitch_um / 0.35)
    names = [plate.name for plate in plates_of_curves(replace(made[0], curves=(curve, sheet)), curve)]
    assert names == ["delta_e_against_pitch", "delta_e_against_pitch_all"]


def test_figures_of_the_paper_have_its_numbers(made: tuple[StudyResult, Path]) -> None:
    """In their names and captions, and among the files that a report may replace."""
    study = made[0].study.model_copy(update={"paper": True})
    first = made[0].curves[0]
    plates = plates_of_curves(replace(made[0], study=study, curves=(first, replace(first, feature_size_um=0.25))), first)
    of_paper = {"7": "delta_e_against_pitch", "8": "delta_e_against_pitch_all", "9": "optimum_against_technology"}
    assert [plate.name for plate in plates] == [f"figure_{number}_{name}" for number, name in of_paper.items()]
    assert [plate.caption.split(":")[0] for plate in plates] == ["Figure 7", "Figure 8", "Figure 9"]
    assert {f"figures/{plate.name}.{suffix}" for plate in plates for suffix in ("svg", "csv", "pdf")} <= report_files(study)


@pytest.mark.slow
def test_write_report_states_light_level(made: tuple[StudyResult, Path], tmp_path: Path) -> None:
    result = made[0]
    times_s = np.concatenate([curve.statistics["integration_s"].ravel() for curve in result.curves])
    assert (times_s == 0.1).all(), "so dim that all frames take the longest that is allowed"
    assert "display white is 100 cd/m² in the scene; exposed for 100 ms." in words_of(made[1])
    table = text_of(made[1]).partition("<caption>scene</caption>")[2].partition("</table>")[0]
    cells = [re.findall(r"<t[hd][^>]*>(.*?)</t[hd]>", row) for row in re.findall(r"<tr>.*?</tr>", table)]
    message = {cell[0]: cell[1:] for cell in cells}
    assert message["white_cd_per_m2"] == ["100", "scene luminance shown as display white", "the scene"]
    assert [message[name][0] for name in ("file", "film", "integration_s")] == ["csf.xml", "384\u00a0×\u00a0384", "100 ms"]
    brighter = result.study.display.model_copy(update={"white_cd_per_m2": 250.0})
    pixsim.write_report(replace(result, study=result.study.model_copy(update={"display": brighter})), tmp_path)
    assert "display white is 250 cd/m² in the scene" in words_of(tmp_path)
    assert "display.white_cd_per_m2</td>" in text_of(tmp_path)


def test_light_level_exposure_range(made: tuple[StudyResult, Path]) -> None:
    irradiance, display = made[0].irradiance, made[0].study.display
    assert str(LightLevel.of(irradiance, display, [0.02, 0.005, 0.0123])).endswith("exposed for 5 to 20 ms")
    assert str(LightLevel.of(irradiance, display, [0.02, 0.0200001])).endswith("exposed for 20 ms")


def test_write_report_descriptions_are_formatted(made: tuple[StudyResult, Path]) -> None:
    page = re.sub(r'"data:[^"]*"', "", text_of(made[1]))
    assert "`" not in page
    assert "<code>dots</code>" in page
    assert "None" not in page


SHEET = {"data_sheet_pitch_um": 2.0, "full_well_e": 8000.0, "read_noise_e": 5.0, "dark_current_e_per_s": 10.0}
SHEET |= {"quantum_efficiency": [[400.0, 0.3], [550.0, 0.6], [700.0, 0.4]]}


@pytest.mark.slow
def test_write_report_data_sheet_omits_process(made: tuple[StudyResult, Path], tmp_path: Path) -> None:
    more = {"name": "sheet", "technologies": ["none"], "pixel": SHEET, "pitch": {"values_um": [5, 6, 7, 8.5, 11]}}
    result = pixsim.study(tiny(**more), tmp_path, jobs=1)
    pixsim.write_report(result, tmp_path)
    page, words = text_of(tmp_path), words_of(tmp_path)
    rows = re.findall(r'<tr><th scope="row">(\w+)</th>', page)
    assert {"full_well_e", "bits", "white_cd_per_m2"} <= set(rows)
    assert not {"capacitance", "well_limit", "conversion", "response", "fill_factor_law"} & set(rows)
    assert "curve of 3 points, 400 to 700 nm" in words
    assert "Noise and non-uniformities that the data sheet does not state are zero." in words
    assert not [absent for absent in ("come from the technology", "ill factor") if absent in words]
    assert "fill_factor_law" in text_of(made[1]), "a process uses those settings"


@pytest.mark.slow  # test_paper has the statements, test_plates their figures
def test_write_report_paper_comparison(made: tuple[StudyResult, Path], tmp_path: Path) -> None:
    """0.0415 is the largest number of the response file, 0.37 that of the process's."""
    own = {"name": "paper", "paper": True, "pixel": {"response": "literal"}}
    result = pixsim.study(tiny(**own), tmp_path, jobs=1)
    pixsim.write_report(result, tmp_path)
    words = words_of(tmp_path)
    assert "read literally, as a quantum efficiency: it peaks at 0.0415. The process 0.35um states 0.37 (A: measured" in words
    assert "add --pixel.response scaled --out FOLDER to the command" in words
    table = text_of(tmp_path).partition('<h2 id="paper">')[2].partition("</table>")[0]
    actual = json.loads((tmp_path / "summary.json").read_text(encoding="utf-8"))["paper"]
    assert table.count('data-name="agrees"') == len(actual)
    assert "<code>pixsim study chen2000-sensitivity</code> lists the settings that change each verdict." in text_of(tmp_path)
    assert "peaks at" not in text_of(made[1])


def test_study_page_has_a_short_headline(made: tuple[StudyResult, Path]) -> None:
    assert_short_headlines(made[1])


@needs_browser
def test_study_page_fits_screens(made: tuple[StudyResult, Path], tmp_path: Path) -> None:
    actual = assert_fits(made[1] / "report.html", tmp_path)
    assert_sliders_move(actual, pictures=3)
    for seen in actual:
        assert len(seen.tiles) == sum(1 + curve.pitch_um.size + 9 for curve in made[0].curves)
        assert {tuple(tile) for tile in seen.tiles} == {(46, 46, 46, 46)}
        assert seen.headings[0][1] == TITLE


@pytest.mark.slow
@needs_browser
def test_study_page_prints(made: tuple[StudyResult, Path], tmp_path: Path) -> None:
    best = made[0].curves[0].optimum
    page = text_of(made[1])
    headings = [html.unescape(item) for item in re.findall(r"<h[23][^>]*>(.*?)</h[23]>", page)]
    assert len(headings) > 8
    message = [TITLE, f"optimal pixel size {best.pitch_um:.2f} µm (95 %", "smallest, 5.30 µm", "largest, 15.00 µm", "Assumptions"]
    assert_prints(made[1] / "report.html", tmp_path, range(8, 16), message, headings, [item for item in headings if ": " in item])
