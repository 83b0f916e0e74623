"""Work in a process of its own: code of strangers may end it, but gives no verdict by that."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Callable, Mapping
from dataclasses import asdict
from typing import Any

from unmodeled import errors
from unmodeled.errors import Error, ModelError
from unmodeled.search.progress import Progress

#: A function of what is asked and of the progress, whose result is JSON.
Work = Callable[[Mapping[str, Any], Callable[[Progress], None]], dict[str, Any]]


def run_apart(
    module: str, asked: Mapping[str, Any], progress: Callable[[Progress], None] | None
) -> dict[str, Any]:
    """Result of a module that calls :func:`serve`, run by another Python process.

    Raises
    ------
    Error
        The work raised it, or the process ended without a result (:class:`ModelError`).
    """
    path = os.pathsep.join(p for p in sys.path if p)
    process = subprocess.Popen(
        [sys.executable, "-P", "-B", "-m", module],  # no code, and no traces, in this folder
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        env={**os.environ, "PYTHONPATH": path},
        encoding="utf-8",
    )
    assert process.stdin is not None
    assert process.stdout is not None
    last: dict[str, Any] = {}
    with process:
        try:
            process.stdin.write(json.dumps(asked))
            process.stdin.close()
            for line in process.stdout:
                last = json.loads(line)
                if "progress" in last and progress is not None:
                    progress(Progress(**last["progress"]))
        except (BrokenPipeError, ValueError, TypeError):
            last = {}
        except BaseException:
            process.kill()
            raise
    if "error" in last:
        kind = getattr(errors, last["error"], Error)
        raise kind(str(last.get("text")))
    if "result" not in last:
        raise ModelError(
            f"the process of the model ended without an answer (exit code {process.returncode})"
        )
    return dict(last["result"])


def serve(work: Work) -> None:
    """Read what is asked from the standard input, and write the result of the work to the output.

    What the work itself prints goes to the standard error.
    """
    channel = os.fdopen(os.dup(1), "w", encoding="utf-8")
    os.dup2(2, 1)

    def tell(**what: Any) -> None:
        channel.write(json.dumps(what) + "\n")
        channel.flush()

    try:
        asked = json.loads(sys.stdin.read())
        tell(result=work(asked, lambda p: tell(progress=asdict(p))))
    except Error as error:
        tell(error=type(error).__name__, text=str(error))
    except KeyboardInterrupt:
        sys.exit(130)
