"""Studies: rows computed and stored, independent of workers, threads, order and interruptions; the
table of evaluations, its file, and the memory of many; and results that release 1.0.0 wrote.
"""

import io
import tracemalloc
import warnings
from itertools import product
from pathlib import Path

import numpy as np
import pytest
from helpers.commands import command
from helpers.tiny import PITCHES_UM, WHOLE_CHART, rows, tiny as tiny_study, tiny_toml, toml_of

import pixsim
from pixsim.base import cache
from pixsim.base.arrays import stream
from pixsim.base.files import FOLDER_VARIABLE
from pixsim.base.toml import packaged, read_toml
from pixsim.report.axes import optima_columns
from pixsim.report.curve import delta_e_against_pitch, optimum_line
from pixsim.report.study import report_files
from pixsim.studies import evaluate as evaluate_module
from pixsim.studies.result import StudyResult
from pixsim.studies.table import COLUMNS, REASON, Store, Table

FIVE_UM = [*PITCHES_UM[:4], PITCHES_UM[5]]  # the frame that is scored follows from the largest


def tiny(**over: object) -> pixsim.Study:
    return tiny_study(**{"repeats": 3, "seed": 1} | over)


@pytest.fixture(scope="module")
def done(tmp_path_factory: pytest.TempPathFactory) -> tuple[StudyResult, Path]:
    """The tiny study from Python, in this process."""
    folder = tmp_path_factory.mktemp("done")
    return pixsim.study(tiny(), folder, jobs=1), folder


def test_study_has_row_per_pitch_and_sensor(done: tuple[StudyResult, Path]) -> None:
    (curve,) = done[0].curves
    table = rows(done[1])
    places = [(float(row["pitch_um"]), int(row["repeat"])) for row in table]
    assert places == list(product(PITCHES_UM, range(3)))
    assert len({row["key"] for row in table}) == len(np.unique(curve.delta_e)) == 18
    delta_e = [float(row["mean_delta_e"]) for row in table]
    np.testing.assert_array_equal(curve.delta_e.ravel(), delta_e)
    # The fitted minimum can lie below the lowest point, not above its mean by more than the fit
    # smooths.
    assert curve.optimum.mean_delta_e == pytest.approx(curve.delta_e.mean(axis=1).min(), rel=0.06)


def test_study_command_writes_the_rows_of_python(
    done: tuple[StudyResult, Path], tmp_path: Path
) -> None:
    (tmp_path / "tiny.toml").write_text(tiny_toml(repeats=3, seed=1), encoding="utf-8")
    _, message, err = command(f"study {tmp_path / 'tiny.toml'} --out {tmp_path / 'out'} --jobs 1")
    assert optimum_line(done[0].curves[0]).partition("; ")[0] in message, err
    assert (tmp_path / "out/results.csv").read_bytes() == (done[1] / "results.csv").read_bytes()
    figures = {f"figures/{path.name}" for path in (tmp_path / "out/figures").iterdir()}
    assert figures <= report_files(done[0].study)


# 0: whole; 4: within the last number, which still reads as one (lines end in \r\n); 60: in an
# earlier column; 2000: rows are gone.
@pytest.mark.parametrize("cut_bytes", [0, 4, 60, 2000])
def test_study_truncated_file_is_completed(
    cut_bytes: int, done: tuple[StudyResult, Path], tmp_path: Path, evaluations: list[pixsim.Frame]
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
    entries = read_toml(packaged("data/technologies")["0.35um"])
    stated = {
        name: {"value": NUMBERS.get(name, entry["value"]), "confidence": "D", "source": "here"}
        for name, entry in entries.items()
        if isinstance(entry, dict)
    }
    lines = [
        f"{name} = {toml_of(entry)}\n" for name, entry in ({"name": "0.35um"} | stated).items()
    ]
    (tmp_path / "own.toml").write_text("".join(lines), encoding="utf-8")
    settings = {"repeats": 2, "pitch": {"min_fill_factor": 0.1, "count": 5, "values_um": None}}
    by_file, by_study = (
        pixsim.study(tiny(**settings, **over), tmp_path / name, jobs=1).curves[0]
        for name, over in (
            ("file", {"technologies": (str(tmp_path / "own.toml"),)}),
            ("study", {"process": {"0.35um": NUMBERS}}),
        )
    )
    assert by_file.feature_size_um == by_study.feature_size_um == 0.34
    np.testing.assert_equal(by_file.statistics, by_study.statistics)


# --- what a row depends on


def test_study_changed_texture_is_recomputed(
    tmp_path: Path, evaluations: list[pixsim.Frame]
) -> None:
    scene = {"parameters": {"chart": str(tmp_path / "chart.exr")}}
    study = tiny(repeats=2, pitch={"values_um": FIVE_UM}, scene=scene)
    counts = []
    for dark in (0.1, 0.1, 0.2):
        cells = np.kron([[dark, 1.0]], np.ones((16, 8))).astype(np.float32)
        pixsim.write_chart(tmp_path / "chart.exr", cells)
        pixsim.study(study, tmp_path / "out", jobs=1)
        counts.append((len(evaluations), len(rows(tmp_path / "out"))))
    assert counts == [(10, 10), (10, 10), (20, 10)], "rows of the old texture are gone"


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
    over: dict,
    count: int,
    shared: int,
    done: tuple[StudyResult, Path],
    tmp_path: Path,
    evaluations: list[pixsim.Frame],
) -> None:
    (tmp_path / "results.csv").write_bytes((done[1] / "results.csv").read_bytes())
    pixsim.study(tiny(**over), tmp_path, jobs=1)
    assert len(evaluations) == count - shared
    pixsim.study(tiny(**over), tmp_path / "anew", jobs=1)
    assert rows(tmp_path / "anew") == rows(tmp_path)
    assert len(rows(tmp_path)) == count


