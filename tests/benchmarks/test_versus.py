"""What `versus.py` compares is one job: pixsim's result and that of plain NumPy and SciPy agree, on small films and sensors.

Without the render, which the judges compare with plain Mitsuba, and without packages, which are not installed here. The bounds
are those of the rows. Each fails for a result that is 6 % too large.
"""

from __future__ import annotations

from dataclasses import replace

from benchmarks.versus import NUMPY, difference, numpy_jobs, package_jobs

SIDE, WRONG = 128, 1.06  # at 64 a frame has too few pixels for the bounds on ΔE


def test_plain_code_does_the_same_jobs() -> None:
    checked = 0
    for job in (*numpy_jobs(SIDE), *package_jobs(SIDE)):
        ours = job.ours()

        def too_large(ours: object = ours) -> object:
            return [WRONG * value for value in ours] if isinstance(ours, list) else WRONG * ours

        for other in job.others:
            if other.who == NUMPY:
                right, words = difference(replace(job, ours=lambda ours=ours: ours), other, None)
                assert right is not None, job.name
                assert right <= other.bound, (job.name, words)
                wrong, words = difference(replace(job, ours=too_large), other, None)
                assert wrong is not None, job.name
                assert wrong > other.bound, (job.name, words)
                checked += 1
    assert checked == 8
