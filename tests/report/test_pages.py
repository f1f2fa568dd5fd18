"""Pages of `run`, `study`, `compare` and `lens`: self-contained, with the numbers of their JSON, on
a phone, a desk and paper.
"""

from __future__ import annotations

import base64
import html
import io
import json
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.browser import assert_fit, assert_prints, assert_sliders_move, needs_browser
from helpers.commands import command
from helpers.looks import Elements, assert_short_headlines, text_of
from helpers.sheets import two_sheets
from helpers.tiny import FINE, tiny
from PIL import Image

import pixsim
from pixsim.base.digits import difference_cells, estimate, interval, percent, within_error
from pixsim.report.curve import optimum_line
from pixsim.report.lens import FIGURES
from pixsim.report.run import FILES
from pixsim.report.study import curve_figures, report_files, study_document
from pixsim.sensor.labels import label_of
from pixsim.show import render
from pixsim.show.figures import svg_text
from pixsim.show.sentences import capital
from pixsim.studies.result import StudyResult
from pixsim.viewer.screen import LightLevel

RUN = (
    "run csf --variant scalar_spectral --resolution 128 --display.dots 200 --pixel.pitch-um 10.6"
    " --raw png --out"
)
TITLE = "<script>alert(1)</script> \"quoted\" & 'Ångström' µm"
OTHER = "<b>&process.toml"
PROCESS = Path(pixsim.__file__).parent / "data/technologies/0.35um.toml"
SMALL = (
    "--display.dots 120 --resolution 256 -D luminance_cd_per_m2=1 --repeats 3 --jobs 1 --variant"
    " scalar_spectral"
)
STUDY = """\
name = "both"
technologies = ["4t-bsi"]
resolution = 128
[display]
dots = 64
[[condition]]
name = "never"
weight = 0
set.exposure.max_integration_s = 0.01
[[condition]]
name = "day"
weight = 3
set.exposure.max_integration_s = 0.02
[[condition]]
name = "night"
set.scene.parameters.luminance_cd_per_m2 = 1.0
set.display.white_cd_per_m2 = 1.0
set.pixel.temperature_k = 310.0
"""


def done(line: str, *words: object) -> str:
    code, out, err = command(line, *words)
    assert (code, err) == (0, "")
    return out


