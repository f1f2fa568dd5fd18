"""Studies: rows computed and stored, independent of workers, threads, order and interruptions."""

from __future__ import annotations

import json
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.commands import command
from helpers.tiny import PITCHES_UM, WHOLE_CHART, keys, rows, tiny as tiny_study, tiny_toml

import pixsim
from pixsim.base import cache
from pixsim.base.arrays import stream
from pixsim.base.files import FOLDER_VARIABLE
from pixsim.base.toml import packaged, read_toml
from pixsim.report.axes import optima_columns
from pixsim.report.curve import delta_e_against_pitch, optimum_line
from pixsim.report.study import report_files
from pixsim.sensor.readout import Frame
from pixsim.studies import evaluate as evaluate_module
from pixsim.studies.result import StudyResult

SETTINGS = {"repeats": 3, "seed": 1}
FIVE_UM = [*PITCHES_UM[:4], PITCHES_UM[5]]  # the frame that is scored follows from the largest


def tiny(**over: object) -> pixsim.Study:
    return tiny_study(**SETTINGS | over)


@pytest.fixture(scope="module")
def done(tmp_path_factory: pytest.TempPathFactory) -> tuple[StudyResult, Path]:
    """The tiny study from Python, in this process."""
    folder = tmp_path_factory.mktemp("done")
    return pixsim.study(tiny(), folder, jobs=1), folder


def test_study_has_row_per_pitch_and_sensor(done: tuple[StudyResult, Path]) -> None:
    result, folder = done
    table = rows(folder)
    places = [(float(row["pitch_um"]), int(row["repeat"])) for row in table]
    assert places == [(pitch_um, repeat) for pitch_um in PITCHES_UM for repeat in range(3)]
    assert len(set(keys(folder))) == 18
    curve = result.curves[0]
    delta_e = [float(row["mean_delta_e"]) for row in table]
    np.testing.assert_array_equal(curve.delta_e.ravel(), delta_e)
    assert len(np.unique(curve.delta_e)) == 18, "no two sensors are the same"
    # The fitted minimum can lie below the lowest point, not above its mean by more than the fit
    # smooths.
    least = curve.delta_e.mean(axis=1).min()
    assert curve.optimum.mean_delta_e == pytest.approx(least, rel=0.06)


def test_study_command_writes_the_rows_of_python(
    done: tuple[StudyResult, Path], tmp_path: Path
) -> None:
    (tmp_path / "tiny.toml").write_text(tiny_toml(**SETTINGS), encoding="utf-8")
    out = tmp_path / "out"
    code, message, err = command(f"study {tmp_path / 'tiny.toml'} --out {out} --jobs 1")
    assert code == 0, err
    assert optimum_line(done[0].curves[0]).partition("; ")[0] in message
    assert (out / "results.csv").read_bytes() == (done[1] / "results.csv").read_bytes()
    figures = {f"figures/{path.name}" for path in (out / "figures").iterdir()}
    assert figures <= report_files(done[0].study)


def test_study_notes_reach_summary_and_result(tmp_path: Path) -> None:
    """Once each, and from a resumed study too."""
    over: dict[str, Any] = {"display": {"white_cd_per_m2": 40.0}, "pixel": {"bits": 8}}
    (tmp_path / "tiny.toml").write_text(tiny_toml(**over), encoding="utf-8")
    command(f"study {tmp_path / 'tiny.toml'} --out {tmp_path / 'out'} --jobs 1")
    summary = json.loads((tmp_path / "out/summary.json").read_text(encoding="utf-8"))
    with pytest.warns(UserWarning, match="brighter than display white"):
        resumed = pixsim.study(tiny_study(**over), tmp_path / "out", jobs=1).as_dict()
    for notes in (summary["notes"], resumed["notes"]):
        assert [note["id"] for note in notes] == ["white_clipped", "interval", "black_level"]


# 0: whole; 4: within the last number, which still reads as one (lines end in \r\n); 60: in an
# earlier column; 2000: rows are gone.
@pytest.mark.parametrize("cut_bytes", [0, 4, 60, 2000])
def test_study_truncated_file_is_completed(
    cut_bytes: int, done: tuple[StudyResult, Path], tmp_path: Path, evaluations: list[Frame]
) -> None:
    whole = (done[1] / "results.csv").read_bytes()
    part = whole[: len(whole) - cut_bytes]
    (tmp_path / "results.csv").write_bytes(part)
    again = pixsim.study(tiny(), tmp_path, jobs=1)
    assert (tmp_path / "results.csv").read_bytes() == whole
    assert len(evaluations) == 18 - (part.count(b"\n") - 1)
    assert again.as_dict() == done[0].as_dict()
    assert not list(tmp_path.glob(".*"))


