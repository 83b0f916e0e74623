"""Down weights of the keys of a grand, by those before; the record runs over the keys."""

from unmodeled import Effect, LinearModel, Parameter

model = LinearModel(
    name="down weight before the change",
    output="down",
    columns={"gain": lambda r: r.inputs["before"]},
    parameters=[Parameter(name="gain", value=1.0, sd=0.02, lower=0.0)],
)


def _of(name, unit, scale, column):
    """An effect that adds its magnitude times a column."""
    return Effect(name=name, component="keys", unit=unit, scale=scale,
                  regressor=lambda record, shape: column(record.inputs))  # fmt: skip


effects = (
    _of("support spring", "N", 0.1, lambda u: -1.0 + 0.0 * u["key"]),
    _of("friction", "1", 0.2, lambda u: u["friction"]),
    _of("strike weight", "1", 0.5, lambda u: u["strike"]),
    _of("front weight", "1", 0.5, lambda u: u["front"]),
    _of("slope along the keyboard", "N", 0.05, lambda u: u["key"] / 44.0 - 1.0),
)
