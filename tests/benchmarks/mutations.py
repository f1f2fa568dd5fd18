"""Does the suite notice wrong arithmetic? `python tests/benchmarks/mutations.py --count 60 --seed 62`

Draws lines with arithmetic from light/, optics/, sensor/ and viewer/, changes one thing on each in a
copy of the checkout (a sign, a factor 2, an off-by-one, a swapped axis), and runs the tests that
reach the line until one fails. Prints each mutation with the test that caught it, or SURVIVED.

Which tests reach a line stands in a coverage file with contexts, if there is one:

    COVERAGE_FILE=reach.coverage python -m coverage run --rcfile=tests/benchmarks/coverage.ini -m pytest
    COVERAGE_FILE=reach.coverage python -m coverage combine
    python tests/benchmarks/mutations.py --reach reach.coverage

Without it `--tests FOLDER…` says which tests run. Mutations that change no result beyond rounding
stand in SAME_RESULT with the reason, and are drawn again.
"""

from __future__ import annotations

import argparse
import ast
import os
import random
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
ROOMS = ["light", "optics", "sensor", "viewer"]
TIMEOUT_S = 900.0
SWAPPED = {
    ast.Add: (b"+", b"-"),
    ast.Sub: (b"-", b"+"),
    ast.Mult: (b"*", b"/"),
    ast.Div: (b"/", b"*"),
}
Reach = dict[tuple[str, int], set[str]]  # tests by file and line
# (file, code before, code after): why no result changes beyond rounding
SAME_RESULT: dict[tuple[str, str, str], str] = {
    ("pixsim/sensor/pixel.py", "_WELL_ROUNDS", "(_WELL_ROUNDS) + 1"): (
        "a fourth round changes a full well by 4e-10"
    ),
    ("pixsim/sensor/diffusion.py", "1e-6 * pitch_um", "(2 * (1e-6 * pitch_um))"): (
        "a width of 2e-6 of a pixel collects as a point does"
    ),
    (
        "pixsim/viewer/develop.py",
        "np.moveaxis(colour_matching(nodes_nm), 2, 0) * light",
        "(2 * (np.moveaxis(colour_matching(nodes_nm), 2, 0) * light))",
    ): "the observer's numbers are relative to white",
    ("pixsim/optics/stack.py", "end - start", "(2 * (end - start))"): (
        "shares are ratios of two such moments"
    ),
    **{
        ("pixsim/sensor/integration.py", before, after): "how far a progress bar has come"
        for before, after in (
            ("number + _BLUR_WORK", "number - _BLUR_WORK"),
            ("number + _BLUR_WORK", "(2 * (number + _BLUR_WORK))"),
            ("(number + _BLUR_WORK) / count", "(number + _BLUR_WORK) * count"),
            ("(number + _BLUR_WORK) / count", "(2 * ((number + _BLUR_WORK) / count))"),
            ("number / count", "number * count"),
            ("number / count", "(2 * (number / count))"),
            ("number + 1", "number - 1"),
            ("number + 1", "(2 * (number + 1))"),
            ("(number + 1) / count", "(number + 1) * count"),
            ("(number + 1) / count", "(2 * ((number + 1) / count))"),
        )
    },
    (
        "pixsim/sensor/photodiode.py",
        "LINEAR_WITHIN * full_well_e",
        "(2 * (LINEAR_WITHIN * full_well_e))",
    ): "the conversion is linear to 1e-12 of the well below 2e-6 of it, too",
    (
        "pixsim/sensor/photodiode.py",
        "_LINEAR_SHARE * min(limit_e, full_well_e)",
        "_LINEAR_SHARE / min(limit_e, full_well_e)",
    ): "a table that begins farther below, where the level is the charge, right to 1e-6 as well",
    (
        "pixsim/sensor/photodiode.py",
        "second - second_line",
        "(2 * (second - second_line))",
    ): "a table with more entries, right to 1e-6 of the well as well",
    (
        "pixsim/viewer/raw_metrics.py",
        "charge_e + FARTHEST_SIGMAS * np.sqrt(charge_e2)",
        "charge_e - FARTHEST_SIGMAS * np.sqrt(charge_e2)",
    ): "tables of the upper end go on until pixels are full for sure",
    ("pixsim/viewer/raw_metrics.py", "half + 1", "(2 * (half + 1))"): (
        "a table with more signals beyond the end, off by less than its 3e-3 of the slope's change"
    ),
    ("pixsim/viewer/raw_metrics.py", "full_e + width_e", "(2 * (full_e + width_e))"): (
        "whether the last slope of a table, beyond 64 wells, is 0 or nearly"
    ),
    (
        "pixsim/viewer/causes.py",
        "white_e * (1 + modulation)",
        "(2 * (white_e * (1 + modulation)))",
    ): "light that no pixel loses has lost no lightness either",
    (
        "pixsim/viewer/shown_metrics.py",
        "noise - noise.mean(dtype=float)",
        "noise + noise.mean(dtype=float)",
    ): "the eye's filter passes no mean",
    (
        "pixsim/viewer/shown_metrics.py",
        "noise - noise.mean(dtype=float)",
        "(2 * (noise - noise.mean(dtype=float)))",
    ): "a ratio of two such spectra",
    (
        "pixsim/viewer/mtf.py",
        "np.array(light.weight) / np.sum(light.weight)",
        "(2 * (np.array(light.weight) / np.sum(light.weight)))",
    ): "a ratio of two sums with the same weights",
    ("pixsim/viewer/raw_metrics.py", "first - 1", "first + 1"): (
        "a table that begins 2 of 4096 signals later, where 6 deviations all but fit"
    ),
    ("pixsim/viewer/raw_metrics.py", "1 + _NODES", "1 - _NODES"): (
        "nodes lie symmetrically in their panel"
    ),
    (
        "pixsim/viewer/raw_metrics.py",
        "_MIN_DEVIATION / readout.dn_per_e",
        "(2 * (_MIN_DEVIATION / readout.dn_per_e))",
    ): "any small number in place of a deviation of 0",
    (
        "pixsim/viewer/raw_metrics.py",
        "_WEIGHTS * np.exp(-((FARTHEST_SIGMAS * _NODES) ** 2) / 2)",
        "(2 * (_WEIGHTS * np.exp(-((FARTHEST_SIGMAS * _NODES) ** 2) / 2)))",
    ): "weights are relative to their sum",
    ("pixsim/viewer/demosaic.py", "len(line)", "(len(line)) + 1"): (
        "a distance at which a line repeats, where a pixel lacks the channel"
    ),
    ("pixsim/viewer/raw_metrics.py", "1e3 / path_um", "(2 * (1e3 / path_um))"): (
        "the MTF is a half before its first zero, in a table half as fine"
    ),
    (
        "pixsim/viewer/raw_metrics.py",
        "exposure.charge_e2(0.0) + exposure.read_e2",
        "(2 * (exposure.charge_e2(0.0) + exposure.read_e2))",
    ): "a table that ends farther up",
    (
        "pixsim/viewer/raw_metrics.py",
        "FARTHEST_SIGMAS * math.sqrt(exposure.charge_e2(0.0) + exposure.read_e2)",
        "(2 * (FARTHEST_SIGMAS * math.sqrt(exposure.charge_e2(0.0) + exposure.read_e2)))",
    ): "a table that ends farther up",
    (
        "pixsim/viewer/raw_metrics.py",
        "FARTHEST_SIGMAS * math.sqrt(exposure.charge_e2(0.0) + exposure.read_e2)",
        "FARTHEST_SIGMAS / math.sqrt(exposure.charge_e2(0.0) + exposure.read_e2)",
    ): "a first guess, which is doubled until noise no longer reaches code 0",
    ("pixsim/viewer/chain.py", "whites / whites.max()", "whites * whites.max()"): (
        "flat frames are as bright as stated in their brightest pixel"
    ),
    ("pixsim/viewer/chain.py", "whites / whites.max()", "(2 * (whites / whites.max()))"): (
        "flat frames are as bright as stated in their brightest pixel"
    ),
    (
        "pixsim/viewer/raw_metrics.py",
        "_MIN_DEVIATION / readout.dn_per_e",
        "_MIN_DEVIATION * readout.dn_per_e",
    ): "any small number in place of a deviation of 0",
    ("pixsim/viewer/raw_metrics.py", "half + 1", "half - 1"): (
        "a table with two signals fewer of 1025"
    ),
    (
        "pixsim/viewer/raw_metrics.py",
        "spread_e[0] * steps",
        "(2 * (spread_e[0] * steps))",
    ): "before the first signal of a table the mean of codes is straight",
    (
        "pixsim/viewer/raw_metrics.py",
        "spread_e[-1] * steps[::-1]",
        "(2 * (spread_e[-1] * steps[::-1]))",
    ): "behind the last signal of a table the mean of codes is straight",
    (
        "pixsim/viewer/raw_metrics.py",
        "signal_e[-1] - spread_e[-1] * steps[::-1]",
        "(2 * (signal_e[-1] - spread_e[-1] * steps[::-1]))",
    ): "behind the last signal of a table the mean of codes is straight",
    ("pixsim/light/tables.py", "len(lines) + 1", "(2 * (len(lines) + 1))"): (
        "a place behind the last line, where no comment stands"
    ),
    (
        "pixsim/light/tables.py",
        "_comment_titles(cells, width) + title_rows",
        "(2 * (_comment_titles(cells, width) + title_rows))",
    ): "titles that are read twice say the same",
    (
        "pixsim/optics/stack.py",
        "middle_slope * before",
        "(2 * (middle_slope * before))",
    ): "whether a product is above 0",
    (
        "pixsim/optics/lens.py",
        "1e-2 * self.entrance_pupil_diameter_mm",
        "(2 * (1e-2 * self.entrance_pupil_diameter_mm))",
    ): "rays are aimed from another first guess at the same points",
    (
        "pixsim/optics/lens.py",
        "slope_y * stop_y",
        "(2 * (slope_y * stop_y))",
    ): "rays are aimed from another first guess at the same points",
    (
        "pixsim/optics/lens.py",
        "1e-3 * _AIM_TOLERANCE * self.stop_semi_diameter_mm",
        "(2 * (1e-3 * _AIM_TOLERANCE * self.stop_semi_diameter_mm))",
    ): "a secant ends at 1e-12 of the stop, or a step later",
    (
        "pixsim/optics/lens.py",
        "1e-3 * _AIM_TOLERANCE * self.stop_semi_diameter_mm",
        "1e-3 * _AIM_TOLERANCE / self.stop_semi_diameter_mm",
    ): "a secant ends at 1e-12 of the stop, or a step later",
    (
        "pixsim/optics/lens.py",
        "1e-3 * _AIM_TOLERANCE",
        "(2 * (1e-3 * _AIM_TOLERANCE))",
    ): "a secant ends at 1e-12 of the stop, or a step later",
    (
        "pixsim/optics/lens.py",
        "_AIM_TOLERANCE * self.stop_semi_diameter_mm",
        "(2 * (_AIM_TOLERANCE * self.stop_semi_diameter_mm))",
    ): "a secant has ended far within the tolerance, or far from it",
    (
        "pixsim/optics/lens.py",
        "_AIM_TOLERANCE * self.stop_semi_diameter_mm",
        "_AIM_TOLERANCE / self.stop_semi_diameter_mm",
    ): "a secant has ended far within the tolerance, or far from it",
    (
        "pixsim/optics/lens.py",
        "first + batch_size",
        "(2 * (first + batch_size))",
    ): "some of the polynomials are fitted twice",
    (
        "pixsim/optics/lens.py",
        "first + batch_size",
        "(first + batch_size) + 1",
    ): "some of the polynomials are fitted twice",
    (
        "pixsim/optics/lens.py",
        "-2",
        "(-(-2))",
    ): "of four axes, or of four steps, the last but one is the third",
    (
        "pixsim/optics/lens.py",
        "x_mm / stop_mm - stop_x",
        "(2 * (x_mm / stop_mm - stop_x))",
    ): "twice a miss is 0 where the miss is",
    (
        "pixsim/optics/lens.py",
        "y_mm / stop_mm - stop_y",
        "(2 * (y_mm / stop_mm - stop_y))",
    ): "twice a miss is 0 where the miss is",
    (
        "pixsim/optics/lens.py",
        "start_mm + 1e-3 * self.entrance_pupil_diameter_mm",
        "(2 * (start_mm + 1e-3 * self.entrance_pupil_diameter_mm))",
    ): "a secant through another second point leads to the same ray",
    (
        "pixsim/optics/lens.py",
        "start_mm + 1e-3 * self.entrance_pupil_diameter_mm",
        "start_mm - 1e-3 * self.entrance_pupil_diameter_mm",
    ): "a secant through another second point leads to the same ray",
    (
        "pixsim/optics/lens.py",
        "stop_x_mm / stop_mm",
        "stop_x_mm * stop_mm",
    ): "rays that met their points are aimed at them again",
    (
        "pixsim/optics/lens.py",
        "stop_x_mm / stop_mm - stop_x",
        "(2 * (stop_x_mm / stop_mm - stop_x))",
    ): "rays that met their points are aimed at them again",
    (
        "pixsim/optics/lens.py",
        "stop_y_mm / stop_mm",
        "stop_y_mm * stop_mm",
    ): "rays that met their points are aimed at them again",
    (
        "pixsim/optics/lens.py",
        "stop_y_mm / stop_mm - stop_y",
        "(2 * (stop_y_mm / stop_mm - stop_y))",
    ): "rays that met their points are aimed at them again",
    (
        "pixsim/optics/lens.py",
        "_MIDDLE_STEPS + 1",
        "(_MIDDLE_STEPS + 1) + 1",
    ): "a search for slivers below 1e-4 of a pupil, with 1e-6 of its light",
    (
        "pixsim/optics/lens.py",
        "_MIDDLE_STEPS + 1",
        "(2 * (_MIDDLE_STEPS + 1))",
    ): "a search for slivers below 1e-4 of a pupil, with 1e-6 of its light",
    (
        "pixsim/optics/stack.py",
        "next_angle - angle",
        "(2 * (next_angle - angle))",
    ): "one more step of a search that has converged",
    (
        "pixsim/optics/stack.py",
        "NEWTON_STEPS if angle.size else 0",
        "(NEWTON_STEPS if angle.size else 0) + 1",
    ): "one more step of a search that has converged long before",
    (
        "pixsim/optics/stack.py",
        "2 * math.pi * widest * stack.pitch_um / (1e-3 * wavelength_nm)",
        "(2 * (2 * math.pi * widest * stack.pitch_um / (1e-3 * wavelength_nm)))",
    ): "more rays than a spot needs",
    (
        "pixsim/optics/ray_trace.py",
        "NEWTON_STEPS",
        "(NEWTON_STEPS) + 1",
    ): "one more step of a search that has converged long before",
    (
        "pixsim/optics/glass.py",
        "_AGF_NUMBERS",
        "(_AGF_NUMBERS) + 1",
    ): "no formula has an eleventh number",
    (
        "pixsim/light/tables.py",
        "-_MAX_TITLES",
        "(-_MAX_TITLES) + 1",
    ): "how many rows of titles are looked at",
    (
        "pixsim/light/tables.py",
        "len(lines) + 1",
        "len(lines) - 1",
    ): "titles above no numbers, which are refused",
    (
        "pixsim/optics/lens.py",
        "slope_x * stop_x",
        "slope_x / stop_x",
    ): "rays are aimed from another first guess at the same points",
    (
        "pixsim/optics/lens.py",
        "slope_y * stop_y",
        "slope_y / stop_y",
    ): "rays are aimed from another first guess at the same points",
    (
        "pixsim/optics/lens.py",
        "tolerance / 10",
        "(2 * (tolerance / 10))",
    ): "an aim ends at a fifth of the tolerance in place of a tenth",
    (
        "pixsim/optics/lens.py",
        "both - basis @ np.linalg.lstsq(basis, both, rcond=None)[0]",
        "(2 * (both - basis @ np.linalg.lstsq(basis, both, rcond=None)[0]))",
    ): "a ratio of two mean squares",
    (
        "pixsim/optics/lens.py",
        "1e-3 * self.entrance_pupil_diameter_mm",
        "1e-3 / self.entrance_pupil_diameter_mm",
    ): "a secant through another second point leads to the same ray",
    (
        "pixsim/optics/prescription.py",
        "position + 1 - len(line.words)",
        "(2 * (position + 1 - len(line.words)))",
    ): "zeros behind the end of a list are what it has there",
    (
        "pixsim/optics/stack.py",
        "first + POINTS",
        "(2 * (first + POINTS))",
    ): "some points are computed twice",
    (
        "pixsim/optics/stack.py",
        "first + count",
        "(2 * (first + count))",
    ): "some points are computed twice",
    (
        "pixsim/optics/stack.py",
        "3 * stack.pitch_um / spot_um + _FAR_SPOTS",
        "(2 * (3 * stack.pitch_um / spot_um + _FAR_SPOTS))",
    ): "a spot so far away, of which photodiodes collect 1e-7",
    (
        "pixsim/optics/lens.py",
        "fields.size * x.size * len(self.prescription.surfaces)",
        "(2 * (fields.size * x.size * len(self.prescription.surfaces)))",
    ): "how many threads trace",
    (
        "pixsim/optics/lens.py",
        "fields.size * x.size * len(self.prescription.surfaces)",
        "fields.size * x.size / len(self.prescription.surfaces)",
    ): "how many threads trace",
    (
        "pixsim/optics/lens.py",
        "fields.size * x.size",
        "(2 * (fields.size * x.size))",
    ): "how many threads trace",
    (
        "pixsim/optics/lens.py",
        "fields.size * x.size",
        "fields.size / x.size",
    ): "how many threads trace",
    (
        "pixsim/optics/lens.py",
        "-cosine_x",
        "(-(-cosine_x))",
    ): "left and right of the field's plane are alike",
    (
        "pixsim/optics/ray_trace.py",
        "_CONVERGED * (1 + np.abs(x_at) + np.abs(y_at))",
        "(2 * (_CONVERGED * (1 + np.abs(x_at) + np.abs(y_at))))",
    ): "what a last step of 2e-8 or 4e-8 leaves is its square",
    (
        "pixsim/optics/ray_trace.py",
        "_CONVERGED * (1 + np.abs(x_at) + np.abs(y_at))",
        "_CONVERGED / (1 + np.abs(x_at) + np.abs(y_at))",
    ): "what a last step of 2e-8 or 4e-8 leaves is its square",
    (
        "pixsim/optics/ray_trace.py",
        "1 + np.abs(x_at) + np.abs(y_at)",
        "(2 * (1 + np.abs(x_at) + np.abs(y_at)))",
    ): "what a last step of 2e-8 or 4e-8 leaves is its square",
    (
        "pixsim/optics/ray_trace.py",
        "1 + np.abs(x_at)",
        "(2 * (1 + np.abs(x_at)))",
    ): "what a last step of 2e-8 or 4e-8 leaves is its square",
    (
        "pixsim/optics/prescription.py",
        "cx - cy",
        "(2 * (cx - cy))",
    ): "compressions that are equal to 1e-9, or to half of it",
    (
        "pixsim/optics/stack.py",
        "(high - low) * _TABLE_STEPS",
        "(2 * ((high - low) * _TABLE_STEPS))",
    ): "from how many rays on a table takes the place of integrals",
    (
        "pixsim/optics/stack.py",
        "(high - low) * _TABLE_STEPS",
        "(high - low) / _TABLE_STEPS",
    ): "from how many rays on a table takes the place of integrals",
    (
        "pixsim/optics/stack.py",
        "before * after",
        "(2 * (before * after))",
    ): "whether a product is below 0",
    (
        "pixsim/optics/lens.py",
        "share / 2",
        "(2 * (share / 2))",
    ): "a ratio of two sums with the same weights",
    (
        "pixsim/optics/lens.py",
        "share / 2",
        "share * 2",
    ): "a ratio of two sums with the same weights",
    (
        "pixsim/optics/lens.py",
        "stop_x_mm / stop_mm - stop_x",
        "stop_x_mm / stop_mm + stop_x",
    ): "rays that met their points are aimed at them again",
    (
        "pixsim/optics/lens.py",
        "stop_y_mm / stop_mm - stop_y",
        "stop_y_mm / stop_mm + stop_y",
    ): "rays that met their points are aimed at them again",
    (
        "pixsim/optics/stack.py",
        "int((high - low) * _TABLE_STEPS) + 2",
        "(2 * (int((high - low) * _TABLE_STEPS) + 2))",
    ): "a longer table",
    (
        "pixsim/optics/stack.py",
        "(end - start) * ((end + start) / 2 if power else 1.0)",
        "(2 * ((end - start) * ((end + start) / 2 if power else 1.0)))",
    ): "shares are ratios of two such moments",
    (
        "pixsim/optics/lens.py",
        "np.pi / 2 * (np.arange(_RINGS) + 1) / _RINGS",
        "(2 * (np.pi / 2 * (np.arange(_RINGS) + 1) / _RINGS))",
    ): "rays are aimed from a fit to other points",
    (
        "pixsim/optics/lens.py",
        "np.arange(_SPOKES) / (_SPOKES - 1) - 0.5",
        "np.arange(_SPOKES) / (_SPOKES - 1) + 0.5",
    ): "points of the other half of the stop, which is alike",
    ("pixsim/light/exr.py", "end", "(end) + 1"): "a name that ends in a zero byte is text as well",
    (
        "pixsim/optics/glass.py",
        "0 * square",
        "(2 * (0 * square))",
    ): "zeros in the shape of the wavelengths",
    ("pixsim/optics/glass.py", "0 * square", "0 / square"): "zeros in the shape of the wavelengths",
    ("pixsim/viewer/mtf.py", "0", "{0: 1, 1: 0, -1: -2, -2: -1, 2: 1}[0]"): (
        "pixels above and below collect what pixels on both sides do"
    ),
    (
        "pixsim/optics/camera_lens.py",
        "math.hypot(camera.die_mm, camera.height_mm) / 2",
        "math.hypot(camera.die_mm, camera.height_mm) * 2",
    ): "the illumination of a die, which limits the height too, ends at its corner",
    **{
        (
            "pixsim/optics/camera_lens.py",
            before,
            after,
        ): "where a table that is 0 ends, beyond the die"
        for before, after in (
            ("circle_mm + 2 * step_mm", "circle_mm - 2 * step_mm"),
            ("2 * step_mm", "(2 * (2 * step_mm))"),
        )
    },
    **{
        (
            "pixsim/optics/camera_lens.py",
            before,
            after,
        ): "for how many tiles beyond the die there are PSFs, each computed if it is needed"
        for before, after in (
            (
                "tiling.psf_um + _SPARE_TILES * tiling.spacing_um",
                "tiling.psf_um - _SPARE_TILES * tiling.spacing_um",
            ),
            (
                "tiling.psf_um + _SPARE_TILES * tiling.spacing_um",
                "(2 * (tiling.psf_um + _SPARE_TILES * tiling.spacing_um))",
            ),
            ("_SPARE_TILES * tiling.spacing_um", "(2 * (_SPARE_TILES * tiling.spacing_um))"),
            ("_SPARE_TILES * tiling.spacing_um", "_SPARE_TILES / tiling.spacing_um"),
            ("side_um / 2 + margin_um", "(2 * (side_um / 2 + margin_um))"),
            ("side_um / 2", "side_um * 2"),
            ("side_um / 2", "(2 * (side_um / 2))"),
        )
    },
    **{
        (
            "pixsim/optics/camera_lens.py",
            before,
            after,
        ): "Gauss's nodes do not depend on the scale and the zero of the wavelengths"
        for before, after in (
            ("(nm[-1] + nm[0]) / 2", "(nm[-1] + nm[0]) * 2"),
            ("(nm[-1] + nm[0]) / 2", "(2 * ((nm[-1] + nm[0]) / 2))"),
            ("nm[-1] + nm[0]", "nm[-1] - nm[0]"),
            ("nm[-1] + nm[0]", "(2 * (nm[-1] + nm[0]))"),
            ("(nm[-1] - nm[0]) / 2", "(nm[-1] - nm[0]) * 2"),
            ("(nm[-1] - nm[0]) / 2", "(2 * ((nm[-1] - nm[0]) / 2))"),
            ("nm[-1] - nm[0]", "nm[-1] + nm[0]"),
            ("nm[-1] - nm[0]", "(2 * (nm[-1] - nm[0]))"),
        )
    },
    **{
        (
            "pixsim/optics/camera_lens.py",
            before,
            after,
        ): "one more step towards the focal length that it has"
        for before, after in (
            ("_VIEW_STEPS if same_view else 1", "(_VIEW_STEPS if same_view else 1) + 1"),
        )
    },
    ("pixsim/optics/camera_lens.py", "_CIRCLE_STEPS", "(_CIRCLE_STEPS) + 1"): (
        "one more attempt at a smaller circle, where the last one has succeeded long before"
    ),
    ("pixsim/optics/field_blur.py", "across + x", "across - x"): (
        "tiles left and right of the axis have one tail: a lens is round"
    ),
    ("pixsim/sensor/motion.py", "3", "(3) + 1"): (
        "from the nearer end of a spline only three knots are passed"
    ),
    ("pixsim/sensor/motion.py", "count - 1", "count + 1"): (
        "tables of more fine steps have the same products"
    ),
    (
        "pixsim/viewer/metric_kernels/visible_noise.py",
        "count - 1",
        "(2 * (count - 1))",
    ): "both colour channels have a filter already",
    (
        "pixsim/viewer/denoising/anscombe.py",
        "last + 1.0",
        "last - 1.0",
    ): "numbers of electrons beyond 9 deviations have 1e-17 of the whole",
    (
        "pixsim/viewer/demosaic.py",
        "products * taps[0]",
        "products / taps[0]",
    ): "filters of one tap have the weight 1",
    (
        "pixsim/viewer/demosaic.py",
        "2 * _SPLINE_RANGE_PX",
        "(2 * (2 * _SPLINE_RANGE_PX))",
    ): "a spline forgets its ends to 1e-9 within the range",
    (
        "pixsim/viewer/demosaic.py",
        "difference - np.roll(difference, -2, axis)",
        "(2 * (difference - np.roll(difference, -2, axis)))",
    ): "changes along both axes are compared with one another",
    ("pixsim/viewer/demosaic.py", "size + range_px", "(2 * (size + range_px))"): (
        "lags at which pixels have no dot together"
    ),
    ("pixsim/viewer/demosaic.py", "count + half_width", "(2 * (count + half_width))"): (
        "products of pixels farther apart than those that are asked for"
    ),
    (
        "pixsim/viewer/demosaic.py",
        "has_channel * np.multiply.outer(_tent(rows), _tent(columns))",
        "(2 * (has_channel * np.multiply.outer(_tent(rows), _tent(columns))))",
    ): "weights are relative to their sum",
    (
        "pixsim/viewer/dark_clip.py",
        "ordinary_e * dark.hot_median * np.exp(dark.hot_spread * ndtri(quantiles))",
        "ordinary_e * dark.hot_median / np.exp(dark.hot_spread * ndtri(quantiles))",
    ): "the logarithms of hot pixels lie symmetrically about their median",
    ("pixsim/viewer/demosaic.py", "mosaic - green", "(2 * (mosaic - green))"): (
        "changes along both axes are compared with one another"
    ),
    (
        "pixsim/viewer/demosaic.py",
        "(size + range_px) // period + 1",
        "(2 * ((size + range_px) // period + 1))",
    ): "lags at which pixels have no dot together",
    (
        "pixsim/viewer/demosaic.py",
        "int(np.ceil(dot_px)) + 2 * _SPLINE_RANGE_PX",
        "(2 * (int(np.ceil(dot_px)) + 2 * _SPLINE_RANGE_PX))",
    ): "products of pixels farther apart than a dot reaches",
    (
        "pixsim/viewer/demosaic.py",
        "size + range_px + period * last",
        "(2 * (size + range_px + period * last))",
    ): "products of pixels farther apart than any two of a dot",
    (
        "pixsim/viewer/demosaic.py",
        "period * last",
        "(2 * (period * last))",
    ): "products of pixels farther apart than any two of a dot",
    (
        "pixsim/viewer/demosaic.py",
        "range_px + 1",
        "(2 * (range_px + 1))",
    ): "products of pixels farther apart than a dot reaches",
    (
        "pixsim/viewer/demosaic.py",
        "2 * (margin_px + count) + int(np.ceil(dot_px)) + 1",
        "(2 * (2 * (margin_px + count) + int(np.ceil(dot_px)) + 1))",
    ): "more pixels behind a dot",
    (
        "pixsim/viewer/demosaic.py",
        "2 * (margin_px + count) + int(np.ceil(dot_px))",
        "(2 * (2 * (margin_px + count) + int(np.ceil(dot_px))))",
    ): "more pixels behind a dot",
    (
        "pixsim/viewer/demosaic.py",
        "2 * (margin_px + count)",
        "(2 * (2 * (margin_px + count)))",
    ): "more pixels behind a dot",
    (
        "pixsim/viewer/demosaic.py",
        "low + high + node * (high - low)",
        "low + high - node * (high - low)",
    ): "nodes lie symmetrically between two positions",
    (
        "pixsim/viewer/demosaic.py",
        "1 - np.abs(np.arange(1 - size, size)) / size",
        "(2 * (1 - np.abs(np.arange(1 - size, size)) / size))",
    ): "weights are relative to their sum",
    (
        "pixsim/viewer/raw_metrics.py",
        "width_e * np.linspace(0.0, 1.0, half + 1) ** 2",
        "(2 * (width_e * np.linspace(0.0, 1.0, half + 1) ** 2))",
    ): "a table that ends farther up, where all pixels are full",
    ("pixsim/viewer/demosaic.py", "range_px + 1", "range_px - 1"): (
        "the ends of a filter's products, 1e-7 of their middle"
    ),
    (
        "pixsim/viewer/raw_metrics.py",
        "FARTHEST_SIGMAS * read_e",
        "(2 * (FARTHEST_SIGMAS * read_e))",
    ): "panels that end farther from the top code, right to 1e-6 as well",
    (
        "pixsim/viewer/raw_metrics.py",
        "FARTHEST_SIGMAS * np.sqrt(charge_e2)",
        "(2 * (FARTHEST_SIGMAS * np.sqrt(charge_e2)))",
    ): "the moments far below a well are those without one",
    ("pixsim/viewer/demosaic.py", "middle + lags", "middle - lags"): (
        "pixels are correlated with those on one side as with those on the other"
    ),
    (
        "pixsim/viewer/demosaic.py",
        "column - offset + kx // 2",
        "column - offset - kx // 2",
    ): "a sum over the columns of a cell that begins at another one",
    (
        "pixsim/viewer/demosaic.py",
        "2 * (margin_px + count) + int(np.ceil(dot_px)) + 1",
        "2 * (margin_px + count) + int(np.ceil(dot_px)) - 1",
    ): "two pixels fewer of those behind a dot",
    (
        "pixsim/viewer/demosaic.py",
        "size + range_px + period * last + 1",
        "(2 * (size + range_px + period * last + 1))",
    ): "products of pixels farther apart than any two of a dot",
    (
        "pixsim/viewer/denoising/anscombe.py",
        "_GAUSSIAN_STEPS + 1.0",
        "(2 * (_GAUSSIAN_STEPS + 1.0))",
    ): "beyond the last step the normal law has 1e-17 of the whole",
    (
        "pixsim/sensor/collection.py",
        "stated - transmitted",
        "(2 * (stated - transmitted))",
    ): "the largest of numbers is where the largest of twice these is",
    **{
        ("pixsim/viewer/raw_metrics.py", f"{moment} / total", f"{moment} * total"): (
            "weights of charges add up to 1 within 2e-9"
        )
        for moment in (
            "(integral(mean) + full * full_mean)",
            "(integral(variance + mean**2) + full * full_square)",
            "(integral(slope) + full * full_slope)",
            "(below + full_wells)",
        )
    },
    **{
        ("pixsim/sensor/pixel.py", before, after): "the curve is scaled to its peak"
        for before, after in (
            ("table_nm * 1e-9", "table_nm / 1e-9"),
            ("table_nm * 1e-9", "(2 * (table_nm * 1e-9))"),
            ("PLANCK_J_S * LIGHT_SPEED_M_PER_S", "PLANCK_J_S / LIGHT_SPEED_M_PER_S"),
            ("PLANCK_J_S * LIGHT_SPEED_M_PER_S", "(2 * (PLANCK_J_S * LIGHT_SPEED_M_PER_S))"),
        )
    },
    (
        "pixsim/sensor/pixel.py",
        "E_PER_FC * self.capacitance_ff(self.reset_voltage_v)",
        "E_PER_FC / self.capacitance_ff(self.reset_voltage_v)",
    ): "Newton's method from another start ends in the same root",
    ("pixsim/sensor/saturation.py", "above - below", "(2 * (above - below))"): (
        "a function and twice the function have one root"
    ),
    ("pixsim/sensor/saturation.py", "above - below", "above + below"): (
        "the search for the highest peak finds the same well, in fifteen times the time"
    ),
    ("pixsim/viewer/raw_metrics.py", "full_e - start_e", "(2 * (full_e - start_e))"): (
        "a wider table as well"
    ),
    ("pixsim/optics/camera_lens.py", "magnification - 1", "(2 * (magnification - 1))"): (
        "the largest of numbers is where the largest of twice these is"
    ),
    (
        "pixsim/optics/camera_lens.py",
        "math.hypot(width_um, height_um) / 2",
        "(2 * (math.hypot(width_um, height_um) / 2))",
    ): "the traced heights end 1e-6 beyond the corner",
    (
        "pixsim/sensor/integration.py",
        "electrons * irradiance.mean_spectrum()",
        "(2 * (electrons * irradiance.mean_spectrum()))",
    ): "bands are weighed against each other",
    (
        "pixsim/optics/lens.py",
        "1e-3 * self.entrance_pupil_diameter_mm",
        "(2 * (1e-3 * self.entrance_pupil_diameter_mm))",
    ): "a secant through another second point leads to the same ray",
    ("pixsim/optics/thin_lens.py", "_FALL_OFF_STEPS + 1", "(2 * (_FALL_OFF_STEPS + 1))"): (
        "twice as many straight lines, off by 4e-6 instead of 1e-5"
    ),
    ("pixsim/optics/lens_waves.py", "-1", "(-(-1))"): "the last of two axes is the second",
    ("pixsim/viewer/causes.py", "1 + modulation", "(2 * (1 + modulation))"): (
        "of light below the wells at all phases nothing is lost, which is computed then"
    ),
    ("pixsim/viewer/causes.py", "charge_e - dark_e", "(2 * (charge_e - dark_e))"): (
        "PRNU moves the mean of the lightest codes far less than the light itself does"
    ),
    (
        "pixsim/sensor/photodiode.py",
        "np.array(diode.knees_v) / diode.thermal_v",
        "(2 * (np.array(diode.knees_v) / diode.thermal_v))",
    ): "a panel across the knee of a capacitance, whose slope goes on, errs by less than 1e-13",
    ("pixsim/optics/stack.py", "high - low", "(2 * (high - low))"): (
        "from how many rays on a table takes the place of integrals, and how far beyond them it goes"
    ),
    (
        "pixsim/sensor/saturation.py",
        "_CAPACITY_WITHIN * capacity_e",
        "(2 * (_CAPACITY_WITHIN * capacity_e))",
    ): "the well that is accepted is the one that a search finds",
    ("pixsim/sensor/saturation.py", "_WELL_WITHIN * capacity_e", "_WELL_WITHIN / capacity_e"): (
        "the same root in a smaller interval"
    ),
    ("pixsim/viewer/denoising/anscombe.py", "2 * near[-1]", "2 / near[-1]"): (
        "of so much noise the correction is constant before it"
    ),
    ("pixsim/viewer/denoising/anscombe.py", "2 * near[-1]", "(2 * (2 * near[-1]))"): (
        "a longer table, of which the end is not used"
    ),
    ("pixsim/optics/lens.py", "_MAX_AIM_STEPS", "(_MAX_AIM_STEPS) + 1"): (
        "one more step of a ray's aim, which has converged long before or does not"
    ),
    ("pixsim/optics/camera_lens.py", "_ORTHOGONAL_PASSES", "(_ORTHOGONAL_PASSES) + 1"): (
        "vectors that are orthogonal to rounding already"
    ),
    ("pixsim/optics/field_blur.py", "distance + shift", "distance - shift"): (
        "the four corners in reversed order, two and two with one sign"
    ),
    **{
        ("pixsim/optics/field_blur.py", f"{rise} * {sign}", f"{rise} / {sign}"): (
            "a sign is 1 or -1"
        )
        for rise, sign in (
            ("rise_x[cut]", "np.sign(gradient_x)"),
            ("rise_y[cut]", "np.sign(gradient_y)"),
        )
    },
    **{
        ("pixsim/optics/field_blur.py", before, f"(2 * ({before}))"): (
            "a wider grid, dark at its sides"
        )
        for before in (
            "np.hypot(half[1] * radial, half[0] * sagittal) * max(1.0, outline.max())",
            "half[1] * radial",
            "half[0] * sagittal",
            "extent / step + 1",
            "extent / step",
        )
    },
    (
        "pixsim/optics/field_blur.py",
        "position - np.arange(-count, count + 1)",
        "position + np.arange(-count, count + 1)",
    ): "tiles in reversed order, whose tails are those of a round lens",
    **{
        ("pixsim/optics/field_blur.py", before, f"(2 * ({before}))"): (
            "the error of a picture is relative to its power"
        )
        for before in (
            "np.sum(area_share * power, axis=0) * weight",
            "area_share * power",
            "np.sinc(fy * aperture_um) * np.sinc(fx * aperture_um)",
            "count * aperture_mtf**2",
        )
    },
    **{
        ("pixsim/optics/field_blur.py", f"{at} + {offset}", f"{at} - {offset}"): (
            "tiles around a place, of mirrored weights, in reversed order"
        )
        for at, offset in (("x_um", "x * spacing * pitch_um"), ("y_um", "y * spacing * pitch_um"))
    },
    ("pixsim/optics/field_blur.py", "cells + 1", "cells - 1"): "both are even or odd",
    ("pixsim/optics/field_blur.py", "down + y", "down - y"): (
        "tiles above and below the axis have one tail: a lens is round"
    ),
    **{
        ("pixsim/optics/field_blur.py", before, f"(2 * ({before}))"): (
            "shares of samples farther from the edge are 0 or 1 both ways"
        )
        for before in ("1.5 * step", "1.5 * step / half.min()")
    },
    **{
        ("pixsim/optics/field_blur.py", "1 - _MIRRORED_PLACES", after): (
            "how many spectra are cached"
        )
        for after in (
            "1 + _MIRRORED_PLACES",
            "(2 * (1 - _MIRRORED_PLACES))",
            "(1 - _MIRRORED_PLACES) + 1",
        )
    },
    **{
        (
            "pixsim/optics/field_blur.py",
            before,
            after,
        ): "frequencies that the lens does not pass, or that the film does not show"
        for before, after in (
            (
                "math.hypot(self.last_frequency, self.last_frequency) / self.period_um",
                "math.hypot(self.last_frequency, self.last_frequency) * self.period_um",
            ),
            (
                "math.hypot(self.last_frequency, self.last_frequency) / self.period_um",
                "(2 * (math.hypot(self.last_frequency, self.last_frequency) / self.period_um))",
            ),
            ("max_cy_per_um * side * pitch_um", "(2 * (max_cy_per_um * side * pitch_um))"),
            ("max_cy_per_um * side", "(2 * (max_cy_per_um * side))"),
        )
    },
    **{
        ("pixsim/optics/field_blur.py", before, after): "the same intensity on finer samples"
        for before, after in (
            (
                "2 * float(front_numbers[:2].max()) / front.wavelength_nm",
                "(2 * (2 * float(front_numbers[:2].max()) / front.wavelength_nm))",
            ),
            ("2 * float(front_numbers[:2].max())", "(2 * (2 * float(front_numbers[:2].max())))"),
            (
                "math.ceil(2 * size_um / UM_PER_NM * cutoff_per_nm) + 2",
                "(2 * (math.ceil(2 * size_um / UM_PER_NM * cutoff_per_nm) + 2))",
            ),
            (
                "2 * size_um / UM_PER_NM * cutoff_per_nm",
                "(2 * (2 * size_um / UM_PER_NM * cutoff_per_nm))",
            ),
            ("2 * size_um / UM_PER_NM", "(2 * (2 * size_um / UM_PER_NM))"),
            ("2 * size_um", "(2 * (2 * size_um))"),
        )
    },
    **{
        (
            "pixsim/optics/field_blur.py",
            before,
            after,
        ): "rows and columns beyond all tiles, which are cut off"
        for before, after in (
            ("n + 2 * before + self.cells - 1", "n + 2 * before + self.cells + 1"),
            ("n + 2 * before + self.cells - 1", "(2 * (n + 2 * before + self.cells - 1))"),
            ("n + 2 * before + self.cells", "(2 * (n + 2 * before + self.cells))"),
            ("n + 2 * before", "(2 * (n + 2 * before))"),
            ("2 * before", "(2 * (2 * before))"),
            ("width - first[1]", "width + first[1]"),
            ("width - first[1]", "(2 * (width - first[1]))"),
        )
    },
    **{
        (
            "pixsim/optics/field_blur.py",
            before,
            after,
        ): "how many columns of tiles are spread at once, or how far a progress bar has come"
        for before, after in (
            ("2 * height * self._spread_shape[1]", "(2 * (2 * height * self._spread_shape[1]))"),
            ("2 * height", "(2 * (2 * height))"),
            ("batch.stop / count", "batch.stop * count"),
            ("batch.stop / count", "(2 * (batch.stop / count))"),
        )
    },
    **{
        (
            "pixsim/optics/field_blur.py",
            before,
            after,
        ): "coefficients of splines that no place needs"
        for before, after in (
            (
                "math.ceil(max(row.max(), column.max())) + _SPLINE_COEFFICIENTS",
                "(2 * (math.ceil(max(row.max(), column.max())) + _SPLINE_COEFFICIENTS))",
            ),
        )
    },
    **{
        (
            "pixsim/optics/field_blur.py",
            before,
            after,
        ): "nodes of Gauss's quadrature are as far from one end as from the other"
        for before, after in (("1 + node", "1 - node"),)
    },
    **{
        ("pixsim/optics/field_blur.py", before, after): "0 is added to the real part"
        for before, after in (("otf.real + np.zeros_like(otf)", "otf.real - np.zeros_like(otf)"),)
    },
    ("pixsim/optics/field_blur.py", "fine - 1", "fine + 1"): (
        "one more frequency, which the lens does not pass"
    ),
    (
        "pixsim/optics/field_blur.py",
        "top + spread_rows",
        "(2 * (top + spread_rows))",
    ): "rows before the first one are left out in any case",
    **{
        ("pixsim/optics/camera_lens.py", "_COARSE_FILM * cell_um", after): (
            "from which film on PSFs of its own take less time"
        )
        for after in ("(2 * (_COARSE_FILM * cell_um))", "_COARSE_FILM / cell_um")
    },
    (
        "pixsim/optics/camera_lens.py",
        "math.hypot(width_um, height_um) / 2",
        "math.hypot(width_um, height_um) * 2",
    ): "the traced heights end 1e-6 beyond the corner",
    ("pixsim/optics/camera_lens.py", "-2j", "(-(-2j))"): (
        "a mirrored PSF has the same errors as the PSF"
    ),
    **{
        ("pixsim/optics/field_blur.py", before, f"(2 * ({before}))"): (
            "a combination of other terms leaves less than half of it, any other term far more"
        )
        for before in (
            "np.finfo(float).eps * columns.shape[1]",
            "np.finfo(float).eps * columns.shape[1] * sizes[row]",
        )
    },
    **{
        ("pixsim/optics/camera_lens.py", "_IMAGES + 1", after): (
            "images from the third on have less than 2e-7 of a wave"
        )
        for after in ("(2 * (_IMAGES + 1))", "_IMAGES - 1")
    },
    (
        "pixsim/optics/camera_lens.py",
        "source_frequency + images",
        "source_frequency - images",
    ): "images on both sides in reversed order",
    **{
        ("pixsim/optics/camera_lens.py", before, f"(2 * ({before}))"): (
            "weights are relative to their sum"
        )
        for before in (
            "source_frequency + images",
            "source_frequency / (source_frequency + images)",
        )
    },
    (
        "pixsim/optics/field_blur.py",
        "math.ceil(band_corner) + _SPLINE_COEFFICIENTS // 2",
        "math.ceil(band_corner) - _SPLINE_COEFFICIENTS // 2",
    ): "at the corner of a film's band its weight falls to 0 both ways: 1e-7 of a PSF's peak",
    (
        "pixsim/sensor/mismatch.py",
        "self.hot_median * np.exp(self.hot_spread * normal)",
        "self.hot_median / np.exp(self.hot_spread * normal)",
    ): "the logarithms of hot pixels are as often below their median as above it",
    (
        "pixsim/viewer/every_pixel.py",
        "channel.shares * weight",
        "(2 * (channel.shares * weight))",
    ): "light is relative to white, whose shares are the same",
    ("pixsim/sensor/correction.py", "len(layout.channels)", "(len(layout.channels)) + 1"): (
        "no pixel has a channel beyond the last"
    ),
    (
        "pixsim/viewer/raw_metrics.py",
        "_MAX_WELLS * max(limit_e, 1.0)",
        "(2 * (_MAX_WELLS * max(limit_e, 1.0)))",
    ): "where a search gives up that ends long before",
    (
        "pixsim/viewer/raw_metrics.py",
        "1e3 / frame.readout.physics.read_pitch_um",
        "(2 * (1e3 / frame.readout.physics.read_pitch_um))",
    ): "a table up to twice the frequency, off by 3e-5 instead of 6e-6 between its steps",
    (
        "pixsim/viewer/raw_metrics.py",
        "charge_e + FARTHEST_SIGMAS * np.sqrt(charge_e2)",
        "(2 * (charge_e + FARTHEST_SIGMAS * np.sqrt(charge_e2)))",
    ): "the moments behind a well that holds all charge are those without one",
    ("pixsim/optics/lens.py", "slope_x * stop_x", "(2 * (slope_x * stop_x))"): (
        "rays are aimed from another first guess at the same points"
    ),
    (
        "pixsim/optics/lens.py",
        "step_mm * self.stop_semi_diameter_mm",
        "(2 * (step_mm * self.stop_semi_diameter_mm))",
    ): "rays are aimed from another first guess at the same points",
    ("pixsim/optics/lens.py", "_RINGS * _SPOKES", "(2 * (_RINGS * _SPOKES))"): (
        "half as many rays at once"
    ),
    ("pixsim/optics/lens.py", "_OUTLINE_STEPS[0] * edge", "(2 * (_OUTLINE_STEPS[0] * edge))"): (
        "the same edge, between places farther apart"
    ),
    ("pixsim/optics/lens.py", "_ROOT_STEPS", "(_ROOT_STEPS) + 1"): (
        "one more step towards a root that is reached long before"
    ),
    ("pixsim/optics/lens.py", "height - 1", "(2 * (height - 1))"): "the same root",
    (
        "pixsim/optics/lens.py",
        "_OUTLINE_START / self.first_order(self.primary_nm).f_number",
        "(2 * (_OUTLINE_START / self.first_order(self.primary_nm).f_number))",
    ): "the same edge, predicted by another first step",
    ("pixsim/sensor/pixel.py", "zero_bias_ff * grading", "(2 * (zero_bias_ff * grading))"): (
        "whether a product is 0"
    ),
    (
        "pixsim/viewer/mtf.py",
        "response * irradiance.mean_spectrum()",
        "(2 * (response * irradiance.mean_spectrum()))",
    ): "bands are weighed against each other",
    (
        "pixsim/viewer/mtf.py",
        "np.arange(shares.size) - shares.size // 2",
        "np.arange(shares.size) + shares.size // 2",
    ): "the modulus does not depend on where the middle is",
    (
        "pixsim/viewer/mtf.py",
        "np.array(light.weight) / np.sum(light.weight)",
        "np.array(light.weight) * np.sum(light.weight)",
    ): "a ratio of two sums with the same weights",
    ("pixsim/sensor/saturation.py", "1 + _RISE_OVER", "1 - _RISE_OVER"): (
        "the search of the highest peak gives the same well in more steps"
    ),
    (
        "pixsim/sensor/saturation.py",
        "_PEAK_WITHIN * brightest_e",
        "(2 * (_PEAK_WITHIN * brightest_e))",
    ): ("where a search for a peak ends, which is closer by then"),
    **{
        (
            "pixsim/sensor/saturation.py",
            before,
            f"(2 * ({before}))",
        ): "how many nodes a quadrature has"
        for before in (
            "gain_spread * mean_e",
            "gain_spread * mean_e / temporal_e",
            "offset_spread_e / temporal_e",
        )
    },
    ("pixsim/sensor/photodiode.py", "1 + NODES", "1 - NODES"): "nodes lie on both sides alike",
    (
        "pixsim/sensor/reading.py",
        "reading.limit_e / reading.response",
        "(2 * (reading.limit_e / reading.response))",
    ): "the order of numbers is that of twice these",
    **{
        ("pixsim/sensor/collection.py", before, after): "how many spokes a quadrature has"
        for before, after in (
            ("-spokes", "(-(-spokes))"),
            ("spokes + -spokes % 4", "spokes - -spokes % 4"),
            ("spokes + -spokes % 4", "(2 * (spokes + -spokes % 4))"),
        )
    },
    (
        "pixsim/sensor/photodiode.py",
        "first - first_line",
        "(2 * (first - first_line))",
    ): "a table with more entries, right to 1e-6 of the well as well",
    **{
        (
            "pixsim/sensor/readout.py",
            before,
            f"(2 * ({before}))",
        ): "more pixels of a burst are drawn one exposure at a time, by the same law"
        for before in (
            "_CLIP_SIGMAS * np.sqrt(brightest_e)",
            "_CLIP_SIGMAS * np.sqrt(charge_e + pixel_sigma_e**2)",
            "_CLIP_SIGMAS * np.sqrt(charge_e + pixel_sigma_e**2) + POISSON_MARGIN_E",
            "charge_e + pixel_sigma_e**2",
            "sign * spread_e",
        )
    },
    (
        "pixsim/sensor/integration.py",
        "electrons * irradiance.factors[0]",
        "(2 * (electrons * irradiance.factors[0]))",
    ): "its sign alone counts",
    **{
        ("pixsim/sensor/pixel.py", before, f"(2 * ({before}))"): (
            "Newton's method from another start ends in the same root"
        )
        for before in (
            "1e-15 * charge",
            "charge / (E_PER_FC * self.capacitance_ff(self.reset_voltage_v))",
            "E_PER_FC * self.capacitance_ff(self.reset_voltage_v)",
        )
    },
    **{
        ("pixsim/sensor/code_moments.py", "top_dn / 2", after): (
            "codes are counted from the other end, to the same sums"
        )
        for after in ("top_dn * 2", "(2 * (top_dn / 2))")
    },
    **{
        ("pixsim/sensor/photodiode.py", before, f"(2 * ({before}))"): (
            "where a table ends, far beyond all light and what an ADC reads"
        )
        for before in ("_MAX_GENERATED * full_well_e", "_MAX_STORED * full_well_e")
    },
    (
        "pixsim/sensor/photodiode.py",
        "np.array(diode.knees_v) / diode.thermal_v",
        "np.array(diode.knees_v) * diode.thermal_v",
    ): "a panel across the knee of a capacitance, whose slope goes on, errs by less than 1e-13",
    ("pixsim/sensor/raw.py", "8", "(8) + 1"): "how many names a message lists",
    **{
        ("pixsim/sensor/photodiode.py", before, after): "a search of the same limit in other steps"
        for before, after in (
            ("4", "(4) + 1"),
            ("_SEARCH_RANGE[0] * full_well_e", "_SEARCH_RANGE[0] / full_well_e"),
            ("_SEARCH_RANGE[0] * full_well_e", "(2 * (_SEARCH_RANGE[0] * full_well_e))"),
            ("_SEARCH_RANGE[1] * full_well_e", "(2 * (_SEARCH_RANGE[1] * full_well_e))"),
        )
    },
    (
        "pixsim/sensor/motion.py",
        "math.isqrt(count - 1) + 1",
        "(2 * (math.isqrt(count - 1) + 1))",
    ): "tables of more fine steps have the same products",
    (
        "pixsim/sensor/saturation.py",
        "coarse_e.size - 1",
        "(2 * (coarse_e.size - 1))",
    ): "the peak is never at the brightest light, beyond the clip",
    (
        "pixsim/sensor/spectral_range.py",
        "power * _response(channel)",
        "(2 * (power * _response(channel)))",
    ): "a share of electrons is that of twice as many",
    ("pixsim/sensor/integration.py", "electrons * self.seen", "(2 * (electrons * self.seen))"): (
        "bands are weighed against each other"
    ),
    (
        "pixsim/sensor/spectral_range.py",
        "np.array(lamps, float).reshape(-1, cells) * _response(physics)",
        "(2 * (np.array(lamps, float).reshape(-1, cells) * _response(physics)))",
    ): "a share of electrons is that of twice as many",
    (
        "pixsim/sensor/photodiode.py",
        "round(2 * _BUMP / _PANEL) + 1",
        "(2 * (round(2 * _BUMP / _PANEL) + 1))",
    ): "more panels of a quadrature that is right to 1e-15",
    ("pixsim/sensor/merge.py", "number", "(number) + 1"): (
        "the charge of the reading itself is stated in the next line"
    ),
    ("pixsim/sensor/dynamic_range.py", "_STEPS", "(_STEPS) + 1"): (
        "one more step of a bisection that has no more digits"
    ),
    ("pixsim/sensor/pixel.py", "_INVERSION_STEPS", "(_INVERSION_STEPS) + 1"): (
        "one more step towards a root that is reached long before"
    ),
    ("pixsim/sensor/collection.py", "1", "(1) + 1"): (
        "one more wavelength, of which all are checked then, or are alike"
    ),
    ("pixsim/sensor/camera_data.py", "silicon * _TYPICAL_NM", "(2 * (silicon * _TYPICAL_NM))"): (
        "responses are relative to the largest"
    ),
    **{
        ("pixsim/sensor/photodiode.py", before, after): "Newton's method ends in the same root"
        for before, after in (
            ("NEWTON_STEPS", "(NEWTON_STEPS) + 1"),
            ("1e-14 * next_step", "(2 * (1e-14 * next_step))"),
            ("next_step - step", "(2 * (next_step - step))"),
            ("next_step - step", "next_step + step"),
            ("panel + 1", "(2 * (panel + 1))"),
            (
                "diode.thermal_v * (np.logaddexp(0.0, -start) - fall)",
                "(2 * (diode.thermal_v * (np.logaddexp(0.0, -start) - fall)))",
            ),
            (
                "equilibrium_v + diode.thermal_v * (np.logaddexp(0.0, -start) - fall)",
                "(2 * (equilibrium_v + diode.thermal_v * (np.logaddexp(0.0, -start) - fall)))",
            ),
            ("np.logaddexp(0.0, -start) - fall", "np.logaddexp(0.0, -start) + fall"),
            ("np.logaddexp(0.0, -start) - fall", "(2 * (np.logaddexp(0.0, -start) - fall))"),
        )
    },
    ("pixsim/sensor/saturation.py", "_MAX_WELL * capacity_e", "(2 * (_MAX_WELL * capacity_e))"): (
        "where a search ends that finds its well long before"
    ),
    (
        "pixsim/sensor/saturation.py",
        "CLIP_REACH * sigma",
        "(2 * (CLIP_REACH * sigma))",
    ): "moments so far from the clip are those without it",
    ("pixsim/sensor/saturation.py", "1 + gain", "1 - gain"): (
        "gains are as often below their mean as above it"
    ),
    ("pixsim/optics/stack.py", "next_angle - angle", "next_angle + angle"): (
        "all steps of a search, of which the last change nothing"
    ),
    (
        "pixsim/sensor/integration.py",
        "values.col - values.row",
        "(2 * (values.col - values.row))",
    ): ("a wider band of a matrix, of zeros"),
    **{
        ("pixsim/sensor/integration.py", before, after): "a wider band of a matrix, of zeros"
        for before, after in (
            ("values.col - values.row", "values.col + values.row"),
            ("3 * bandwidth", "(2 * (3 * bandwidth))"),
            ("3 * bandwidth + 1", "(2 * (3 * bandwidth + 1))"),
        )
    },
    ("pixsim/sensor/merge.py", "len(share) - 1", "(len(share) - 1) + 1"): (
        "the last reading has all of what it leaves itself"
    ),
    ("pixsim/sensor/correction.py", "shading * balance", "(2 * (shading * balance))"): (
        "light is relative to its largest value"
    ),
    ("pixsim/viewer/sharpening.py", "axis", "{0: 1, 1: 0, -1: -2, -2: -1, 2: 1}[axis]"): (
        "a Gaussian blurs rows and columns in either order"
    ),
    ("pixsim/viewer/tone.py", "2", "(2) + 1"): "the first row of a product is used alone",
    **{
        ("pixsim/viewer/denoising/filters.py", f"1 - {shift}", f"(2 * (1 - {shift}))"): (
            "a slice ends with the plane"
        )
        for shift in ("down", "across")
    },
    (
        "pixsim/viewer/delta_e_statistics.py",
        "values.size - 1",
        "(2 * (values.size - 1))",
    ): "only in a picture of one dot is the next rank beyond the last",
    **{
        ("pixsim/viewer/denoising/anscombe.py", before, after or f"(2 * ({before}))"): reason
        for before, after, reason in (
            ("flat_e + gaussian_variance_e2", "", "from 125 e- on the series errs by 7e-9"),
            ("largest + _TAIL * math.sqrt(largest) + _TAIL**2 / 2", "", "more terms, of 0"),
            ("largest + _TAIL * math.sqrt(largest)", "", "more terms, of 0"),
            ("_TAIL * math.sqrt(largest)", "", "more terms, of 0"),
            ("_TAIL**2 / 2", "", "more terms, of 0"),
            ("_TAIL**2 / 2", "_TAIL**2 * 2", "more terms, of 0"),
            ("last + 1.0", "", "more terms, of 0"),
            ("9", "(9) + 1", "a cumulant that no moment takes"),
            ("_TAIL * sigma", "", "400 steps over twice the range are right to 1e-12, too"),
            ("_GAUSSIAN_STEPS + 1.0", "_GAUSSIAN_STEPS - 1.0", "the last step has 1e-17"),
            ("2 * math.sqrt(_SERIES_FROM_E) / _TABLE_STEP", "", "a finer table, equal to 1e-8 e-"),
            ("1", "(1) + 1", "a step of 1 % less of the table, equal to 2e-8 e-"),
            ("-1", "(-(-1))", "knots that begin again at the dark have the same corrections"),
        )
    },
    **{
        ("pixsim/viewer/colour_matrix.py", before, after or f"(2 * ({before}))"): reason
        for before, after, reason in (
            ("tolerance * sizes[0]", "", "values are 1e-9 of the largest and more, or of rounding"),
            (
                "(optimum.hess_inv + optimum.hess_inv.T) / 2",
                "",
                "a search with another first curvature",
            ),
            (
                "(optimum.hess_inv + optimum.hess_inv.T) / 2",
                "(optimum.hess_inv + optimum.hess_inv.T) * 2",
                "a search with another first curvature",
            ),
            ("optimum.hess_inv + optimum.hess_inv.T", "", "a search with another first curvature"),
            ("sensitivities.T / largest", "", "sensitivities are relative"),
        )
    },
    (
        "pixsim/viewer/develop.py",
        "np.array(sensitivities) * light",
        "(2 * (np.array(sensitivities) * light))",
    ): "electrons are relative to those of white",
    (
        "pixsim/viewer/develop.py",
        "lamp * irradiance.band_width_nm",
        "(2 * (lamp * irradiance.band_width_nm))",
    ): "electrons and XYZ are relative to those of white",
    **{
        ("pixsim/viewer/display.py", before, after or f"(2 * ({before}))"): reason
        for before, after, reason in (
            (
                "(near * (1 - _CODE_MARGIN)).view(np.int64) - 1",
                "(near * (1 - _CODE_MARGIN)).view(np.int64) + 1",
                "the interval of a search is far wider than a last digit",
            ),
            (
                "(near * (1 + _CODE_MARGIN)).view(np.int64) + 1",
                "(near * (1 + _CODE_MARGIN)).view(np.int64) - 1",
                "the interval of a search is far wider than a last digit",
            ),
            ("_BINS_PER_CODE * (top + 1)", "", "codes of fewer bins are searched"),
            (
                "_BINS_PER_CODE * (top + 1)",
                "_BINS_PER_CODE / (top + 1)",
                "codes of more bins are searched",
            ),
            ("2.0**frame.bits / frame.dn_per_e", "", "half of 1e30 is far within float32, too"),
            ("(last - first).max() + 1", "", "cells beyond the last are left out"),
            ("top + 1", "", "codes beyond the last, which are not used"),
            ("_MAX_SINGLE * white_e", "", "twice 1e30 is far within float32, too"),
            (
                "2.0**frame.bits / frame.dn_per_e + frame.mean_dark_e",
                "",
                "half of 1e30 is far within float32, too",
            ),
        )
    },
    (
        "pixsim/viewer/metric_kernels/visible_noise.py",
        "_BRADFORD.sum(axis=1) / (_BRADFORD @ white)",
        "(2 * (_BRADFORD.sum(axis=1) / (_BRADFORD @ white)))",
    ): "channels are filtered at twice their size, which is taken back",
    **{
        ("pixsim/viewer/other_pictures.py", before, after): (
            "of the screen of two pictures only ΔE is taken"
        )
        for lines in ("rows", "columns")
        for before, after in (
            (f"{lines} + 1.0", f"{lines} - 1.0"),
            (f"{lines} + 1.0", f"(2 * ({lines} + 1.0))"),
        )
    },
    **{
        ("pixsim/viewer/scene_light.py", before, after): "how many scenes are cached"
        for before, after in (
            (
                "2 * self.channels * math.prod(self.irradiance.shape)",
                "(2 * (2 * self.channels * math.prod(self.irradiance.shape)))",
            ),
            ("8 * (samples + planes_a_dot * dots)", "(2 * (8 * (samples + planes_a_dot * dots)))"),
            ("samples + planes_a_dot * dots", "(2 * (samples + planes_a_dot * dots))"),
        )
    },
    **{
        ("pixsim/viewer/evaluate.py", before, after): "how many chains are cached"
        for before, after in (
            (
                "other.signal_e_per_s.nbytes + 3 * other.screen.ideal.nbytes",
                "other.signal_e_per_s.nbytes - 3 * other.screen.ideal.nbytes",
            ),
            (
                "other.signal_e_per_s.nbytes + 3 * other.screen.ideal.nbytes",
                "(2 * (other.signal_e_per_s.nbytes + 3 * other.screen.ideal.nbytes))",
            ),
            ("3 * other.screen.ideal.nbytes", "3 / other.screen.ideal.nbytes"),
            ("3 * other.screen.ideal.nbytes", "(2 * (3 * other.screen.ideal.nbytes))"),
        )
    },
    ("pixsim/viewer/adaptation.py", "matrix * white", "(2 * (matrix * white))"): (
        "responses to two whites are relative to each other"
    ),
    (
        "pixsim/viewer/delta_e_statistics.py",
        "float(np.finfo(values.dtype).tiny) * HISTOGRAM_BINS",
        "(2 * (float(np.finfo(values.dtype).tiny) * HISTOGRAM_BINS))",
    ): "the bins of pictures without a difference",
    **{
        ("pixsim/viewer/metric_kernels/linear_observer.py", before, f"(2 * ({before}))"): reason
        for before, reason in (
            ("gradient / diagonal", "the length of a direction is found along it"),
            ("_STEPS_PER_OFFSET * row_offsets.size", "more steps than any search needs"),
            (
                "_RESIDUAL * float((weight * delta**2).sum())",
                "1e-26 of the whole is lost, or 2e-26",
            ),
            ("weight * delta**2", "1e-26 of the whole is lost, or 2e-26"),
            ("unit / LARGEST", "offsets 1e-154 of the noise make no difference"),
        )
    },
    (
        "pixsim/viewer/metric_kernels/linear_observer.py",
        "_STEPS_PER_OFFSET * row_offsets.size",
        "(_STEPS_PER_OFFSET * row_offsets.size) + 1",
    ): "more steps than any search needs",
    (
        "pixsim/viewer/metric_kernels/information_density.py",
        "frequency_cy_per_mm + i * _UM_PER_MM / pitch_um",
        "frequency_cy_per_mm - i * _UM_PER_MM / pitch_um",
    ): "multiples on either side of 0 are summed",
    (
        "pixsim/viewer/metric_kernels/non_prewhitening.py",
        "frequency**_EYE_POWER * np.exp(-_EYE_DECAY * frequency**2)",
        "(2 * (frequency**_EYE_POWER * np.exp(-_EYE_DECAY * frequency**2)))",
    ): "the eye's filter is relative",
    (
        "pixsim/viewer/metric_kernels/non_prewhitening.py",
        "np.fft.fft2(difference) * gain",
        "(2 * (np.fft.fft2(difference) * gain))",
    ): "a template is relative",
    ("pixsim/viewer/scene_light.py", "2 * self.channels", "(2 * (2 * self.channels))"): (
        "how many scenes are cached"
    ),
    ("pixsim/viewer/scene_light.py", "planes_a_dot * dots", "(2 * (planes_a_dot * dots))"): (
        "how many scenes are cached"
    ),
}


