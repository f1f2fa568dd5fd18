"""Reports and runs are kept if and only if they would be made from equal content, and their files are as they were written."""

from __future__ import annotations

import json
import warnings
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.commands import command
from helpers.tiny import COARSE, tiny, tiny_toml
from matplotlib.figure import Figure

import pixsim
from pixsim.base.files import LIST, publishing, write_made_from
from pixsim.base.notes import Note
from pixsim.base.progress import no_stage
from pixsim.report import kept
from pixsim.report.kept import digest_of_report, keep_or_write
from pixsim.report.run import USUAL, RunFiles, digest_of_run
from pixsim.studies.evaluate import Counts
from pixsim.studies.result import CasesResult, StudyResult
from pixsim.studies.run import light_run, prepare
from pixsim.viewer.setting import Run

FILES = {"report.html": "page", "summary.json": "{}", "figures/curve.svg": "<svg/>"}


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> tuple[StudyResult, Path]:
    folder = tmp_path_factory.mktemp("kept")
    return pixsim.study(tiny(resolution=COARSE), folder, jobs=1), folder


class Report:
    """A report of a few bytes, and how often it was written."""

    def __init__(self, folder: Path) -> None:
        self.folder, self.written = folder, 0

    def write(self) -> Path:
        self.written += 1
        with publishing(self.folder, {"seconds": {"render": float(self.written)}}) as unfinished:
            (unfinished / "figures").mkdir()
            for name, text in FILES.items():
                (unfinished / name).write_text(text, encoding="utf-8")
        return self.folder / "report.html"

    def of(self, result: StudyResult) -> bool:
        """Return whether the report of a result is written now."""
        before = self.written
        assert keep_or_write("study", digest_of_report(result), self.folder, self.write) == self.folder / "report.html"
        return self.written > before


@pytest.fixture
def report(made: tuple[StudyResult, Path], tmp_path: Path) -> Iterator[Report]:
    report = Report(tmp_path)
    assert report.of(made[0])
    yield report
    assert report.written <= 2
    assert not report.of(made[0]) or not report.of(made[0]), "a report that was written is then kept"


def test_keep_or_write_equal_result_is_kept(made: tuple[StudyResult, Path], report: Report) -> None:
    """Of the same study computed again: nothing in the folder is touched."""
    before = {path: (path.stat().st_mtime_ns, path.stat().st_ino) for path in report.folder.rglob("*")}
    assert not report.of(pixsim.study(tiny(resolution=COARSE), made[1], jobs=1))
    assert {path: (path.stat().st_mtime_ns, path.stat().st_ino) for path in report.folder.rglob("*")} == before


def next_number(values: Any) -> Any:
    """Return an array whose last value is the next number of its type."""
    changed = np.array(values)
    changed.flat[-1] = np.nextafter(changed.flat[-1], changed.dtype.type(np.inf))
    return changed


def other_light(result: StudyResult, **header: object) -> StudyResult:
    """Return the result with another header, or else with light that differs in one bit."""
    light = result.irradiance
    assert light.factors
    spectra, pictures = light.factors
    changed = {"factors": (spectra, pictures if header else next_number(pictures)), "within": light.within}
    image = pixsim.SpectralImage(light.wavelength_nm, light.band_width_nm, light.pitch_um, **changed, header=light.header | header)
    return with_light(result, image=image)


def with_light(result: StudyResult, **changes: Any) -> StudyResult:
    return replace(result, light=replace(result.light, **changes))


def other_curve(result: StudyResult, **changes: Callable[[Any], Any]) -> StudyResult:
    curve = result.curves[0]
    return replace(result, curves=(replace(curve, **{name: change(getattr(curve, name)) for name, change in changes.items()}),))


def of_cases(result: StudyResult) -> CasesResult:
    """The result of a study with axes, of one case."""
    return CasesResult(result.study, result.curves, result.light, parts=(result,))


