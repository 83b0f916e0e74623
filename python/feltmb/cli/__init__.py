"""Command line of feltmb. Commands are imported when they are called, so that help is fast."""

from __future__ import annotations

from unmodeled.cli.running import LazyGroup, run, version_option

__all__ = ["main"]

#: command -> (module and object in it, one line of help)
COMMANDS = {
    "stroke": ("feltmb.cli.stroke", "Simulate strokes, and save, plot or summarize them."),
    "demo": (
        "feltmb.cli.stroke:demo",
        "Demonstration: piano, forte, staccato; table, plots, animation.",
    ),
    "regulate": (
        "feltmb.cli.technician:regulate",
        "Regulate a mechanism as a technician does, steps A to F.",
    ),
    "sensitivity": (
        "feltmb.cli.sensitivity",
        "Derivatives of a stroke with respect to parameters.",
    ),
    "actuator": ("feltmb.cli.actuator", "The key actuator: simulate, match a finger force."),
    "touch": ("feltmb.cli.technician:touch", "Static and dynamic touch: weights, let-off, timing."),
    "repeat": (
        "feltmb.cli.technician:repeat",
        "Repetition: highest rate up to which every press is a note, and why.",
    ),
    "wear": (
        "feltmb.cli.technician:wear",
        "Wear: each felt, friction and spring changed, against the regulation.",
    ),
    "symptom": (
        "feltmb.cli.technician:symptom",
        "Symptoms, such as blocks: tests, causes and screws.",
    ),
    "keyboard": (
        "feltmb.cli.keyboard",
        "Keyboards: weights of 88 keys, ground truth for hammer and key sensors.",
    ),
    "gap": ("feltmb.cli.gap", "The gap to measurements: where, which cause, how far it shrinks."),
    "fit": (
        "unmodeled.cli.diagnose:fit",
        "Fit a model to measured records: parameters with intervals.",
    ),
    "show": (
        "feltmb.cli.inputs:showing",
        "Bodies, contacts, springs of a mechanism, with units and sources.",
    ),
    "fmu": (
        "feltmb.cli.inputs:fmu",
        "Export a mechanism as a co-simulation unit (FMI 3.0 or 2.0).",
    ),
    "plot": ("feltmb.cli.runs:plot", "Plots of saved runs."),
    "view": ("feltmb.cli.runs:view", "Saved runs in a browser: motion, forces, curves, string."),
    "page": (
        "feltmb.cli.inputs:page",
        "A mechanism as one HTML file that simulates in any browser.",
    ),
    "live": ("feltmb.cli.inputs:live", "Change a mechanism in a browser and see its motion."),
    "animate": ("feltmb.cli.runs:animate", "Animation of a saved run (GIF)."),
    "wav": ("feltmb.cli.runs:wav", "Sound of the string of a saved run (WAV)."),
    "felt": ("feltmb.cli.felt", "Felt: identification, envelopes for the contact law, audit."),
    "fiber": ("feltmb.cli.fiber", "Fiber masses: fits of compression laws, simulation of fibers."),
    "list": (
        "feltmb.cli.inputs:listing",
        "Packaged mechanisms, strokes, actuators, felts, laws, units.",
    ),
    "validate": (
        "feltmb.cli.inputs:validate",
        "Check mechanism, stroke and run files; report all faults.",
    ),
    "new": ("feltmb.cli.inputs:new", "Write a commented template of a mechanism file."),
}

cli = LazyGroup(
    "feltmb",
    listed=COMMANDS,
    params=[version_option("feltmb")],
    context_settings={"help_option_names": ["-h", "--help"]},
    help="""Simulate machines whose parts meet through felt.

    Exit codes: 0 done, 1 failed, 2 bad input, 130 interrupted.
    """,
)


def main(arguments: list[str] | None = None) -> None:
    """Run the command line; no traceback is shown for invalid input."""
    run(cli, arguments, "feltmb")
