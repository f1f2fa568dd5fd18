"""What is known of the optima of chen2000's four processes when their assumed numbers are not, and the time that it takes.

    python tests/benchmarks/sensor_types.py [--types 256] [--jobs 4]

The numbers of two of them stand in docs/uncertainty.md.
"""

from __future__ import annotations

import argparse
import tempfile
import time

import pixsim


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--types", type=int, default=256, help="sensor types, a power of two")
    parser.add_argument("--jobs", type=int, default=None)
    chosen = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        start = time.perf_counter()
        result = pixsim.study("chen2000", folder, uncertainty=chosen.types, jobs=chosen.jobs, paper=False)
        seconds = time.perf_counter() - start
    print(f"{chosen.types} sensor types of {len(result.curves)} processes: {seconds:.0f} s")
    print("process  stated (µm)  median (µm)  5 % to 95 % (µm)  least mean ΔE: median")
    for curve, unknown in zip(result.curves, result.uncertainty, strict=True):
        optimum, least = unknown.as_dict()["optimum_um"]["quantiles"], unknown.as_dict()["mean_delta_e"]["quantiles"]
        ends = " to ".join("an end" if optimum[name] is None else f"{optimum[name]:.2f}" for name in ("p05", "p95"))
        print(
            f"{curve.label:8} {curve.optimum.pitch_um:11.2f} {optimum['p50'] or float('nan'):12.2f} {ends:>17} {least['p50']:8.3f}"
        )
    for statement, probability in result.uncertainty[0].as_dict()["verdicts"].items():
        print(f"{probability['probability']:.2f} ({probability['low']:.2f} to {probability['high']:.2f})  {statement}")


if __name__ == "__main__":
    main()
