"""The contact time of a felt mallet on a timpano.

The head is an ideal membrane (no air) with the modes J_m(k r) cos(m phi). It is struck at three
quarters of its radius. The mallet is a mass with a contact `felt_memory`. The time integration is
a leapfrog method. On a rigid head, the contact time follows from the energy of the felt alone: T =
integral of de / v(e) for compression and release. On a single slow mode, the two masses act as one
mass m M/(m + M).
"""

import numpy as np
from scipy.special import jn_zeros, jv
from show import Found, show

from feltmb.contact import law
from unmodeled.style import BLUE, GREEN, RED, new_figure, style_axes

RADIUS, TENSION, DENSITY = 0.328, 4000.0, 0.262  # m, N/m, kg/m^2
MASS, SPEED, STRIKE = 0.030, 2.0, 0.75  # kg, m/s, part of the radius
STEP = 2e-6  # s


def mallet():
    """Felt of a soft mallet head: the loop of the front punching of Table A.12, scaled."""
    return law("felt_memory", loading=(9.0e3, 0.9e3, 2.0e3), unloading=(0.5e3, 1.9e3, 1.5e3))


def head(orders=9, roots=6):
    """Angular frequencies [rad/s], and masses at the struck point [kg] of the modes."""
    speed = np.sqrt(TENSION / DENSITY)
    omega, mass = [], []
    for m in range(orders):
        for k in jn_zeros(m, roots):
            shape = jv(m, k * STRIKE)  # at the angle of the impact, where cos(m phi) = 1
            norm = DENSITY * np.pi * RADIUS**2 * jv(m + 1, k) ** 2 / (1.0 if m == 0 else 2.0)
            omega.append(k * speed / RADIUS)
            mass.append(norm / shape**2)
    return np.array(omega), np.array(mass)


def impact(omega, mass, duration=0.03):
    """Mallet and modes in time: time [s], force [N], compression [m], energies [J]."""
    felt = mallet()
    q, p = np.zeros_like(omega), np.zeros_like(omega)  # displacement and rate at the struck point
    x, v, force, work = 0.0, SPEED, 0.0, 0.0
    n = round(duration / STEP)
    out = np.zeros((3, n))
    stiffness = omega**2
    for i in range(n):
        p += STEP * (force / mass - stiffness * q)
        v -= STEP * force / MASS
        before = x - q.sum()
        q += STEP * p
        x += STEP * v
        gap = x - q.sum()
        last, force = force, felt.step(gap, STEP)
        work += 0.5 * (force + last) * (gap - before)
        out[:, i] = force, gap, q.sum()
    # Rates are half a step behind.
    p += 0.5 * STEP * (force / mass - stiffness * q)
    v -= 0.5 * STEP * force / MASS
    energy = {
        "mallet": 0.5 * MASS * v**2,
        "head": float((0.5 * mass * (p**2 + stiffness * q**2)).sum()),
        "felt": work,
    }
    return (np.arange(n) + 1.0) * STEP, out, energy


def touching(time, out):
    """Length of the contact [s]."""
    near = time[out[0] > 0.0]
    return near[-1] - near[0]


def time_by_energy(mass):
    """Length of the impact of a mass on felt that lies still [s], by quadrature of de / v(e)."""
    from scipy.optimize import brentq

    felt = mallet()
    kinetic = 0.5 * mass * SPEED**2
    top = brentq(lambda e: float(felt.core.stored_energy(e)) - kinetic, 1e-6, 2e-2)
    # e = top sin^2 takes the root out of both ends; forces come along the way itself.
    angle = np.linspace(0.0, 0.5 * np.pi, 20001)
    e = top * np.sin(angle) ** 2
    path = felt.path(np.concatenate([e, e[-2::-1]]), np.arange(2 * e.size - 1) * 1e-6)
    total = 0.0
    for force in (path[: e.size], path[e.size - 1 :][::-1]):
        # energy that is missing from here to the turning point
        steps = 0.5 * (force[1:] + force[:-1]) * np.diff(e)
        left = np.concatenate([np.cumsum(steps[::-1])[::-1], [0.0]])
        with np.errstate(divide="ignore", invalid="ignore"):
            integrand = 2 * top * np.sin(angle) * np.cos(angle) / np.sqrt(2 * left / mass)
        integrand[-1] = integrand[-2]
        total += np.trapezoid(integrand, angle)
    return float(total)


def compute() -> Found:
    """The impact on all modes, on a head that does not yield, and on one slow mode."""
    omega, mass = head()
    time, out, energy = impact(omega, mass)
    still = impact(omega[:1], np.array([1e9]), duration=0.015)
    slow = impact(np.array([1e-3]), np.array([0.05]), duration=0.015)
    found = Found("contact time", 1e3 * touching(time, out), "ms")
    found.data.update(time=time, out=out, energy=energy, still=still, omega=omega)
    start = 0.5 * MASS * SPEED**2
    found.check("energies after the impact [J]", sum(energy.values()), start, 1e-4)
    rigid = touching(*still[:2])
    found.check("contact time, rigid head [s]", rigid, time_by_energy(MASS), 2e-3)
    reduced = MASS * 0.05 / (MASS + 0.05)
    found.check(
        "contact time, one slow mode [s]", touching(*slow[:2]), time_by_energy(reduced), 2e-3
    )
    found.check(
        "lowest frequency [Hz]",
        omega[0] / (2 * np.pi),
        0.7655 * np.sqrt(TENSION / DENSITY) / (2 * RADIUS),
        1e-3,
    )
    return found


def draw(found: Found):
    """Force on the head, and where the energy goes."""
    time, out, energy = (found.data[k] for k in ("time", "out", "energy"))
    figure = new_figure(7.0, 3.0)
    left, right = figure.subplots(1, 2, width_ratios=[2, 1])
    still = found.data["still"]
    left.plot(1e3 * time, out[0], color=BLUE, label="timpano")
    left.plot(
        1e3 * still[0], still[1][0], color=RED, linewidth=0.8, label="head that does not yield"
    )
    left.set_xlim(0, 15)
    left.legend(frameon=False, fontsize=8)
    title = f"Felt mallet on a timpano: they touch for {found.value:.1f} ms"
    style_axes(left, "time [ms]", "force [N]", title)
    names = list(energy)
    right.bar(names, [1e3 * energy[n] for n in names], color=[BLUE, GREEN, RED], width=0.6)
    style_axes(right, "", "energy after the impact [mJ]", "Who has the energy")
    return figure


if __name__ == "__main__":
    show(compute, draw)
