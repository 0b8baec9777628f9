"""Run a proof and append its figures, with date and commit, to docs/proofs.md."""

from __future__ import annotations

import importlib
import subprocess
import sys
import time
from datetime import UTC, datetime
from pathlib import Path

HERE = Path(__file__).parent
RECORD = HERE.parent / "docs" / "proofs.md"


def main(arguments: list[str]) -> int:
    """Run the proof named first among the arguments; the rest are its own."""
    names = sorted(path.stem for path in HERE.glob("*.py") if not path.stem.startswith("_"))
    if not arguments or arguments[0] not in names:
        print("usage: ./dev prove NAME [ARGS]\n\nproofs: " + ", ".join(names), file=sys.stderr)
        return 2
    proof = importlib.import_module(f"proofs.{arguments[0]}")
    started = time.monotonic()
    is_proven, figures = proof.prove(arguments[1:])
    git = ["git", "-C", str(HERE), "rev-parse", "--short", "HEAD"]
    commit = subprocess.run(git, capture_output=True, text=True, check=False).stdout.strip() or "no commit"
    verdict = "holds" if is_proven else "DOES NOT HOLD"
    when = f"{datetime.now(UTC):%Y-%m-%d}, {commit}, {time.monotonic() - started:.0f} s"
    heading = f"## {' '.join(arguments)}: {verdict} ({when})"
    entry = "\n".join([heading, "", *figures, ""])
    print(entry)
    with RECORD.open("a") as record:
        record.write("\n" + entry)
    return 0 if is_proven else 1


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
