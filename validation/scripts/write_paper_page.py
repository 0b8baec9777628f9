"""Write the claims into docs/explanation/the-paper-redone.md, from a run of `lbacal paper`.

.venv/bin/lbacal paper --output var/paper
.venv/bin/python validation/scripts/write_paper_page.py var/paper/claims.json
"""

from __future__ import annotations

import json
import sys
from pathlib import Path

from lbacal_paper.everything import insert_claims

PAGE = Path(__file__).parents[2] / "docs/explanation/the-paper-redone.md"


def main(claims: Path) -> None:
    PAGE.write_text(insert_claims(PAGE.read_text(encoding="utf-8"), json.loads(claims.read_text())), encoding="utf-8")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
