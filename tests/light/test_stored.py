"""Spectral images whose pictures lie in a file: the same in everything, and not in memory."""

from __future__ import annotations

import copy
import pickle
import subprocess
import sys
import weakref
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pixsim.light import stored
from pixsim.light.spectral import SpectralImage
from pixsim.light.stored import PictureFile, StoredImage

NM = np.array([500.0, 550.0, 600.0])
FACTORS = np.array([[1.0, 2.0, 3.0], [0.5, 0.0, 0.25]])


def picture(kind: str, seed: int = 0) -> SpectralImage:
    values = np.random.default_rng(seed).random((2, 5, 7), np.float32)
    content: dict[str, Any] = {"factors": (FACTORS, values)}
    if kind == "data":
        content = {"data": np.moveaxis(np.concatenate([values, values[:1]]), 0, 2)}
    return SpectralImage(
        NM,
        50.0,
        4.0,
        header={"seed": seed},
        within=(NM[:, None] + [[-5.0, 5.0]], np.full((3, 2), 0.5)),
        **content,
    )


@pytest.mark.parametrize("kind", ["factors", "data"])
def test_stored_image_is_the_same(kind: str, tmp_path: Path) -> None:
    image, file = picture(kind), PictureFile(tmp_path)
    file.stored(picture(kind, seed=1))
    held = file.stored(image)
    for one in (held, copy.deepcopy(held), pickle.loads(pickle.dumps(held)), held.in_memory()):
        assert (one.shape, one.header, one.pitch_um) == (image.shape, image.header, image.pitch_um)
        np.testing.assert_array_equal(one.data, image.data)
        np.testing.assert_array_equal(one.planes, image.planes)
        np.testing.assert_array_equal(
            one.weighted(np.array([1.0, 0.0, 2.0])), image.weighted(np.array([1.0, 0.0, 2.0]))
        )
        np.testing.assert_array_equal(one.within[0], image.within[0])
        np.testing.assert_array_equal(one.with_planes(one.planes).band(1), image.band(1))
    assert not isinstance(copy.copy(held), StoredImage), "a copy may outlive the process"
    assert list(tmp_path.iterdir()) == [], "the file has no name"


def test_picture_file_holds_equal_pictures_once(tmp_path: Path) -> None:
    """Light of twice the brightness has the same pictures and another spectrum."""
    file, one = PictureFile(tmp_path), picture("factors")
    twice = SpectralImage(NM, 50.0, 4.0, factors=(2 * FACTORS, one.planes))
    held = [file.stored(one), file.stored(twice), file.stored(picture("factors", seed=1))]
    assert file._file is not None
    assert file._file.seek(0, 2) == 2 * one.planes.nbytes
    np.testing.assert_array_equal(held[1].data, 2 * one.data)


def test_stored_image_is_mapped_only_in_use(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    mapped: list[weakref.ref[Any]] = []
    memmap = np.memmap

    def counted(*arguments: Any) -> Any:
        made = memmap(*arguments)
        mapped.append(weakref.ref(made))
        return made

    monkeypatch.setattr(stored.np, "memmap", counted)
    held = PictureFile(tmp_path).stored(picture("factors"))
    planes = held.planes
    assert [each() is not None for each in mapped] == [False] * (len(mapped) - 1) + [True]
    del planes
    assert all(each() is None for each in mapped)


def test_picture_file_full_disk_raises(tmp_path: Path) -> None:
    """The limit of a file's size stands for the disk's; in a process of its own, since it is the
    process' limit.
    """
    code = (
        "import resource, signal, sys, numpy as np, pixsim; from pathlib import Path; from"
        " pixsim.light.stored import PictureFile\nsignal.signal(signal.SIGXFSZ, signal.SIG_IGN);"
        " resource.setrlimit(resource.RLIMIT_FSIZE, (1000, 1000))\nimage ="
        " pixsim.SpectralImage([550.0], 10.0, 5.0, data=np.ones((32, 32, 1)))\ntry:"
        " PictureFile(Path(sys.argv[1])).stored(image)\nexcept pixsim.PixsimError as error:"
        " print(error)"
    )
    ended = subprocess.run(
        [sys.executable, "-B", "-c", code, tmp_path], capture_output=True, text=True, check=False
    )
    assert "cannot be written (File too large)" in ended.stdout
    assert ended.stderr == ""
    assert "pictures of all lights" in ended.stdout
