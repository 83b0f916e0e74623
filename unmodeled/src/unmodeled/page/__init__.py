"""A local page in the browser: model and records, check, search, and the report.

:func:`serve` opens a page on 127.0.0.1. Its form has the options of ``unmodeled diagnose``, read by
the same functions. ``server``, ``door``, ``guard``, ``uploads`` and ``showing`` serve other local
pages too; they need the packages of the extra ``page``.
"""

from unmodeled.page.serve import serve

__all__ = ["serve"]
