"""Foundation of all packages, without physics: settings, errors, files, cache, arrays, progress, the machine.

In: TOML files, options, files of other programs. Out: frozen records (`parameters`), complete files, validated arrays.
`parameters`, `config`, `errors` and `files` do not import NumPy, so that `--help` is fast.
May import: no other package.
"""