@dataclass(frozen=True)
class Mutation:
    """A piece of a source file, in bytes from its beginning, and what replaces it."""

    path: str
    line: int
    kind: str
    start: int
    end: int
    before: str
    after: str

    def __str__(self) -> str:
        return f"{self.path}:{self.line} {self.kind}: {self.before} -> {self.after}"


def mutations_of_file(path: Path) -> Iterator[Mutation]:
    """Every possible change of a file's arithmetic: no texts, annotations, defaults of fields."""
    source = path.read_bytes()
    name = str(path.relative_to(ROOT))
    lengths = [0]
    for line in source.splitlines(keepends=True):
        lengths.append(lengths[-1] + len(line))

    def offsets(node: ast.expr) -> tuple[int, int]:
        assert node.end_lineno is not None
        assert node.end_col_offset is not None
        start = lengths[node.lineno - 1] + node.col_offset
        return start, lengths[node.end_lineno - 1] + node.end_col_offset

    def change(node: ast.expr, kind: str, after: str) -> Mutation:
        start, end = offsets(node)
        before = source[start:end].decode()
        return Mutation(
            name, node.lineno, kind, start, end, before, after.replace("EXPRESSION", before)
        )

    for node in ast.walk(_arithmetic(ast.parse(source))):
        if isinstance(node, ast.BinOp) and type(node.op) in SWAPPED and not _is_text(node):
            sign, other = SWAPPED[type(node.op)]
            start, end = offsets(node)
            left, right = offsets(node.left)[1], offsets(node.right)[0]
            between = source[left:right].replace(sign, other, 1)
            swapped = source[start:left] + between + source[right:end]
            yield change(node, "sign" if sign in b"+-" else "factor", swapped.decode())
            yield change(node, "factor 2", "(2 * (EXPRESSION))")
        elif isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.USub):
            yield change(node, "sign", "(-(EXPRESSION))")
        elif isinstance(node, ast.Slice):
            for bound in filter(None, (node.lower, node.upper)):
                yield change(bound, "off by one", "(EXPRESSION) + 1")
        elif isinstance(node, ast.Call) and getattr(node.func, "id", "") == "range":
            if isinstance(node.args[-1], ast.Starred):
                continue
            yield change(node.args[-1], "off by one", "(EXPRESSION) + 1")
        elif isinstance(node, ast.keyword) and node.arg == "axis":
            yield change(
                node.value, "swapped axis", "{0: 1, 1: 0, -1: -2, -2: -1, 2: 1}[EXPRESSION]"
            )
        elif isinstance(node, ast.Attribute) and node.attr == "T":
            yield change(node, "swapped axis", "EXPRESSION.T")


