"""Computes the wear of the packaged action, from which `feltmb symptom` finds causes.

    python tools/make_symptoms.py

Takes ten minutes on two cores. A test tells when the packaged action has changed since.
"""

from __future__ import annotations

import json

import feltmb
from feltmb import params
from feltmb.action.symptoms import PACKAGED


def main() -> None:
    """Write params/symptoms/ACTION.json."""
    found = feltmb.wear(PACKAGED, screws=True)
    path = params.folder("symptoms") / f"{PACKAGED}.json"
    path.write_text(json.dumps(found.as_dict(), indent=1, ensure_ascii=False) + "\n", "utf-8")
    print(f"wrote {path.name}")


if __name__ == "__main__":
    main()