CHANGES: dict[str, Callable[[StudyResult], StudyResult]] = {
    "a setting": lambda result: replace(result, study=result.study.model_copy(update={"title": "another"})),
    "a setting of a table": lambda result: replace(
        result, study=result.study.model_copy(update={"display": result.study.display.model_copy(update={"gamma": 1.8})})
    ),
    "the camera": lambda result: with_light(result, camera=result.camera.model_copy(update={"f_number": 2.9})),
    "the light": other_light,
    "the header of the light": lambda result: other_light(result, more=1),
    "a row": lambda result: other_curve(
        result, statistics=lambda values: values | {"max_delta_e": next_number(values["max_delta_e"])}
    ),
    "the fit": lambda result: other_curve(result, fit=lambda fit: replace(fit, delta_e=next_number(fit.delta_e))),
    "a label": lambda result: other_curve(result, case=lambda case: replace(case, condition="by night")),
    "the film's error": lambda result: with_light(result, film=None),
    "settings.toml": lambda result: replace(result, settings_toml=result.settings_toml + "\n"),
    "a warning": lambda result: replace(result, warned=(*result.warned, Note("other", words="mind this"))),
    "the case of an axis": lambda result: of_cases(result),
    "sensor types": lambda result: replace(result, uncertainty=(result.curves[0].fit.optimum,)),
}


@pytest.mark.parametrize("name", CHANGES)
def test_keep_or_write_other_content_is_written(name: str, made: tuple[StudyResult, Path], report: Report) -> None:
    changed = CHANGES[name](made[0])
    assert report.of(changed)
    assert not report.of(changed)


def test_keep_or_write_other_counts_are_kept(made: tuple[StudyResult, Path], report: Report) -> None:
    """What was computed and what was known before is of the run, as its wall times are."""
    assert report.of(of_cases(made[0]))
    assert not report.of(replace(of_cases(made[0]), counts=Counts(1, 1, 1)))


def forget(folder: Path) -> None:
    (folder / LIST).unlink()
    for name in FILES:  # without it nobody knows that they are pixsim's
        (folder / name).unlink()


def half_published(folder: Path) -> None:
    """As a process leaves it that was killed while it moved its files: each may be the old or the new one."""
    content = json.loads((folder / LIST).read_text())
    (folder / LIST).write_text(json.dumps({name: value for name, value in content.items() if name not in ("written", "made_from")}))


def edit(folder: Path) -> None:
    (folder / "summary.json").write_text("[]")  # of the same size


def other_command(folder: Path) -> None:
    with publishing(folder) as unfinished:
        (unfinished / "report.html").write_text("of a run")


FATES: dict[str, Callable[[Path], object]] = {
    "a missing file": lambda folder: (folder / "figures/curve.svg").unlink(),
    "no list": forget,
    "an edited file": edit,
    "an unfinished command": half_published,
    "the files of another command": other_command,
    "content of something else": lambda folder: write_made_from(folder, "study", "0" * 32),
}


@pytest.mark.parametrize("fate", FATES)
def test_keep_or_write_other_files_are_written(fate: str, made: tuple[StudyResult, Path], report: Report) -> None:
    FATES[fate](report.folder)
    assert report.of(made[0])
    assert {name: (report.folder / name).read_text() for name in FILES} == FILES


@pytest.mark.parametrize("what", ["a template", "a version"])
def test_keep_or_write_other_code_is_written(
    what: str, made: tuple[StudyResult, Path], report: Report, monkeypatch: pytest.MonkeyPatch
) -> None:
    before = digest_of_report(made[0])
    with monkeypatch.context() as patch:
        if what == "a template":
            digests = kept.digest_of
            patch.setattr(kept, "digest_of", lambda path: "other" if path.name == "document.html.j2" else digests(path))
        else:
            patch.setattr(kept, "versions", lambda: {"pixsim": "another"})
        assert digest_of_report(made[0]) != before
        assert report.of(made[0])
    assert digest_of_report(made[0]) == before


def test_digest_of_report_unknown_kind_raises(made: tuple[StudyResult, Path]) -> None:
    with pytest.raises(TypeError, match="a report made from object"):
        digest_of_report(replace(made[0], view={"what": object()}))


# --- commands ---

RUN = "--pixel.pitch-um 21.2 --display.dots 32 --seed 3"
AXIS = {"axis": [{"name": "lens", "set": "camera.f_number", "values": [2.0, 2.8]}], "render_noise": 30.0}