BURST = WHOLE_CHART | {
    "exposure": {"frames": 4, "flicker_hz": 100.0, "flicker_depth": 0.9, "integration_s": 0.012},
    "pixel": {
        "colour": {"sensitivities": "Nikon_D5100", "peak_quantum_efficiency": 0.5},
        "full_well_e": 1500,
    },
    "technologies": ("4t-bsi",),
}


@pytest.mark.parametrize(
    "frames",
    # A grey frame has the claim.
    [{"exposure": {"integration_s": 1.0}}, pytest.param(BURST, marks=pytest.mark.slow)],
    ids=["grey", "burst"],
)
def test_study_cached_frames_same_bytes(
    frames: dict, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Overexposed, so that some pixels are saturated: they are stored with the frame, since its DN
    do not show them. Neither frames nor the light behind them are computed again; a frame that is
    damaged is.
    """
    monkeypatch.setenv(FOLDER_VARIABLE, str(tmp_path / "cache"))
    pitch = {"values_um": [10.0, 12.0, 14.0, 17.0, 20.0]}
    study = tiny(repeats=2, pitch=pitch, resolution=128, **frames)

    pixsim.study(study, tmp_path / "cold", jobs=1)
    cold = rows(tmp_path / "cold")
    assert all(0.3 < float(row["saturated_fraction"]) < 0.999 for row in cold)
    with monkeypatch.context() as patch:
        patch.setattr(evaluate_module, "chain_of", lambda *_: pytest.fail("light on the pixels"))
        pixsim.study(study, tmp_path / "cached", jobs=1)
    for path in (tmp_path / "cache/frames").iterdir():
        arrays = cache.arrays("frames", path.stem) or {}
        planes = {part: array for part, array in arrays.items() if array.ndim == 2}
        cache.store_arrays("frames", path.stem, planes)  # without the mean of its electrons
    pixsim.study(study, tmp_path / "damaged", jobs=1)
    assert rows(tmp_path / "cached") == rows(tmp_path / "damaged") == cold


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
def test_stream_depends_on_key_only(key: tuple[object, ...]) -> None:
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


def test_study_marks_sizes_where_the_model_of_a_microlens_is_doubtful(tmp_path: Path) -> None:
    """Fresnel numbers n p²/(4 λ h), with the last band below the infrared cut: one warning, and
    marks of the lensed pixels alone.
    """
    pitch_um = [6.0, 7.0, 9.0, 15.0, 20.0]
    axis = {"name": "aperture", "set": "pixel.stack.microlens", "values": ["none", "square"]}
    stack = {"height_um": 100.0, "index": 1.5, "shift": "optimal"}
    pixel = {"stack": stack, "infrared_cut_nm": 650.0}
    study = tiny(repeats=2, pitch={"values_um": pitch_um}, pixel=pixel, axis=[axis])
    with warnings.catch_warnings(record=True, action="always") as caught:
        result = pixsim.study(study, tmp_path, jobs=1)
    assert sum("Fresnel number of 0.2" in str(warning.message) for warning in caught) == 1
    bare, lensed = result.curves
    assert bare.fresnel_number is bare.doubtful_below_um is None
    longest_nm = 1.5 * np.square(pitch_um) / (4e-3 * 100.0 * lensed.fresnel_number)
    np.testing.assert_allclose(longest_nm, np.full(5, longest_nm[0]), rtol=1e-12)
    assert 630.0 < longest_nm[0] <= 655.0
    assert lensed.doubtful.tolist() == [True, True, True, False, False]
    best = (lensed.optimum.pitch_um / lensed.doubtful_below_um) ** 2
    assert optima_columns(result)["fresnel_number"] == ["", pytest.approx(best)]
    assert "hollow points" in delta_e_against_pitch([lensed]).caption


def table(**more) -> Table:
    """Two cases of two sensors of one size each, ΔE of 1 to 4."""
    columns = {
        "pitch_um": np.array([5.0, 5.0, 7.5, 7.5]), "repeat": np.array([0, 1, 0, 1], np.int32),
        **{name: np.arange(1.0, 5.0) for name in COLUMNS[4:]},
    }  # fmt: skip
    labels = {"technology": "a", "light": 10.0}, {"technology": "b", "light": 20.0}
    return Table(labels, np.array([0, 0, 1, 1], np.int32), columns, **more)


def test_a_table_iterates_dicts_in_the_order_of_the_file() -> None:
    rows = list(table())
    names = ["technology", "pitch_um", "repeat", "light"]
    assert [list(row) for row in rows] == [[*names, *COLUMNS[4:]]] * 4
    assert rows[2] == table()[2] == table()[-2] == table()[1:3][1]
    assert [rows[2][name] for name in names] == ["b", 7.5, 0, 20.0]
    assert [type(rows[0][name]) for name in ("pitch_um", "repeat")] == [float, int]


def test_an_impossible_point_is_a_row_with_its_reason() -> None:
    with_reason = table(impossible={2: "its colours are alike"})
    assert [row[REASON] for row in with_reason] == ["", "", "its colours are alike", ""]
    assert with_reason.where(technology="b")[0][REASON] == "its colours are alike"
    assert [(row["repeat"], REASON in row) for row in with_reason.possible] == [
        (0, False),
        (1, False),
        (1, False),
    ]


def test_rows_are_chosen_by_labels_and_columns() -> None:
    assert [row["mean_delta_e"] for row in table().where(technology="b", repeat=1)] == [4.0]
    assert len(table().where(light=30.0)) == 0
    assert [len(each) for each in table().by_case()] == [2, 2]


def test_csv_and_dataframe_have_all_rows(done: tuple[StudyResult, Path], tmp_path: Path) -> None:
    assert done[0].to_csv(tmp_path / "table.csv") == (tmp_path / "table.csv").read_bytes().decode()
    delta_e = [float(row["mean_delta_e"]) for row in rows(tmp_path / "table.csv")]
    np.testing.assert_array_equal(delta_e, done[0].curves[0].delta_e.ravel())
    pandas = pytest.importorskip("pandas")
    frame = pandas.read_csv(io.StringIO(table().to_csv(tmp_path / "small.csv")))
    pandas.testing.assert_frame_equal(frame, table().to_dataframe(), check_dtype=False)


def test_a_row_takes_little_memory() -> None:
    """A million rows take a sixth of a GiB: eleven numbers of 8 bytes, a key of 16 characters, and
    its place.
    """
    store = Store(None)
    tracemalloc.start()
    for number in range(5000):
        store.add([(f"{number:016x}", "0.35um", 5.0, 0, *[number / 7] * len(store.numbers))])
    row_bytes = tracemalloc.get_traced_memory()[0] / 5000
    tracemalloc.stop()
    assert 8 * len(store.numbers) < row_bytes < 300
    np.testing.assert_array_equal(store.values_of([f"{3:016x}", "other"])[:, 0], [3 / 7, np.nan])


def test_a_row_with_any_changed_byte_is_computed_again_with_a_note(tmp_path: Path) -> None:
    """A CRC-32 tells any change of up to 32 neighbouring bits; a row without its check, or below
    other names of columns, is not believed.
    """
    results = Store(tmp_path / "results.csv")
    results.write([["1"] * len(results.columns)])
    head, line = results.path.read_bytes().splitlines(keepends=True)
    damaged = [
        head + line[:place] + bytes([byte ^ 4]) + line[place + 1 :]
        for place, byte in enumerate(line.rstrip())
    ]
    damaged.append(head + line[: line.rindex(b",")] + b"\r\n")
    damaged.append(head.replace(b"full_well_e,integration_s", b"integration_s,full_well_e") + line)
    for content in damaged:
        results.path.write_bytes(content)
        with pytest.warns(UserWarning, match=r"1 row .* kept as 'results.csv.old"):
            assert Store(results.path).resume(lambda _: True) == []
        assert results.path.read_bytes() == head
