"""What every package stands on, without physics: settings, errors, files, cache, arrays, progress, the machine.

In: TOML files, options, other people's files. Out: frozen records (`parameters`), whole files, arrays that can be trusted.
`parameters`, `config`, `errors` and `files` load no NumPy, so that `--help` is quick.
May import: no other package.
"""
