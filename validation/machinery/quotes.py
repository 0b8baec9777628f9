"""Figures of records that README and explanations quote: where they stand, and how they are renewed."""

from __future__ import annotations

import importlib
import re
import tomllib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace

from scipy.stats import norm

from validation.machinery.claims import Claim, confidence_of_look
from validation.machinery.code import ROOT
from validation.machinery.parts import Row
from validation.machinery.records import Record

NUMBER = r"[-+]?\d[\d,]*(?:\.\d+)?(?:e[-+]\d+)?"
WORD = "[a-z]+"
QUOTES = ROOT / "validation" / "quotes.toml"
END = "<!-- end of records -->"


@dataclass(frozen=True)
class Quote:
    """A phrase of a page in which figures stand as `{proof.part.claim.field:format}`.

    Fields: found, low, high, error, n, hits, verdict, percent, percent_low, percent_high. Hyphens of a part's name
    become underscores.
    """

    page: str
    phrase: str

    @property
    def _pieces(self) -> list[str]:
        return re.split(r"(\{[^}]*\})", self.phrase)

    def renewed(self, text: str, figures: Mapping[str, SimpleNamespace]) -> str:
        """The page with the figures of the records; raises ValueError where it holds the phrase not exactly once."""
        words = [r"\s+".join(map(re.escape, re.split(r"\s+", piece))) for piece in self._pieces[::2]]
        kinds = [WORD if ".verdict}" in field else NUMBER for field in self._pieces[1::2]]
        pattern = words[0] + "".join(f"({kind}){word}" for kind, word in zip(kinds, words[1:], strict=True))
        found = list(re.finditer(pattern, text))
        if len(found) != 1:
            raise ValueError(f"{self.page} holds {len(found)} times: {self.phrase}")
        for group, field in reversed(list(enumerate(self._pieces[1::2], 1))):
            start, end = found[0].span(group)
            try:
                text = text[:start] + field.format_map(dict(figures)) + text[end:]
            except (AttributeError, KeyError) as error:
                raise ValueError(f"{self.page} quotes {field}, which no record holds") from error
        return text


def read_quotes(file: Path = QUOTES) -> list[Quote]:
    return [Quote(**quote) for quote in tomllib.loads(file.read_text(encoding="utf-8"))["quote"]]


def figures_of(records: Iterable[Record]) -> dict[str, SimpleNamespace]:
    """Proof, part and claim as attributes, of the record of every part."""
    proofs: dict[str, SimpleNamespace] = {}
    for record in records:
        claims = SimpleNamespace(**{claim.key: _figure(claim, record.look) for claim in record.claims})
        setattr(proofs.setdefault(record.proof, SimpleNamespace()), record.part.replace("-", "_"), claims)
    return proofs


def _figure(claim: Claim, look: int) -> SimpleNamespace:
    low, high = claim.interval
    error = (high - low) / (2 * norm.ppf(0.5 + confidence_of_look(look) / 2))
    percent = {"percent": 100 * claim.found, "percent_low": 100 * low, "percent_high": 100 * high}
    return SimpleNamespace(
        found=claim.found, low=low, high=high, n=claim.n, hits=round(claim.found * claim.n),
        error=error, verdict=claim.verdict, **percent,
    )  # fmt: skip


def renew_tables(text: str, records: Iterable[Record]) -> str:
    """A page with its tables of trials: between `<!-- records: PROOF.TABLE -->` and `<!-- end of records -->`.

    The table is written by the function of that name in `TABLES` of the proof, from the rows of every part; it stays as
    it is where a part that it needs has no trials on record.
    """
    rows: dict[str, dict[str, list[Row]]] = {}
    for record in records:
        if record.rows:
            rows.setdefault(record.proof, {})[record.part] = list(record.rows)

    def written(match: re.Match[str]) -> str:
        proof, name = match[1], match[2]
        lines = importlib.import_module(f"validation.{proof}").TABLES[name](rows.get(proof, {}))
        return f"<!-- records: {proof}.{name} -->\n{chr(10).join(lines)}\n{END}" if lines else match[0]

    return re.sub(rf"<!-- records: (\w+)\.(\w+) -->\n.*?{END}", written, text, flags=re.DOTALL)


def renew_pages(quotes: Iterable[Quote], records: Sequence[Record], root: Path = ROOT) -> dict[Path, str]:
    """The text of every page that quotes, with the figures of the records."""
    figures = figures_of(records)
    pages: dict[Path, str] = {}
    for quote in quotes:
        path = root / quote.page
        pages[path] = quote.renewed(pages.get(path) or path.read_text(encoding="utf-8"), figures)
    return {path: renew_tables(text, records) for path, text in pages.items()}
