"""Friction of the keys of a grand: the same for all keys. One of the first keys may be rough."""

from unmodeled import Effect, LinearModel, Parameter

model = LinearModel(
    name="friction of the keys",
    output="friction",
    columns={"friction": lambda r: 0.0 * r.inputs["key"] + 1.0},
    parameters=[Parameter(name="friction", value=0.1, sd=0.05, unit="N", lower=0.0)],
)


def _of(name, unit, scale, column):
    """An effect that adds its magnitude times a column."""
    return Effect(name=name, component="keys", unit=unit, scale=scale,
                  regressor=lambda record, shape: column(record.inputs))  # fmt: skip


effects = (
    *(_of(f"rough key {k}", "N", 0.05, lambda u, k=k: 1.0 * (u["key"] == k)) for k in range(1, 13)),
    _of("strike weight", "1", 0.5, lambda u: u["strike"]),
    _of("front weight", "1", 0.5, lambda u: u["front"]),
    _of("slope along the keyboard", "N", 0.05, lambda u: u["key"] / 44.0 - 1.0),
)
