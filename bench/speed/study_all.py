"""Time of all packaged studies from nothing, figures and page included, on two workers.

Usage: python bench/speed/study_all.py [--jobs N]
"""

from __future__ import annotations

import argparse
import json
import tempfile
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from feltmb.run.study import load_study, packaged_studies, run_studies


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--jobs", type=int, default=2)
    jobs = parser.parse_args().jobs
    with tempfile.TemporaryDirectory() as folder, ThreadPoolExecutor(jobs) as pool:
        start = time.perf_counter()
        results = run_studies(
            [load_study(name) for name in packaged_studies()], executor=pool, folder=Path(folder)
        )
        elapsed = time.perf_counter() - start
    print(json.dumps({"case": "study_all", "jobs": jobs, "studies": len(results), "s": elapsed}))


if __name__ == "__main__":
    main()
