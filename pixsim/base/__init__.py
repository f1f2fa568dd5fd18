"""Foundation of all packages, without physics or anything that has a unit: records, errors, files,
cache, arrays, the machine.

In: TOML files, options, files of other programs. Out: frozen records (`records`) from `layers` of
tables, complete files, validated arrays. `problems` lists the faults of a record, and reads units
from the names of its fields (`units`). `records`, `layers`, `toml`, `errors` and `files` do not
import NumPy, so that `--help` is fast. May import: no other package.
"""
