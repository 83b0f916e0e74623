"""A felt from a compression test with scatter: the interval contains the true value.

The test of the tutorial (examples/tutorial) was simulated with the packaged felt a12_06, so the
true values are known. The friction is removed first. Then the elastic law of both branches is
fitted.
"""

from pathlib import Path

import numpy as np
from show import Found, show

from feltmb import felt, fiber
from unmodeled.style import BLUE, RED, new_figure, style_axes

DATA = Path(__file__).resolve().parents[1] / "tutorial"


def compute() -> Found:
    """Identify both branches."""
    fibers = felt.load_material(DATA / "fibers.toml")
    test = fiber.read_compression(
        DATA / "hammer_felt_test.csv", v_f0=fibers.v_f0, thickness0=6e-3, area=4e-4
    )
    result = felt.identify(test, material=fibers)
    truth = felt.load_material("a12_06")
    found = Found("contact length gamma, loading", result.loading.gamma, "fiber diameters")
    found.data.update(test=test, result=result, truth=truth)
    for branch, known in ((result.loading, truth.loading), (result.unloading, truth.unloading)):
        low, high = branch.interval["gamma"]
        half = 0.5 * (high - low) / known.gamma
        found.check(f"gamma, {branch.which}", branch.gamma, known.gamma, half)
    found.check("loss of the loop", result.material.loss(), truth.loss(), 0.01)
    return found


def draw(found: Found):
    """Test and felt."""
    test, result = found.data["test"], found.data["result"]
    figure = new_figure(5.5, 3.4)
    ax = figure.subplots()
    ax.plot(test.v_f, 1e-6 * test.pressure, ".", color="#999999", markersize=3, label="test")
    v = np.linspace(result.material.v_f0, result.material.end, 200)
    for which, color in (("loading", BLUE), ("unloading", RED)):
        pressure = result.material.pressure(which, v)
        ax.plot(v, 1e-6 * pressure, color=color, linewidth=1, label=which)
    ax.legend(frameon=False, fontsize=8)
    title = (
        f"gamma = {found.value:.3f}; the test was made with {found.data['truth'].loading.gamma:.3f}"
    )
    style_axes(ax, "volume fraction [-]", "pressure [MPa]", title)
    return figure


if __name__ == "__main__":
    show(compute, draw)
