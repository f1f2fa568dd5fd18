"""The page of one picture: what a run found, and what people see of it, in one file that opens alone."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from pixsim.assumed import FILLED, Light, only_sheets, record_rows, scene_rows
from pixsim.details import Picture, crops, factor_for, reduced, scale, worst_window
from pixsim.labels import label_of
from pixsim.merit import blur_words
from pixsim.pages import write_page
from pixsim.parameters import Camera, Display, Exposure
from pixsim.pictures import extent, grey_codes
from pixsim.score import Score
from pixsim.spectral import Array, SpectralImage
from pixsim.wording import budget_lines, dark_note, score_line

# What lies beside the page.
FILES = {
    "score.json": "all numbers and settings, for programs",
    "irradiance.exr": "light on the sensor, before diffraction",
    "raw.exr": "digital numbers of the sensor",
    "ideal.png": "what an ideal camera would have shown",
    "image.png": "what the viewer is shown",
    "delta_e.exr": "S-CIELAB map, for programs",
    "delta_e.png": "S-CIELAB map, with axes",
    "provenance.json": "versions and times",
}
AFTERWARDS = ("score.json", "provenance.json")
MEANINGS = {
    "pitch_um": "pixel size, centre to centre (µm)",
    "fill_factor": "photodiode area over pixel area",
    "full_well_e": "full well (electrons)",
    "integration_s": "exposure time (s)",
    "saturated_fraction": "saturated pixels, of all: their charge reached the well, or their DN the top code",
    "mean_electrons_e": "mean photo-electrons of all pixels",
    "mean_delta_e": "mean ΔE",
    "median_delta_e": "median ΔE",
    "p90_delta_e": "ΔE that 90 % of the dots are below",
    "p99_delta_e": "ΔE that 99 % of the dots are below",
    "max_delta_e": "largest ΔE",
}


def write_run_page(folder: Path, score: Score, irradiance: SpectralImage, summary: dict[str, Any]) -> None:
    """Write report.html beside the run's other files, which it names, and whose pictures it holds."""
    window = worst_window([score.delta_e])
    width_mm, height_mm = extent(irradiance)[1:3]
    left_mm, right_mm, bottom_mm, top_mm = extent(irradiance, score.border_um)
    physics, header = score.physics, irradiance.header
    parameters = header.get("parameters")  # in a file from elsewhere it may be anything
    name = f"{physics.pitch_um:g} µm pixels"
    ideal = shown_picture(folder / "ideal.png", score.ideal, "ideal image")
    image = shown_picture(folder / "image.png", score.image, name)
    rows, columns = score.frame.dn.shape
    camera = Camera.model_validate(summary["camera"])
    display = Display.model_validate(summary["display"])
    light = Light.of(irradiance, display, [summary["integration_s"]])
    sheet = only_sheets([physics.technology.name])
    told = score.statistics()
    if sheet and told["fill_factor"] > FILLED:
        del told["fill_factor"]  # none was told
    records = {
        "camera": camera,
        "pixel": physics.pixel,
        "exposure": Exposure.model_validate(summary["exposure"]),
        "display": display,
    }
    page = {
        "scene": Path(str(header.get("scene", header.get("source", "a picture made elsewhere")))).stem,
        "line": score_line(summary),
        "summary": summary,
        "physics": physics,
        "label": label_of(physics.technology.name),
        "pixels": (columns, rows),
        "die_mm": (width_mm, height_mm),
        "camera": camera,
        "well": float(score.frame.mean_e.max()) / physics.full_well_e,
        "ideal": ideal,
        "image": image,
        "samples_per_deg": display.samples_per_deg,
        "reduced": factor_for(score.ideal),
        "crops": crops(score, window, "the sensor's picture"),
        "place_mm": (left_mm + window.centre[0] * (right_mm - left_mm), top_mm + window.centre[1] * (bottom_mm - top_mm)),
        "border_um": score.border_um,
        "dots": (score.delta_e.shape[1], score.delta_e.shape[0]),
        "scale_bar": scale(),
        "map": (folder / "delta_e.png").read_bytes(),
        "statistics": [(MEANINGS[key], value) for key, value in told.items()],
        "notes": dark_note(summary),
        "blur": blur_words(irradiance, camera, physics, display),
        "budget": budget_lines(summary),
        "light": light,
        "settings": [
            ("scene", scene_rows(irradiance, parameters if isinstance(parameters, dict) else {}, light)),
            *((title, record_rows(title, record, sheet)) for title, record in records.items()),
        ],
        "sheet": sheet,
        "header": header,
        "files": files_in(folder),
    }
    write_page(folder / "report.html", "run.html.j2", page)


def files_in(folder: Path) -> dict[str, str]:
    """What lies there and what it is, and what comes after the page."""
    more = {path.name: "the same as raw.exr, for other programs" for path in sorted(folder.glob("raw.*")) if path.name not in FILES}
    return {name: words for name, words in FILES.items() if (folder / name).exists() or name in AFTERWARDS} | more


def shown_picture(path: Path, luminance: Array, name: str) -> Picture:
    """A whole picture: its file, or, where it is large, the `reduced` one."""
    if factor_for(luminance) == 1:
        return Picture(name, "", path.read_bytes(), luminance.shape[1], luminance.shape[0])
    return Picture.of(grey_codes(reduced(luminance)), name)