def picture_of(path: Path, light: float = 0.01) -> Path:
    """Write a ramp of 32² samples of unknown white, of which a run warns."""
    ramp = np.linspace(0.2, 1, 32) * light * np.ones((32, 1))
    pixsim.write_npz(path, pixsim.SpectralImage([450.0, 550.0, 650.0], 100.0, 84.8, data=np.repeat(ramp[:, :, None], 3, axis=2)))
    return path


def files_of(folder: Path) -> dict[str, tuple[int, bytes]]:
    """Inode, which a file that is published has of its own, and content; the rows of a study are not published."""
    paths = [path for path in folder.rglob("*") if path.is_file()]
    inodes = [0 if path.name in ("results.csv", "types.csv") else path.stat().st_ino for path in paths]
    return {str(path.relative_to(folder)): (inode, path.read_bytes()) for path, inode in zip(paths, inodes, strict=True)}


@pytest.mark.parametrize(
    "line",
    [
        f"run csf --variant scalar_spectral --resolution 48 {RUN} --json",
        f"run ramp.npz {RUN}",
        "study plain.toml --jobs 1",
        # Their reports are kept by the same function; sensor types take 7 s.
        pytest.param("study axis.toml --jobs 1", marks=pytest.mark.slow),
        pytest.param("study plain.toml --jobs 1 --uncertainty 8 --yes", marks=pytest.mark.slow),
    ],
)
def test_command_again_keeps_all_files(line: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Its result is that of the first time, and it draws nothing; a run says what it said, while a study names its rows."""
    monkeypatch.chdir(tmp_path)
    picture_of(tmp_path / "ramp.npz")
    for name, more in (("plain", {}), ("axis", AXIS)):
        (tmp_path / f"{name}.toml").write_text(tiny_toml(**more), encoding="utf-8")
    first = command(f"{line} --out out")
    assert first[0] == 0, first
    assert ("does not define its white" in first[2]) == ("ramp" in line)
    before = files_of(tmp_path / "out")
    monkeypatch.setattr(Figure, "__init__", lambda *_, **__: pytest.fail("a figure is drawn"))
    again = command(f"{line} --out out")
    assert again[: 3 if line.startswith("run") else 2] == first[: 3 if line.startswith("run") else 2]
    assert files_of(tmp_path / "out") == before


def digest_of(picture: Path, files: RunFiles = USUAL, frames: int = 1, full: bool = False, **more: object) -> str:
    settings = Run.model_validate({"pixel": {"pitch_um": 21.2}, "display": {"dots": 32}, "seed": 3, **more})
    with warnings.catch_warnings(action="ignore"):
        return digest_of_run(light_run(prepare(str(picture), settings, frames=frames, full=full), no_stage), files)


def test_digest_of_run_other_content_has_another(tmp_path: Path) -> None:
    ramp, bright = picture_of(tmp_path / "ramp.npz"), picture_of(tmp_path / "bright.npz", 0.02)
    own = digest_of(ramp)
    assert digest_of(ramp) == own
    others = {
        "a setting": digest_of(ramp, seed=4),
        "the camera": digest_of(ramp, camera={"f_number": 2.8}),
        "the files asked for": digest_of(ramp, RunFiles((".png",), "none")),
        "the number of frames": digest_of(ramp, frames=2),
        "full": digest_of(ramp, full=True),
        "the light": digest_of(bright.rename(ramp)),
        "the name of the picture": digest_of(picture_of(tmp_path / "r.npz")),
    }
    assert [name for name, other in others.items() if other == own] == []
    assert len(set(others.values())) == len(others)


def test_run_command_of_something_else_writes_all_files(tmp_path: Path) -> None:
    """Their content is that of a run into a new folder."""
    line = f"run {picture_of(tmp_path / 'ramp.npz')} {RUN} --out {tmp_path}"
    assert command(f"{line}/out")[0] == 0
    before = files_of(tmp_path / "out")
    for folder in ("out", "new"):
        assert command(f"{line.replace('--seed 3', '--seed 4 --raw png')}/{folder}")[0] == 0
    after, new = (files_of(tmp_path / folder) for folder in ("out", "new"))
    assert not [name for name in after if name in before and after[name] == before[name]], "files that were not written"
    assert after.keys() == new.keys()
    assert not [name for name in after if name != LIST and after[name][1] != new[name][1]]
