"""Data sheets of small sensors, of which a comparison takes 0.2 s."""

from pathlib import Path


def sheet(
    path: Path,
    read_noise_e: float = 3.0,
    pitch_um: float = 20.0,
    pixels: str = "[64, 64]",
    more: str = "",
    prnu: float = 0.01,
) -> Path:
    """Write a data sheet.

    more : lines of [camera], or tables after them
    """
    path.write_text(
        f"[camera]\npixels = {pixels}\n{more}[pixel]\npitch_um = {pitch_um}\nfull_well_e ="
        f" 10000\nread_noise_e = {read_noise_e}\ndark_current_e_per_s = 5\nquantum_efficiency ="
        f" 0.6\nprnu = {prnu}\nbits = 12\nblack_level_dn = 100\n",
        encoding="utf-8",
    )
    return path


def two_sheets(folder: Path) -> list[Path]:
    """Write the sheets of a quiet and a noisy sensor, of other pixels and another shape."""
    quiet = sheet(folder / "quiet.toml", prnu=0.0)
    return [quiet, sheet(folder / "noisy one.toml", 100.0, 15.0, "[64, 48]", prnu=0.0)]