NUMBERS = {
    "dark_current_na_per_cm2": 30.0,
    "dsnu": 0.6,
    "column_fpn": 0.003,
    "peak_quantum_efficiency": 0.2,
    "node_capacitance_ff": 2.5,
    "voltage_swing_v": 0.9,
    "fill_factor_limit": 0.8,
    "feature_size_um": 0.34,
}


def test_study_process_numbers_equal_file(tmp_path: Path) -> None:
    """Bit for bit: a technology of the same name has the same random streams."""
    lines = ['name = "0.35um"']
    for name, entry in read_toml(packaged("data/technologies")["0.35um"]).items():
        if isinstance(entry, dict):
            value = json.dumps(NUMBERS.get(name, entry["value"]))
            lines += [f"[{name}]", f"value = {value}", 'confidence = "D"', 'source = "here"']
    file = tmp_path / "own.toml"
    file.write_text("\n".join(lines), encoding="utf-8")
    settings = {"repeats": 2, "pitch": {"min_fill_factor": 0.1, "count": 5, "values_um": None}}
    curves = [
        pixsim.study(tiny(**settings, **over), tmp_path / name, jobs=1).curves[0]
        for name, over in (
            ("file", {"technologies": (str(file),)}),
            ("study", {"process": {"0.35um": NUMBERS}}),
        )
    ]
    assert curves[0].feature_size_um == curves[1].feature_size_um == 0.34
    for name, values in curves[0].statistics.items():
        np.testing.assert_array_equal(values, curves[1].statistics[name], err_msg=name)


# --- what a row depends on


def test_study_changed_texture_is_recomputed(tmp_path: Path, evaluations: list[Frame]) -> None:
    chart = tmp_path / "chart.exr"
    scene = {"parameters": {"chart": str(chart)}}
    study = tiny(repeats=2, pitch={"values_um": FIVE_UM}, scene=scene)
    counts = []
    for dark in (0.1, 0.1, 0.2):
        pixsim.write_chart(chart, np.kron([[dark, 1.0]], np.ones((16, 8))).astype(np.float32))
        pixsim.study(study, tmp_path / "out", jobs=1)
        counts.append(len(evaluations))
    assert counts == [10, 10, 20]
    assert len(rows(tmp_path / "out")) == 10, "rows of the old texture are gone"


@pytest.mark.parametrize(
    ("over", "count", "shared"),
    [
        # Some of the pitches, others among them, backwards, up to the same largest one.
        ({"pitch": {"values_um": [PITCHES_UM[-1], 11.0, 9.9, 8.5, 7.7, 6.0]}}, 18, 4 * 3),
        # Neither keys nor random streams of 0.35 µm depend on what 0.25 µm has.
        ({"technologies": ("0.35um", "0.25um"), "process": {"0.25um": {"dsnu": 0.6}}}, 36, 6 * 3),
        # Fewer sizes and sensors change how much is done, not what.
        ({"repeats": 2, "pitch": {"values_um": FIVE_UM}}, 10, 5 * 2),
        # One more sensor is the only thing that is computed.
        ({"repeats": 4}, 24, 6 * 3),
    ],
    ids=["other pitches", "another process", "fewer", "more"],
)
def test_study_row_depends_on_its_sensor_only(
    over: dict[str, Any],
    count: int,
    shared: int,
    done: tuple[StudyResult, Path],
    tmp_path: Path,
    evaluations: list[Frame],
) -> None:
    (tmp_path / "results.csv").write_bytes((done[1] / "results.csv").read_bytes())
    pixsim.study(tiny(**over), tmp_path, jobs=1)
    assert len(evaluations) == count - shared
    assert len(rows(tmp_path)) == count
    pixsim.study(tiny(**over), tmp_path / "anew", jobs=1)
    assert rows(tmp_path / "anew") == rows(tmp_path)


FLICKER = {"frames": 4, "flicker_hz": 100.0, "flicker_depth": 0.9, "integration_s": 0.012}
COLOUR = {"sensitivities": "Nikon_D5100", "peak_quantum_efficiency": 0.5}
BURST = WHOLE_CHART | {
    "exposure": FLICKER,
    "pixel": {"colour": COLOUR, "full_well_e": 1500},
    "technologies": ("4t-bsi",),
}


