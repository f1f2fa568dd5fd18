"""What the commands `run`, `study`, `compare` and `plan` do: settings in, files of a folder and the
document of the answer out.
"""

from pathlib import Path

DEFAULT_OUT = Path("pixsim-out")  # holds the folders of results that have no name
