"""``feltmb fit``: fits a model without a diagnosis."""

from __future__ import annotations

from pathlib import Path

import click

from feltmb.cli.common import (
    ProgressLine,
    budget_option,
    console,
    folder_option,
    force_option,
    interruptible,
    json_option,
    model_set_option,
    new_table,
    positive,
    print_json,
    say,
    say_written,
)
from feltmb.cli.completing import actions

__all__ = ["command"]


@click.command(name="fit")
@click.argument("model", shell_complete=actions)
@click.argument("data", nargs=-1, required=True, type=click.Path(path_type=Path))
@click.option("--segment", type=positive("s"), help="Length of shooting segments [s].")
@click.option(
    "--restarts",
    type=click.IntRange(0, 10_000),
    default=3,
    show_default=True,
    help="Largest number of further starting points.",
)
@folder_option("Folder for fit.json.")
@budget_option
@model_set_option
@json_option
@force_option
def command(
    model: str,
    data: tuple[Path, ...],
    segment: float | None,
    restarts: int,
    output: Path | None,
    budget: float | None,
    settings: tuple[str, ...],
    as_json: bool,
    force: bool,
) -> None:
    """Fit the parameters of MODEL to measured DATA, and print values and intervals.

    MODEL is a mechanism (packaged or a TOML file), or a Python file that defines `model` and
    `effects`. An interrupted fit continues when it is started again with the same output folder.
    """
    import json

    from feltmb.cli.gap_models import load_adapter
    from feltmb.files import check_writable, make_folder, write_text
    from feltmb.fit.solve import NOT_CONVERGED, FitSettings
    from feltmb.gap import fit_model
    from feltmb.gap.report import plain
    from feltmb.gap.resumed import discard, remaining

    # Fits of interrupted diagnoses may stand beside these.
    fits = None if output is None else output / ".resume" / "fit"
    if output is not None:
        check_writable(make_folder(output) / "fit.json", force=force)

    adapter = load_adapter(model, settings)
    records = adapter.read(data)
    line = ProgressLine()
    with interruptible() as stop:
        fit = fit_model(
            adapter.model,
            records,
            segment=segment,
            settings=FitSettings(restarts=restarts),
            progress=line,
            resume=fits,
            budget=budget,
            stop=stop,
        )
        stop.writing()
        line.close()
        rows = fit.intervals()
        result = {
            "model": adapter.model.name,
            "parameters": plain(rows),
            "chi2": plain(fit.chi2),
            "dof": plain(fit.dof),
            "level": plain(fit.level),
            "converged": fit.converged,
            "notes": list(fit.notes),
        }
        if output is not None:
            text = json.dumps(result, indent=2) + "\n"
            say_written(write_text(output / "fit.json", text, force=force))
            stopped = any(n.startswith("stopped") for n in fit.notes)
            if fits is not None and not stopped:
                discard(fits)
            if kept := remaining(output / ".resume"):
                say(kept, err=True)
    if as_json:
        print_json(result)
        return
    table = new_table(
        adapter.model.name,
        "parameter",
        "fitted",
        "95 %",
        "prior",
        "learned",
        right=(1, 2, 3, 4),
        whole=(0,),
    )
    for r in rows:
        unit = "" if r.unit == "1" else f" [{r.unit}]"
        prior = f"{r.prior:.4g} ± {r.prior_sd:.2g}"
        table.add_row(
            r.name + unit,
            f"{r.value:.5g}" + (" (limit)" if r.at_limit else ""),
            f"{r.low:.4g} .. {r.high:.4g}" if r.converged else NOT_CONVERGED,
            prior,
            f"{r.contraction:.0%}",
        )
    console().print(table)
    say(
        f"sum of squares {fit.chi2 / fit.dof:.3g} of its expectation, "
        f"{'converged' if fit.converged else 'NOT converged'}"
    )
    for note in fit.notes:
        say(f"note: {note}")
    if not fit.explains:
        say("the model does not explain the records: intervals are too narrow; try gap diagnose")