def _arithmetic(tree: ast.Module) -> ast.Module:
    """Return the tree without annotations, decorators and what errors and assertions say."""

    class Texts(ast.NodeTransformer):
        def visit_Raise(self, _: ast.Raise) -> None: ...
        def visit_Assert(self, _: ast.Assert) -> None: ...
        def visit_JoinedStr(self, _: ast.JoinedStr) -> ast.Constant:
            return ast.Constant("")

        def visit_arg(self, node: ast.arg) -> ast.arg:
            node.annotation = None
            return node

    for node in ast.walk(tree):
        if isinstance(node, ast.FunctionDef):
            node.returns, node.decorator_list = None, []
        elif isinstance(node, ast.AnnAssign):
            node.annotation = ast.Name("object")
    changed = Texts().visit(tree)
    assert isinstance(changed, ast.Module)
    return changed


def _is_text(node: ast.BinOp) -> bool:
    """Texts, lists and paths have + and / too."""
    sides = [side for side in ast.walk(node) if not isinstance(side, ast.BinOp | ast.operator)]
    return any(
        isinstance(side, ast.List | ast.ListComp | ast.Tuple)
        or (isinstance(side, ast.Constant) and isinstance(side.value, str))
        for side in sides
    )


def drawn(rooms: list[str], seed: int) -> Iterator[Mutation]:
    """Mutations in random order, one a line."""
    possible: dict[tuple[str, int], list[Mutation]] = {}
    for room in rooms:
        for path in sorted((ROOT / "pixsim" / room).glob("**/*.py")):
            for mutation in mutations_of_file(path):
                possible.setdefault((mutation.path, mutation.line), []).append(mutation)
    generator = random.Random(seed)
    lines = sorted(possible)
    generator.shuffle(lines)
    for line in lines:
        mutation = generator.choice(possible[line])
        if (mutation.path, mutation.before, mutation.after) not in SAME_RESULT:
            yield mutation


