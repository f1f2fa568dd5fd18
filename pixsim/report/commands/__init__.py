"""What the commands `run`, `study` and `compare` do: settings in, the files of a folder and the document of the answer out."""

from pathlib import Path

DEFAULT_OUT = Path("pixsim-out")  # holds the folders of results that have no name
