"""Studies: variants of a mechanism with strokes, figures, tables and checks, defined as data.

:func:`study` runs a packaged study or a user's own TOML file; see
``docs/howto/run_studies.md`` for the file.
"""

from __future__ import annotations

from feltmb.run.study.extract import extract_run, statistic
from feltmb.run.study.model import Case, Study, load_study, packaged_studies, study_outlines
from feltmb.run.study.result import FindingResult, StudyResult, study_targets
from feltmb.run.study.running import run_studies, study

__all__ = [
    "Case",
    "FindingResult",
    "Study",
    "StudyResult",
    "extract_run",
    "load_study",
    "packaged_studies",
    "run_studies",
    "statistic",
    "study",
    "study_outlines",
    "study_targets",
]