def reach(path: Path | None) -> Reach:
    """Return tests (`file.py::test`) by file and line, of a coverage file with contexts."""
    tests: Reach = {}
    if path is None:
        return tests
    from coverage import CoverageData

    data = CoverageData(str(path))
    data.read()
    for measured in data.measured_files():
        name = "pixsim/" + measured.rpartition("/pixsim/")[2]
        for line, contexts in data.contexts_by_lineno(measured).items():
            tests[name, line] = {test for test in map(_test_name, contexts) if test}
    return tests


def _test_name(context: str) -> str:
    """Return `tests/room/test_x.py::test_y` for `tests.room.test_x.test_y`; "" for none."""
    module, _, function = context.rpartition(".")
    path = module.replace(".", "/") + ".py"
    return f"{path}::{function}" if (ROOT / path).is_file() else ""


def first_failure(copy: Path, tests: list[str]) -> str:
    """Return the first test that fails in a copy of the checkout, or ""."""
    command = [sys.executable, "-m", "pytest", "-q", "-x", "--tb=no", "-p", "no:cacheprovider"]
    environment = {**os.environ, "PYTHONPATH": str(copy), "PIXSIM_CACHE_DIR": str(copy / "cache")}
    try:
        done = subprocess.run(
            [*command, *tests], cwd=copy, env=environment, capture_output=True, text=True,
            timeout=TIMEOUT_S,
        )  # fmt: skip
    except subprocess.TimeoutExpired:
        return f"no end within {TIMEOUT_S:.0f} s"
    failures = [line for line in done.stdout.splitlines() if line.startswith(("FAILED", "ERROR"))]
    if failures:
        return failures[0]
    if done.returncode == 4:
        raise SystemExit(f"the coverage file names tests that are gone: {done.stderr[-500:]}")
    return "" if done.returncode in (0, 5) else f"pytest ended with {done.returncode}"


