"""``unmodeled why``: the line of the ledger of a stored diagnosis, in words."""

from __future__ import annotations

import json
from pathlib import Path

from unmodeled.cli.options import argument, declare
from unmodeled.cli.screen import print_json, say
from unmodeled.errors import DataError


@declare("why")
def why(
    folder: Path = argument(),
    name: tuple[str, ...] = argument(required=False),
    *,
    as_json: bool,
) -> None:
    """Say why a candidate is in the answer of the diagnosis in FOLDER, or not.

    `unmodeled diagnose --out FOLDER` writes such a folder. Without NAME, all candidates are listed
    with the codes of the rules that decided.
    """
    from unmodeled.report.why import why as told
    from unmodeled.search.ledger import from_plain, listed
    from unmodeled.search.result import plain

    path = folder / "report.json" if folder.is_dir() else folder
    try:
        findings = from_plain(json.loads(path.read_text("utf-8")))
    except (KeyError, TypeError, ValueError) as error:
        raise DataError(
            f"{path}: has no findings ({error}), expected the report.json of a diagnosis of this "
            "version"
        ) from error
    some = tuple(listed(findings, n) for n in name) or findings
    if as_json:
        print_json(plain(some))
    for f in () if as_json else some:
        mark = f.mark.value if f.mark else "not in the answer"
        say(told(f) if name else f"{f.cause}: {mark} ({', '.join(f.codes)})")
