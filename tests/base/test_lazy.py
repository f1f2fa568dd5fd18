"""What is not loaded with SciPy works when it is asked for."""

from __future__ import annotations

import json
import subprocess
import sys

from helpers.processes import HANG_S

# In a new process, since the modules of this one are loaded.
LOOK = """
import json, sys
from pixsim.base import arrays
import scipy.fft, scipy.linalg, scipy.ndimage, scipy.optimize, scipy.special
loaded = [name for name in sys.modules if name.startswith(("numpy.f2py.", "numpy.testing."))]
import numpy, numpy.testing, numpy.f2py
numpy.testing.assert_allclose(1.0, 1.0)
print(json.dumps([loaded, numpy.f2py.get_include() != "", numpy.testing is sys.modules["numpy.testing"]]))
"""


def test_unused_modules_are_loaded_when_used() -> None:
    done = subprocess.run(
        [sys.executable, "-c", LOOK], check=True, capture_output=True, text=True, timeout=HANG_S
    )
    assert json.loads(done.stdout) == [[], True, True]
