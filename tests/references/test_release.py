"""What release 1.0.0 wrote is read, resumed or kept apart, and its light gives its frame."""

import json
import re
import shutil
import warnings
from pathlib import Path

import numpy as np
import pytest
from helpers.tiny import rows

import pixsim
from pixsim.base.schema import SCHEMA, json_text
from pixsim.report.run import run_document
from pixsim.studies.table import Store
from pixsim.viewer.settings_file import run_settings

DATA = Path(__file__).parents[1] / "data" / "release_1_0_0"


@pytest.fixture
def old_study(tmp_path: Path) -> Path:
    """A copy of the folder of a study."""
    return Path(shutil.copytree(DATA / "study", tmp_path / "study"))


@pytest.mark.parametrize(
    ("version", "message"),
    [
        ("1.0.0", r"results\.csv.*pixsim 1\.0\.0"),
        # An interrupted study has no list yet.
        ("", "other settings"),
        (pixsim.__version__, ""),
    ],
)
def test_rows_are_kept_apart_and_their_release_named(
    version: str, message: str, old_study: Path
) -> None:
    """The list of a folder's files has the version that wrote them."""
    list_path = old_study / "provenance.json"
    text = list_path.read_text(encoding="utf-8")
    list_path.write_text(text.replace('"pixsim": "1.0.0"', f'"pixsim": "{version}"'))
    if not version:
        list_path.unlink()
    before = (old_study / "results.csv").read_bytes()
    with warnings.catch_warnings(record=True, action="always") as caught:
        assert not Store(old_study / "results.csv").resume(lambda _: False)
    assert len(caught) == bool(message)
    assert re.search(message, "".join(str(warning.message) for warning in caught))
    assert (old_study / "results.csv.old").read_bytes() == before
    assert rows(old_study) == []


def test_settings_of_a_study_are_those_of_its_rows(old_study: Path) -> None:
    """Rates of electrons are the same; a repeat now has a place of its own on the die, which moves
    its mean a little.
    """
    before = rows(old_study)
    with pytest.warns(UserWarning, match=r"pixsim 1\.0\.0"):
        pixsim.study(old_study / "settings.toml", old_study, jobs=1)
    now = rows(old_study)
    assert before[0].keys() <= now[0].keys()
    for name in ("pitch_um", "repeat", "fill_factor", "full_well_e"):
        assert [row[name] for row in now] == [row[name] for row in before]
    # At most one of 90 pixels a side comes in for another, on light that differs by some tenths:
    # below 1e-3 of the mean.
    electrons_e = ([float(row["mean_electrons_e"]) for row in each] for each in (now, before))
    np.testing.assert_allclose(*electrons_e, rtol=1e-3)


def test_every_entry_of_a_run_is_still_there() -> None:
    """Entries may be added within a schema (docs/reference/files.md), those of docs/migration.md
    are gone.
    """
    stated = json.loads((DATA / "run/score.json").read_bytes())
    result = pixsim.run("csf", config=DATA / "run/settings.toml")
    gone = {".pixel.dynamic_range_db", ".pixel.snr_max_db"}
    assert entries(stated) - gone <= entries(json.loads(json_text(run_document(result).data)))


def entries(content: object, above: str = "") -> set[str]:
    """Dotted names of all entries of JSON; those of a list together."""
    match content:
        case dict():
            return {
                name
                for key, value in content.items()
                for name in {f"{above}.{key}", *entries(value, f"{above}.{key}")}
            }
        case list() | tuple():
            return {name for value in content for name in entries(value, f"{above}[]")}
    return set()


def test_kept_light_gives_the_frame_and_the_error_of_its_release() -> None:
    """Light, sensor, noise and S-CIELAB of one frame are those of 1.0.0: only renders, films and
    registrations have changed.
    """
    light = pixsim.read_irradiance(DATA / "run/irradiance.exr")
    stated = json.loads((DATA / "run/score.json").read_bytes())
    assert (stated["schema"], SCHEMA) == (1, 2)
    camera = pixsim.Camera.model_validate(light.header["camera"])
    settings = run_settings([DATA / "run/settings.toml"], {})
    score = pixsim.evaluate(light, camera, settings.pixel, settings.exposure, settings.display)
    assert score.mean_delta_e == pytest.approx(stated["mean_delta_e"], rel=1e-9)
    np.testing.assert_array_equal(pixsim.read_frame(DATA / "run/raw.exr").dn, score.frame.dn)
