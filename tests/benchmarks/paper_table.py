"""The table of docs/studies.md "the paper says, pixsim finds", from the summary.json of `pixsim study chen2000`.

python tests/benchmarks/paper_table.py pixsim-out/chen2000/summary.json
"""

from __future__ import annotations

import json
import sys
from pathlib import Path


def main() -> None:
    rows = json.loads(Path(sys.argv[1]).read_text(encoding="utf-8"))["paper"]
    print("| the paper says | given | pixsim finds | agrees |")
    print("|---|---|---|---|")
    for row in rows:
        verdict = "yes" if row["agrees"] else f"**does not agree**: {row['why']}"
        print(f"| {row['statement']} | {row['given']} | {row['found']} | {verdict} |")


if __name__ == "__main__":
    main()
