"""Updates the table of the rules of the judgement in docs/explanation/gap.md."""

import re
from pathlib import Path

from unmodeled.report.why import SENTENCES
from unmodeled.search.ledger import RULES

DOCUMENT = Path(__file__).resolve().parents[1] / "docs" / "explanation" / "gap.md"


def rules_markdown() -> str:
    """Table of the rules in their order: code, mark, threshold, sentence."""
    rows = ["| code | in the answer as | holds if | sentence |", "|---|---|---|---|"]
    for r in RULES:
        mark = f"*{r.mark.value}*" if r.mark else "-"
        rows.append(f"| `{r.code}` | {mark} | {r.threshold} | {SENTENCES[r.code]} |")
    return "\n".join(rows) + "\n"


def updated(text: str) -> str:
    """The page with the table between its two marks."""
    pattern = r"(<!-- rules -->\n).*?(<!-- end of rules -->)"
    return re.sub(pattern, lambda m: m[1] + rules_markdown() + m[2], text, flags=re.DOTALL)


if __name__ == "__main__":
    DOCUMENT.write_text(updated(DOCUMENT.read_text("utf-8")), "utf-8")