@pytest.fixture(scope="module")
def ran(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("ran") / "out"
    assert done(f"{RUN} {out}").splitlines()[-1] == f"report: {out / 'report.html'}"
    return out


@pytest.fixture(scope="module")
def studied(tmp_path_factory: pytest.TempPathFactory) -> tuple[StudyResult, Path]:
    folder = tmp_path_factory.mktemp("studied")
    other = PROCESS.read_text(encoding="utf-8").replace('name = "0.35um"', 'name = "other"')
    (folder / OTHER).write_text(other, encoding="utf-8")
    study = tiny(title=TITLE, technologies=["0.35um", str(folder / OTHER)], resolution=FINE)
    result = pixsim.study(study, folder / "out", jobs=1)
    pixsim.write_report(result, folder / "out", {"render": 1.25})
    return result, folder / "out"


@pytest.fixture(scope="module")
def compared(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, str]:
    """A comparison's folder, and what it printed."""
    folder = tmp_path_factory.mktemp("compared")
    return folder / "out", done(f"compare {SMALL}", *two_sheets(folder), "--out", folder / "out")


@pytest.fixture(scope="module")
def under_study(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, str]:
    """The folder of a comparison under three conditions, and what it printed."""
    folder = tmp_path_factory.mktemp("study")
    (folder / "both.toml").write_text(STUDY, encoding="utf-8")
    # Two registrations leave an interval with one degree of freedom, wider than the difference;
    # four are a balanced block.
    line = (
        f"compare --repeats 4 --jobs 1 --study '{folder / 'both.toml'}' --variant scalar_spectral"
    )
    return folder / "out", done(line, *two_sheets(folder), "--out", folder / "out")


@pytest.fixture(scope="module")
def measured(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, str]:
    """The folder of the data of a lens, and what was printed."""
    folder = tmp_path_factory.mktemp("lens") / "out"
    return folder, done(
        "lens double_gauss --pitch-um 5 --focal-length-mm 50 --f-number 8 --out", folder
    )


@pytest.fixture(scope="module")
def folders(
    ran: Path, studied: Any, compared: Any, under_study: Any, measured: Any
) -> dict[str, Path]:
    return {
        "run": ran,
        "study": studied[1],
        "compare": compared[0],
        "compare --study": under_study[0],
        "lens": measured[0],
    }


# --- what all pages have
# ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["run", "study", "compare", "compare --study", "lens"])
def test_page_is_self_contained(name: str, folders: dict[str, Path]) -> None:
    """Nothing comes from elsewhere."""
    page, folder = text_of(folders[name]), folders[name]
    elements = Elements(page)
    links = {link for link in elements.links if not link.startswith(("data:", "#"))}
    assert not links
    assert {link[1:] for link in elements.links if link.startswith("#")} <= set(
        re.findall(r' id="([^"]+)"', page)
    )
    assert not {"script", "link", "iframe", "object", "embed", "base"} & set(elements.tags)
    assert not re.search(r"url\(|@import", re.sub(r'"data:[^"]*"', "", page))
    assert str(folder.parent) not in page, "a path of the machine it was made on"


@pytest.mark.parametrize("name", ["run", "study", "compare", "compare --study"])
def test_page_has_short_headlines(name: str, folders: dict[str, Path]) -> None:
    assert_short_headlines(folders[name])


@needs_browser
@pytest.mark.parametrize(
    "names",
    [
        ("run", "study", "compare", "lens"),
        pytest.param(("compare --study",), marks=pytest.mark.slow),
    ],
)
def test_pages_fit_screens(
    names: tuple[str, ...],
    folders: dict[str, Path],
    studied: tuple[StudyResult, Path],
    tmp_path: Path,
) -> None:
    """The sliders' pictures lie on the sides that the pages say; details are shown dot by dot.

    Slow: a page whose parts the others have.
    """
    details = sum(1 + curve.pitch_um.size + 9 for curve in studied[0].curves)
    shown = {  # pictures of a slider, what is on its left, the number of details, and their dots
        "run": (1, "the ideal image", 3, 112),
        "study": (3, "the ideal image", details, 46),
        "compare": (2, "the picture of quiet", 6, 84),
    }
    for name, views in zip(
        names, assert_fit([folders[name] / "report.html" for name in names], tmp_path), strict=True
    ):
        if name in shown:
            pictures, left, count, dots = shown[name]
            assert_sliders_move(views, pictures, left)
            assert [view.tiles for view in views] == [[[dots] * 4] * count] * len(views), name
        assert name != "study" or {view.headings[0][1] for view in views} == {TITLE}


@needs_browser
@pytest.mark.parametrize(
    ("name", "pages", "texts"),
    [
        ("run", range(2, 5), ["not converged", "10.6 µm pixels"]),
        # The style is the same.
        pytest.param(
            "compare",
            range(3, 9),
            ["quiet is better than noisy_one", "64 × 48"],
            marks=pytest.mark.slow,
        ),
        pytest.param(
            "study",
            range(5, 12),
            [TITLE, "smallest, 5.3 µm", "largest, 15 µm"],
            marks=pytest.mark.slow,
        ),
    ],
)
def test_page_prints(
    name: str, pages: range, texts: list[str], folders: dict[str, Path], tmp_path: Path
) -> None:
    level = "[23]" if name == "study" else "2"
    headings = [
        html.unescape(each)
        for each in re.findall(rf"<h{level}[^>]*>(.*?)</h\d>", text_of(folders[name]))
    ]
    assert len(headings) >= 3
    pictured = {"run": headings[:1], "study": [each for each in headings if ": " in each]}
    shown = pictured.get(name) or headings[1:2]  # the differences before it are a vector figure
    assert_prints(folders[name] / "report.html", tmp_path, pages, texts, headings, shown)


# --- a run
# --------------------------------------------------------------------------------------------------------------


def coarse_mean(score: dict[str, Any]) -> str:
    """The mean ΔE of a film that is too coarse, of an error of 0.1 to 10."""
    mean, error = score["mean_delta_e"], score["film"]["delta_e"]
    assert 0.1 <= error < 10
    return f"{mean:.1f} ± {error:.1f} (film), not converged"


def test_run_page_matches_score_json(ran: Path) -> None:
    score = json.loads((ran / "score.json").read_text(encoding="utf-8"))
    page = " ".join(html.unescape(text_of(ran)).split())
    assert f'<b class="words">{coarse_mean(score)}</b>' in page
    for name in ("full_well_e", "integration_s", "saturated_fraction", "mean_electrons_e"):
        assert f"<td>{float(f'{score[name]:.4g}'):.15g}</td>" in page, name  # without an exponent
    for name in ("mean_delta_e", "p99_delta_e", "max_delta_e"):
        assert f"<td>{estimate(score[name])}</td>" in page, name
    distance_mm = 23 * 25.4 / 96 / np.tan(np.radians(1))  # 23 dots a degree, 96 an inch
    for words in (
        "2.714 × 2.714 mm, 0.35um",
        "3.86 mm f/4",
        f"exposed for {1e3 * score['integration_s']:.3g} ms",
        '"row">white_cd_per_m2</th><td>1000</td>',
        "film of 128 × 128 samples (set by --resolution)",
        # tests/studies/test_paper.py
        "MTF at 33.3 lp/mm, the highest frequency of the chart: lens</th><td>0.9",
        (
            f"view it at 100 % zoom, at a distance where 23 dots span a degree ({distance_mm:.0f}"
            " mm away where a screen has 96 dots"
        ),
        "The ideal image on the left, the sensor's picture on the right:",
        'alt="The sensor\'s picture (10.6 µm pixels)"',
    ):
        assert words in page


@pytest.mark.parametrize("name", ["run", "compare"])
def test_page_begins_with_its_answer_and_a_large_picture(
    name: str, folders: dict[str, Path]
) -> None:
    """At least 480 px wide, a whole number of them for each dot; notes stand below it, once, and
    settings and files are folded.
    """
    page = text_of(folders[name])
    dots, times = (
        int(re.search(pattern, page)[1])
        for pattern in (r"--dots: (\d+)px", r"each dot enlarged (\d+) ×")
    )
    width = int(re.search(r'<figure class="ideal"><img src="[^"]*" width="(\d+)"', page)[1])
    assert dots == times * width >= 480 > (times - 1) * width
    places = [
        page.index(words)
        for words in ('class="answer"', 'class="compare', "<nav", "<h2", "<details")
    ]
    assert places == sorted(places)
    assert all(places[1] < match.start() < places[2] for match in re.finditer("Note: ", page))
    notes = [
        note["text"]
        for note in json.loads(next(folders[name].glob("*e.json")).read_text(encoding="utf-8"))[
            "notes"
        ]
    ]
    words = " ".join(html.unescape(re.sub(r"<[^>]*>", "", page)).split())
    assert [words.count(note[1:]) for note in notes] == [1] * len(notes)


def test_run_page_embeds_written_pictures_and_is_reproducible(ran: Path, tmp_path: Path) -> None:
    embedded = [
        base64.b64decode(item)
        for item in re.findall(r'src="data:image/png;base64,([^"]+)"', text_of(ran))
    ]
    pictures = [Image.open(io.BytesIO(item)).convert("RGB") for item in embedded]
    for name in ("ideal.png", "image.png", "delta_e.png"):
        assert Image.open(ran / name).convert("RGB") in pictures
    done(f"{RUN} {tmp_path}")
    assert (tmp_path / "report.html").read_bytes() == (ran / "report.html").read_bytes()
    assert {path.name for path in tmp_path.iterdir()} == {*FILES, "raw.png", "report.html"}


def test_dry_run_foresees_the_least_error_of_a_coarse_film(ran: Path) -> None:
    """What the film cannot show is known before there is a picture; what its picture shows comes on
    top.
    """
    outline = json.loads(done(f"{RUN} {ran} --dry-run --json"))
    score = json.loads((ran / "score.json").read_text(encoding="utf-8"))
    share, measured = (
        outline["errors"]["film_share"],
        score["film"]["delta_e"] / score["mean_delta_e"],
    )
    assert 0.02 < share < 1.02 * measured, "2 % between the means of two sensors"
    assert f"at least {percent(share)} of mean ΔE from the film alone" in done(
        f"{RUN} {ran} --dry-run"
    )


# --- a study
# ------------------------------------------------------------------------------------------------------------


def words_of(folder: Path) -> str:
    return " ".join("".join(Elements(text_of(folder)).words).split())


def test_study_page_matches_summary(studied: tuple[StudyResult, Path]) -> None:
    """The title and a technology's name hold markup; a reader sees them letter by letter."""
    _, folder = studied
    words = words_of(folder)
    assert words.count(TITLE) == 2  # <title> and <h1>
    assert "<b>&process" in words
    for curve in json.loads((folder / "summary.json").read_text(encoding="utf-8"))["curves"]:
        best, label = curve["optimum"], label_of(curve["technology"])
        assert best["inside"]
        (low, high), (from_um, to_um) = best["interval_um"], best["within_1_percent_um"]
        head = (
            f"{label}: optimal pixel size {best['pitch_um']:.2f} µm (95 %: {interval((low, high))})"
        )
        least, most = best["mean_delta_e_interval"]
        mean = within_error(best["mean_delta_e"], (most - least) / 2)
        assert f"{head}, mean ΔE {mean} Within 1 % of it: {interval((from_um, to_um))}" in words
    page = re.sub(r'"data:[^"]*"', "", text_of(folder))
    assert "`" not in page
    assert "None" not in page


def test_study_minimum_at_end_is_not_best(studied: tuple[StudyResult, Path]) -> None:
    """On the page and in Python; and for a data sheet, which has no features to count in."""
    curve = studied[0].curves[0]
    best = curve.optimum
    low, high = best.interval_um
    assert f"0.35um: {best.pitch_um:.2f} µm (95 %: {interval((low, high))})" in repr(studied[0])
    assert studied[0].as_dict()["curves"][0]["optimum_features"] == pytest.approx(
        best.pitch_um / 0.35
    )
    at_end = replace(
        curve, fit=replace(curve.fit, optimum=replace(best, inside=False, pitch_um=15.0))
    )
    sheet = replace(at_end, technology="none", feature_size_um=None)
    assert sheet.as_dict()["optimum_features"] is None
    found = "no optimum between 5.3 µm and 15 µm; the best is 15.00 µm, the end of the range"
    page = " ".join(
        "".join(
            Elements(render.html(study_document(replace(studied[0], curves=(at_end,))))).words
        ).split()
    )
    for label, text in (
        ("0.35um", page),
        ("data sheet", optimum_line(replace(studied[0], curves=(sheet,)).curves[0])),
    ):
        assert f"{label}: {found}" in text
        assert "optimal pixel size" not in text
    names = [
        draw().name for draw in curve_figures(replace(studied[0], curves=(curve, sheet)), curve)
    ]
    assert names == ["delta_e_against_pitch_all", "delta_e_against_pitch"]


def test_study_figures_are_reproducible(studied: tuple[StudyResult, Path]) -> None:
    result, folder = studied
    figures = {
        path.stem: path.read_text(encoding="utf-8") for path in (folder / "figures").glob("*.svg")
    }
    assert {
        "delta_e_against_pitch_all",
        "delta_e_against_pitch",
        "light_against_detail",
    } <= figures.keys()
    assert len(set(figures.values())) == len(figures)
    assert text_of(folder).count('src="data:image/svg+xml;') == len(figures)
    for draw in curve_figures(result, result.curves[0]):
        plate = draw()
        assert svg_text(plate.figure) == figures[plate.name]
    assert not [
        name for name, svg in figures.items() if re.search(r"dc:date|\d{4}-\d\d-\d\dT\d\d", svg)
    ]


@pytest.mark.slow
def test_study_page_equal_file_names_are_numbered(tmp_path: Path) -> None:
    paths = [tmp_path / folder / "mine.toml" for folder in ("first", "second")]
    for path in paths:
        path.parent.mkdir()
        text = PROCESS.read_text(encoding="utf-8")
        path.write_text(
            text.replace('name = "0.35um"', f'name = "{path.parent.name}"'), encoding="utf-8"
        )
    study = tiny(title=TITLE, technologies=[str(path) for path in paths], resolution=FINE)
    result = pixsim.study(study, tmp_path / "out", jobs=1)
    assert [curve.technology for curve in result.curves] == [str(path) for path in paths]
    assert repr(result).count(str(tmp_path)) == 0
    page = pixsim.write_report(result, tmp_path / "out").read_text(encoding="utf-8")
    names = {path.name for path in (tmp_path / "out/figures").iterdir()}
    for label in ("mine", "mine-2"):
        assert f"contact_sheet_{label}.png" in names
        assert f"{capital(label)}: optimal pixel size" in " ".join(page.split())
    assert str(tmp_path) not in page
    assert {f"figures/{name}" for name in names} <= report_files(study)


def test_figures_of_curves_are_among_the_files_of_a_report(
    studied: tuple[StudyResult, Path],
) -> None:
    """Which it may replace; that of all curves comes first."""
    study, first = studied[0].study, studied[0].curves[0]
    both = replace(studied[0], curves=(first, replace(first, feature_size_um=0.25)))
    names = [draw().name for draw in curve_figures(both, first)]
    assert names == [
        "delta_e_against_pitch_all",
        "delta_e_against_pitch",
        "optimum_against_technology",
    ]
    assert {
        f"figures/{name}.{suffix}" for name in names for suffix in ("svg", "csv", "pdf")
    } <= report_files(study)


@pytest.mark.slow
def test_study_page_states_light_level(studied: tuple[StudyResult, Path], tmp_path: Path) -> None:
    result, folder = studied
    times_s = np.concatenate([curve.statistics["integration_s"].ravel() for curve in result.curves])
    assert (times_s == 0.1).all(), "so dim that all frames take the longest that is allowed"
    assert "display white is 100 cd/m² in the scene; exposed for 100 ms." in words_of(folder)
    cells = [
        re.findall(r"<t[hd][^>]*>(.*?)</t[hd]>", row)
        for row in re.findall(r"<tr>.*?</tr>", text_of(folder))
    ]
    message = {cell[0]: cell[1:] for cell in cells}
    assert "scene.white_cd_per_m2" not in message, "nobody set it"
    brighter = result.study.display.model_copy(update={"white_cd_per_m2": 250.0})
    pixsim.write_report(
        replace(result, study=result.study.model_copy(update={"display": brighter})), tmp_path
    )
    assert "display white is 250 cd/m² in the scene" in words_of(tmp_path)


def test_light_level_exposure_range(studied: tuple[StudyResult, Path]) -> None:
    irradiance, display = studied[0].irradiance, studied[0].study.display
    assert str(LightLevel.of(irradiance, display, [0.02, 0.005, 0.0123])).endswith(
        "exposed for 5 ms to 20 ms"
    )
    assert str(LightLevel.of(irradiance, display, [0.02, 0.0200001])).endswith("exposed for 20 ms")


SHEET = {
    "data_sheet_pitch_um": 2.0,
    "full_well_e": 8000.0,
    "read_noise_e": 5.0,
    "dark_current_e_per_s": 10.0,
}
SHEET |= {"quantum_efficiency": [[400.0, 0.3], [550.0, 0.6], [700.0, 0.4]]}


@pytest.mark.slow
def test_study_page_of_a_data_sheet_omits_process(
    studied: tuple[StudyResult, Path], tmp_path: Path
) -> None:
    more = {
        "name": "sheet",
        "technologies": ["none"],
        "pixel": SHEET,
        "pitch": {"values_um": [5, 6, 7, 8.5, 11]},
    }
    pixsim.write_report(pixsim.study(tiny(**more), tmp_path, jobs=1), tmp_path)
    page, words = text_of(tmp_path), words_of(tmp_path)
    rows = [
        name.rpartition(".")[2] for name in re.findall(r'<tr><th scope="row">([\w.]+)</th>', page)
    ]
    assert {"full_well_e", "bits", "white_cd_per_m2"} <= set(rows)
    assert not {"capacitance", "well_limit", "conversion", "response", "fill_factor_law"} & set(
        rows
    )
    assert "curve of 3 points, 400 to 700 nm" in words
    assert "Noise and non-uniformities that the data sheet does not state are zero." in words
    assert not [absent for absent in ("come from the technology", "ill factor") if absent in words]
    assert "fill_factor_law" in text_of(studied[1]), "a process uses those settings"


@pytest.mark.slow  # test_paper has the statements, test_plates their figures
def test_study_page_compares_with_the_paper(
    studied: tuple[StudyResult, Path], tmp_path: Path
) -> None:
    """A row for each statement, and no other page has them."""
    own = {"name": "paper", "paper": True, "pixel": {"response": "literal"}}
    pixsim.write_report(pixsim.study(tiny(**own), tmp_path, jobs=1), tmp_path)
    table = text_of(tmp_path).partition('<h2 id="paper">')[2].partition("</table>")[0]
    actual = json.loads((tmp_path / "summary.json").read_text(encoding="utf-8"))["paper"]
    assert table.count('data-name="agrees"') == len(actual)
    assert '<h2 id="paper">' not in text_of(studied[1])


# --- a comparison
# -------------------------------------------------------------------------------------------------------


def test_compare_prints_answer(compared: tuple[Path, str]) -> None:
    folder, out = compared
    found = json.loads((folder / "compare.json").read_text(encoding="utf-8"))
    lines = out.splitlines()
    answer = (
        r"quiet is better than noisy_one by (\d\.\d+) ± (\d\.\d+) ΔE \(probability ([> ]*\.\d+)\)"
        r" with match view; "
        r"depends on the match: quiet is better with view, noisy_one with lens"
    )
    size, error, probability = re.fullmatch(answer, lines[0]).groups()
    assert [difference["dots"] for difference in found["displays"]["noisy_one"]] == [120, 60, 240]
    assert found["displays"]["noisy_one"][0]["difference"] == found["difference"]["noisy_one"]
    half = np.subtract(*found["interval_delta_e"]["noisy_one"][::-1]) / 2
    assert float(size) == pytest.approx(
        found["difference"]["noisy_one"], abs=10.0 ** -len(size.partition(".")[2])
    )
    assert float(error) == pytest.approx(half + found["film_delta_e"]["noisy_one"], rel=0.5)
    assert float(probability.strip("> ")) - 0.0005 <= found["probability_a_better"]["noisy_one"]
    assert lines[1].split()[:3] == ["sensor", "mean", "ΔE"]
    assert re.match(
        r"  quiet +[\d.]+ ± [\d.]+  64 × 48 pixels of 20 µm behind 3.86 mm f/4 ", lines[2]
    )  # the field is the wider one's
    assert "64 × 48 pixels of 15 µm behind 2.89" in lines[3]
    assert lines[4].startswith(
        "the same field of 18.8° × 14.1°; f/4 and focus at 1 m, as quiet; one display of 120 dots"
        " across, "
    )
    assert (
        "23 per degree; 114 × 84 are scored; checked on 60 and 240 dots; 3 pairs of frames"
        in lines[4]
    )
    assert lines[-1] == f"report: {folder / 'report.html'}"


def difference_cell(difference: float, interval: list[float], film_delta_e: float | None) -> str:
    """Return the cell of a page's table with a difference, as its interval and the film's error
    allow.
    """
    low, high = interval
    return f">{difference_cells(difference, (low, high), film_delta_e or 0.0)[0]}</td>"


def test_compare_json_is_consistent_and_on_the_page(compared: tuple[Path, str]) -> None:
    folder, out = compared
    found = json.loads((folder / "compare.json").read_text(encoding="utf-8"))
    a, b = found["names"]
    values = {name: np.array(found["sensors"][name]["delta_e"]) for name in (a, b)}
    assert set(found["scores"]) == {a, b}
    assert (
        set(found["difference"])
        == set(found["interval_delta_e"])
        == set(found["probability_a_better"])
        == {b}
    )
    for name in (a, b):
        low, mean, high = found["scores"][name]
        assert mean == pytest.approx(values[name].mean(), rel=1e-12)
        assert low < mean < high
    assert found["difference"][b] == pytest.approx((values[b] - values[a]).mean(), rel=1e-12)
    low, high = found["interval_delta_e"][b]
    assert 0 < low < found["difference"][b] < high
    assert found["probability_a_better"][b] > 0.975
    assert {sensor["irradiance"]["film"][1] for sensor in found["sensors"].values()} == {256}
    page = " ".join(text_of(folder).split())
    answer, _, _, _, common, *_ = out.splitlines()
    words = " ".join(html.unescape(re.sub(r"<[^>]*>", "", page)).split())
    assert answer in words
    assert [part for part in common.split("; ") if part not in words] == []
    assert (
        difference_cell(
            found["difference"][b], found["interval_delta_e"][b], found["film_delta_e"][b]
        )
        in page
    )
    assert "<td>10000</td>" in page, "the well, without an exponent"


def test_compare_of_three_has_a_verdict_and_rows_of_displays_for_each_pair(tmp_path: Path) -> None:
    out = done(
        f"compare {SMALL.replace('256', '48')}",
        *two_sheets(tmp_path, 400.0),
        "--out",
        tmp_path / "out",
    )
    found = json.loads((tmp_path / "out/compare.json").read_text(encoding="utf-8"))
    begins = [line.partition(" by ")[0] for line in out.splitlines()]
    assert begins[0] == "quiet is better than noisy_one"
    assert "quiet is better than worst" in begins
    assert list(found["pairs"]) == list(found["verdicts"]) == ["noisy_one", "worst"]
    page = " ".join(text_of(tmp_path / "out").split())
    for name in ("noisy_one", "worst"):
        assert page.count(f">{name} − quiet</td>") == 2 + 2, "two matches, two further displays"
        for each in found["displays"][name]:
            assert (
                difference_cell(each["difference"], each["interval_delta_e"], each["film_delta_e"])
                in page
            )


def test_compare_study_answers_with_the_weighted_mean(under_study: tuple[Path, str]) -> None:
    folder, out = under_study
    found = json.loads((folder / "compare.json").read_text(encoding="utf-8"))
    a, b = found["names"]
    own = found["conditions"]
    assert {name: each["weight"] for name, each in own.items()} == {
        "never": 0.0,
        "day": 0.75,
        "night": 0.25,
    }
    for name in (a, b):
        mean = 0.75 * own["day"]["scores"][name][1] + 0.25 * own["night"]["scores"][name][1]
        assert found["scores"][name][1] == pytest.approx(mean)
        assert np.mean(found["sensors"][name]["delta_e"]) == pytest.approx(
            found["scores"][name][1], rel=1e-12
        )
    assert found["difference"][b] == pytest.approx(
        0.75 * own["day"]["difference"][b] + 0.25 * own["night"]["difference"][b]
    )
    assert set(own["day"]) == {
        *("weight", "scores", "difference", "interval_delta_e", "probability_a_better", "film_delta_e", "delta_e"),
    }  # fmt: skip
    assert found["shown_condition"] == "day"
    assert found["study"] == {"name": "both"}
    answer, head, _, _, common, *_ = out.splitlines()
    assert answer.startswith("quiet ")
    assert "; depends on the match: quiet is better with view, " in answer
    assert "exposure in day" in head
    assert common.startswith(
        "the study both; means over its conditions, with the weights never (0), day (0.75), night"
        " (0.25); in day: the same field of 18.8° × 14.1°"
    )
    assert "4 pairs of frames with the same seeds" in common
    page = " ".join(text_of(folder).split())
    assert "never, day" not in page, (
        "rows of conditions and of the mean are those of no other condition"
    )
    for each in (found, *own.values()):
        assert (
            difference_cell(
                each["difference"][b], each["interval_delta_e"][b], each["film_delta_e"][b]
            )
            in page
        )
    assert "Pictures in day" in re.sub(r"<[^>]*>", "", page)
    assert "condition night.pixel.temperature_k</th><td>310</td>" in page
    for line in common.split("; "):
        assert line[1:].replace("'", "&#39;") in page  # the first begins a sentence


# --- a lens
# -------------------------------------------------------------------------------------------------------------


def test_lens_command_writes_page_figures_and_tables(measured: tuple[Path, str]) -> None:
    folder, out = measured
    content = json.loads((folder / "summary.json").read_text(encoding="utf-8"))
    primary = content["first_order"][
        [each["wavelength_nm"] for each in content["first_order"]].index(content["primary_nm"])
    ]
    assert primary["focal_length_mm"] == pytest.approx(50.0, rel=1e-12)
    assert primary["f_number"] == pytest.approx(8.0, rel=1e-12)
    assert out.startswith("double_gauss: f = 50 mm, f/8, fields to 14°")
    assert f"report: {folder / 'report.html'}" in out
    for name in FIGURES:
        assert (folder / f"figures/{name}.svg").stat().st_size > 1000
        head, *rows = (folder / f"figures/{name}.csv").read_text(encoding="utf-8").splitlines()
        assert rows, name
        assert all(len(row.split(",")) == len(head.split(",")) for row in rows), name
    text = text_of(folder)
    assert text.count("<img ") == text.count("alt=") == len(FIGURES)
    assert not [
        glass.name
        for glass in pixsim.load_lens("double_gauss").prescription.glasses
        if glass.name not in text
    ]


@pytest.mark.parametrize("name", ["compare", "compare --study"])
def test_numbers_with_errors_end_at_the_decimal_of_their_error(
    name: str, folders: dict[str, Path]
) -> None:
    """Four digits at most."""
    words = re.sub(r"<[^>]*>", " ", html.unescape(text_of(folders[name])))
    stated = re.findall(r"(\d+(?:\.\d+)?) ± (\d+(?:\.\d+)?)", words)
    assert len(stated) > 1
    for value, error in stated:
        assert len(value.partition(".")[2]) == len(error.partition(".")[2]), (value, error)
        assert len(value.lstrip("0.").replace(".", "")) <= 4, value