def tests_by_room(mutation: Mutation, tests: set[str]) -> list[list[str]]:
    """Return the tests of the mutation's room that reach it, all others that do, at most a thousand
    a command, and then all of the room: what is cached is reached by its first caller alone.
    """
    folder = f"tests/{mutation.path.split('/')[1]}"
    near = sorted(test for test in tests if test.startswith(f"{folder}/"))
    far = sorted(tests - set(near))
    groups = [
        group[start : start + 1000] for group in (near, far) for start in range(0, len(group), 1000)
    ]
    return [*groups, [folder]]


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("--count", type=int, default=60)
    parser.add_argument("--seed", type=int, default=62)
    parser.add_argument("--rooms", nargs="+", default=ROOMS)
    parser.add_argument("--reach", type=Path)
    parser.add_argument("--tests", nargs="+", default=["tests"])
    arguments = parser.parse_args()

    reached = reach(arguments.reach)
    caught = 0
    with tempfile.TemporaryDirectory() as folder:
        copy = Path(folder) / "pixsim"
        listed = subprocess.run(
            ["git", "ls-files"], cwd=ROOT, capture_output=True, text=True, check=True
        )
        for name in listed.stdout.splitlines():
            (copy / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy(ROOT / name, copy / name)
        mutations = drawn(arguments.rooms, arguments.seed)
        for number, mutation in zip(range(1, arguments.count + 1), mutations, strict=False):
            start_s = time.perf_counter()
            target = copy / mutation.path
            source = target.read_bytes()
            changed = source[: mutation.start] + mutation.after.encode() + source[mutation.end :]
            target.write_bytes(changed)
            groups = [arguments.tests]
            if reached:
                groups = tests_by_room(mutation, reached.get((mutation.path, mutation.line), set()))
            failure = next(filter(None, (first_failure(copy, group) for group in groups)), "")
            target.write_bytes(source)
            caught += bool(failure)
            seconds = time.perf_counter() - start_s
            print(f"{number} {mutation}\n    {failure or 'SURVIVED'} ({seconds:.0f} s)", flush=True)
    print(f"{caught} of {arguments.count} caught")


if __name__ == "__main__":
    main()