@pytest.mark.parametrize(
    "frames", [{"exposure": {"integration_s": 1.0}}, BURST], ids=["grey", "burst"]
)
def test_study_cached_frames_same_bytes(
    frames: dict[str, Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Overexposed, so that some pixels are saturated: they are stored with the frame, since its DN
    do not show them. Neither frames nor the light behind them are computed again; a frame that is
    damaged is.
    """
    monkeypatch.setenv(FOLDER_VARIABLE, str(tmp_path / "cache"))
    pitch = {"values_um": [10.0, 12.0, 14.0, 17.0, 20.0]}
    study = tiny(repeats=2, pitch=pitch, resolution=128, **frames)
    results = tmp_path / "out/results.csv"

    def bytes_of_rows() -> bytes:
        results.unlink(missing_ok=True)
        pixsim.study(study, results.parent, jobs=1)
        return results.read_bytes()

    cold = bytes_of_rows()
    assert all(0.3 < float(row["saturated_fraction"]) < 0.999 for row in rows(results.parent))
    with monkeypatch.context() as patch:
        patch.setattr(evaluate_module, "chain_of", lambda *_: pytest.fail("light on the pixels"))
        assert bytes_of_rows() == cold
    for path in (tmp_path / "cache/frames").iterdir():
        arrays = cache.arrays("frames", path.stem) or {}
        planes = {part: array for part, array in arrays.items() if array.ndim == 2}
        cache.store_arrays("frames", path.stem, planes)  # without the mean of its electrons
    assert bytes_of_rows() == cold


KEY = ("study", 1, "0.35um", 6.5, 0, "frame")


@pytest.mark.parametrize(
    "key",
    [
        ("study", 1, "0.35um", 6.5, 1, "frame"),
        ("study", 1, "0.35um", 6.5, 0, "sensor"),
        ("study", 1, "0.35um", 6.5000001, 0, "frame"),
        ("study", 10, ".35um", 6.5, 0, "frame"),
        ("study", "1", "0.35um", 6.5, 0, "frame"),
    ],
)
def test_stream_depends_on_key_only(key: tuple[Any, ...]) -> None:
    """The correlation of 10⁵ pairs of independent numbers is below 5/√n but once in 2 million."""
    numbers = stream(*KEY).normal(size=100_000)
    np.testing.assert_array_equal(numbers, stream(*KEY).normal(size=100_000))
    correlation = np.corrcoef(numbers, stream(*key).normal(size=100_000))[0, 1]
    assert abs(correlation) < 5 / np.sqrt(100_000)


@pytest.mark.parametrize(
    ("luminance", "end_um", "sizes_um"),
    [(1e4, 8.0, [8, 9, 10, 11, 12]), (1.0, 7.0, [5.2, 5.5, 6, 6.5, 7])],
)
def test_study_minimum_at_end_is_no_optimum(
    luminance: float, end_um: float, sizes_um: list[float], tmp_path: Path
) -> None:
    """In bright light small pixels are not yet short of photons; in the dark only the largest will
    do.
    """
    scene = {"parameters": {"luminance_cd_per_m2": luminance}}
    study = tiny(repeats=2, scene=scene, pitch={"values_um": sizes_um})
    optimum = pixsim.study(study, tmp_path, jobs=1).curves[0].optimum
    assert (optimum.inside, optimum.pitch_um) == (False, pytest.approx(end_um))


APERTURES_UM = [6.0, 7.0, 9.0, 15.0, 20.0]


def test_study_marks_sizes_where_the_model_of_a_microlens_is_doubtful(tmp_path: Path) -> None:
    """Fresnel numbers n p²/(4 λ h), with the last band below the infrared cut: one warning, and
    marks of the lensed pixels alone.
    """
    axis = {"name": "aperture", "set": "pixel.stack.microlens", "values": ["none", "square"]}
    stack = {"height_um": 100.0, "index": 1.5, "shift": "optimal"}
    pixel = {"stack": stack, "infrared_cut_nm": 650.0}
    study = tiny(repeats=2, pitch={"values_um": APERTURES_UM}, pixel=pixel, axis=[axis])
    with warnings.catch_warnings(record=True, action="always") as caught:
        result = pixsim.study(study, tmp_path, jobs=1)
    assert sum("Fresnel number of 0.2" in str(warning.message) for warning in caught) == 1
    bare, lensed = result.curves
    assert bare.fresnel_number is bare.doubtful_below_um is None
    longest_nm = 1.5 * np.square(APERTURES_UM) / (4e-3 * 100.0 * lensed.fresnel_number)
    np.testing.assert_allclose(longest_nm, np.full(5, longest_nm[0]), rtol=1e-12)
    assert 630.0 < longest_nm[0] <= 655.0
    assert lensed.doubtful.tolist() == [True, True, True, False, False]
    expected = (lensed.optimum.pitch_um / lensed.doubtful_below_um) ** 2
    assert optima_columns(result)["fresnel_number"] == ["", pytest.approx(expected)]
    assert "hollow points" in delta_e_against_pitch([lensed]).caption
