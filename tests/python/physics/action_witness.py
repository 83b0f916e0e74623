"""Independent witness for the planar rigid model of an upright piano action.

The model is the action `steinway45` of the thesis, chapter 4.1 and Appendix A, with the repairs
and the regulation of the design note on the action. The equations of motion come from a Lagrangian
written in SymPy, one open tree at a time; every generalized force comes from virtual work, with
the partial derivatives of gap functions and material points taken by complex-step differentiation.

All quantities are in SI units. Frames: origin at the balance pin, x toward the player, y up,
angles counterclockwise positive. Coordinates q = [Y_key, theta_k, theta_w, theta_j, theta_h,
theta_d], the jack angle being relative to the whippen (eq. 4.8, reordered).
"""

from __future__ import annotations

import copy
import functools
from dataclasses import dataclass, field

import numpy as np
import sympy as sp
from scipy.optimize import minimize_scalar, root

COORDINATES = (
    "key.lift",
    "key.angle",
    "whippen.angle",
    "jack.angle",
    "hammer.angle",
    "damper.angle",
)
GRAVITY = 9.81
MM = 1e-3

# Which coordinates move which independent tree (Figure 4.3).
TREES = {
    "key": (0, 1),
    "whippen": (2, 3),
    "hammer": (4,),
    "damper": (5,),
}

# Table A.1: mass (kg), moment of inertia about the mass center (kg mm^2), mass center (mm).
MASS_TABLE = {
    "key": (0.1176, 1741.0, (-46.3, 13.10)),
    "whippen": (0.9506e-2, 20.94, (29.30, 7.10)),
    "jack": (0.2883e-2, 1.892, (1.20, 25.60)),
    "backcheck": (0.1921e-2, 0.176, (-14.0, -1.4)),
    "butt": (7.58e-3, 2.70, (12.7, 13.4)),
    "head": (7.8e-3, 3.10, (0.0, 36.9)),
    "damper": (0.1318e-1, 56.68, (-4.90, 39.8)),
}

# Table A.2: mass density (kg/m^3), length (mm), area (mm^2).
ROD_TABLE = {
    "shank": (701.18, 93.0, 25.51),
    "wire": (7830.0, 66.1, 6.38),
}

# Pins and welds (mm), Tables A.3, A.5, A.8.
JOINT_TABLE = {
    "Gp4": (-178.0, 48.9),
    "Gp5": (-196.0, 129.0),
    "Gp7": (-173.0, 131.0),
    "Wp4": (53.1, 3.7),
    "Wp5": (33.8, 14.5),
    "Hbp2": (3.1, 32.0),
}
WIRE_ANGLE_DEG = 75.5  # regulation C
LET_OFF_LOWERING = 0.40  # mm, regulation E, contact 5
FRONT_RAIL_RAISE = 1.306  # mm, regulation A, contact 2

# Shapes (mm, rad): Tables A.3 to A.11 with the repairs. (body, kind, point, extra data)
SHAPE_TABLE = {
    "Gp2": ("ground", "circle", (-139.0, -388.0), 382.0),
    "Gp3": ("ground", "circle", (218.0, -40.7), 38.0),
    "Gp6": ("ground", "line", (-223.0, 327.0), (0.9999, 0.0106)),
    "Gp8": ("ground", "circle", (3.0, 151.0), 142.0),
    "Gp9": ("ground", "line", (-222.0, 232.0), (0.9999, 0.0106)),
    "Gp10": ("ground", "line", (-133.0, 77.4), (-0.0726, -0.9974)),
    "Gp11": ("ground", "circle", (-113.0, 112.0), 30.7),
    "Kp2": ("key", "circle", (-141.0, 32.6), 7.9),
    "Kp3": ("key", "line", (-149.0, 0.0), (0.0, -1.0)),
    "Kp4": ("key", "line", (217.0, 0.2859), (0.0, -1.0)),
    "Wp2": ("whippen", "line", (35.9, -11.2), (0.0, -1.0)),
    "Wp3": ("whippen", "circle", (-7.9, 29.6), 4.8),
    "Bcp2": ("backcheck", "concave", (-19.1, -88.7), 81.0),
    "Jp2": ("jack", "hybrid", (-3.1, 68.5), (1.0, 1.620, 3.148)),
    "Jp3": ("jack", "circle", (13.1, 5.4), 4.0),
    "Jp4": ("jack", "circle", (-3.1, 68.5), 1.0),
    "Jp5": ("jack", "line", (2.4, 51.4), (0.9996, 0.0272)),
    "Hbp4": ("butt", "circle", (9.5, 13.2), 9.2),
    "Hbp5": ("butt", "line", (12.6, 3.0), (0.9948, 0.1016)),
    "Hbp6": ("butt", "circle", (44.8, 15.6), 5.1),
    "Hbp7": ("butt", "circle", (49.2, 21.7), 0.5),
    "Hbp8": ("butt", "circle", (48.9, 27.9), 0.5),
    "Hp2": ("head", "circle", (-2.8, 52.8), 12.3),
    "Hsp3": ("shank", "line", (62.1, -2.8), (0.0, -1.0)),
    "Dp2": ("damper", "line", (6.4, -51.0), (0.9974, 0.0723)),
    "Dp3": ("damper", "circle", (13.6, 104.1), 43.9),
}

# Table A.12 (contact 4 repaired to Hbp4): pair, loading (a, b, c), unloading (a, b, c) of eq. 4.21;
# Table A.13: friction constants (A, B1, B2) of eq. A.1.
CONTACT_TABLE = {
    1: ("Gp2", "Kp3", (5.52e3, 1.58e3, -0.60e3), (0.19e3, 5.04e3, 3.04e3), (0.0, 0.0, 0.0)),
    2: ("Gp3", "Kp4", (2.63e3, 1.36e3, 0.80e3), (0.78e1, 0.36e3, 0.21e3), (0.0, 0.0, 0.0)),
    3: ("Kp2", "Wp2", (2.70e4, 1.15e3, -2.24e4), (0.42e3, 5.25e3, 2.74e3), (0.332, 0.73, 1.0)),
    4: ("Hbp4", "Jp2", (1.70e4, 1.56e4, -4.87e3), (0.18e3, 4.32e4, 1.53e4), (0.332, 0.73, 1.0)),
    5: ("Jp3", "Gp10", (2.62e3, 2.96e3, -1.15e3), (0.03e3, 7.99e3, 2.48e3), (0.434, 1.78, 1.0)),
    6: ("Hp2", "Gp6", (2.35e4, 1.74e3, -2.41e4), (2.00e3, 4.52e3, -0.82e3), (0.434, 1.78, 1.0)),
    7: ("Gp8", "Hsp3", (0.14e3, 0.73e3, 0.18e3), (0.28e1, 1.61e3, 0.26e3), (0.0, 0.0, 0.0)),
    8: ("Bcp2", "Hbp6", (2.42e3, 1.59e3, -1.16e3), (0.12e3, 3.62e3, 1.36e3), (1.085, 1.78, 1.0)),
    9: ("Wp3", "Dp2", (7.08e4, 0.10e3, -7.03e4), (5.49e3, 0.94e3, -6.38e3), (0.332, 0.73, 1.0)),
    10: ("Dp3", "Gp9", (0.28e3, 1.00e3, 0.22e3), (0.95e1, 2.30e3, 0.33e3), (0.0, 0.0, 0.0)),
    11: ("Jp4", "Hbp5", (0.44e3, 1.63e3, 0.50e3), (0.01e3, 3.55e3, 0.80e3), (0.434, 1.78, 1.0)),
    12: ("Gp11", "Jp5", (0.47e3, 1.23e3, -0.09e3), (0.03e3, 2.77e3, 0.24e3), (0.0, 0.0, 0.0)),
    13: ("Bcp2", "Hbp8", (2.62e3, 1.84e3, -2.37e3), (0.12e3, 4.13e3, 1.12e3), (1.085, 1.78, 1.0)),
    14: ("Bcp2", "Hbp7", (2.62e3, 1.84e3, -2.37e3), (0.12e3, 4.13e3, 1.12e3), (1.085, 1.78, 1.0)),
    15: ("pin", "pin", (2.70e4, 2.64e3, -22.71e3), (3.07e3, 6.23e3, -2.96e3), (0.0, 0.0, 0.0)),
}

# Table A.14: amplitude A (N m; N for the key lift) and threshold rate (rad/s; m/s), by coordinate.
JOINT_FRICTION = (
    (0.0664, 1e-5),
    (0.0079, 1e-4),
    (7.94e-4, 1e-4),
    (0.000397, 1e-4),
    (0.0025, 1e-4),
    (0.0049, 1e-4),
)

# Table A.15: coordinate index -> (K in N m/rad, theta_0 in rad).
SPRINGS = {3: (0.0069, 0.40), 4: (0.98e-3, -2.8), 5: (0.0574, 0.70)}

STRAP_LENGTH = 45.5 * MM
STRAP_WHIPPEN = ("whippen", (69.8, 47.3))  # Wp6, Table A.5
STRAP_BUTT = ("butt", (40.2, 11.2))  # Hbp3, Table A.8
FINGER_POINT = ("key", (225.0, 25.1))  # Kp5, Table A.4

ALPHA = 100.0  # s/m, eq. 4.22, value of the design note
SLIP_THRESHOLD = 1e-3  # m/s, v_t of eq. A.1, value of the design note
EXPONENT_LIMIT = 40.0

REST_POSE = np.array([-7.8236e-5, 0.0409638, -0.0850183, 0.2848430, -0.4714884, -0.0358386])
"""Rest pose of the regulated action, static equilibrium, as stated by the design note."""

STEP = 1e-30  # complex step


@dataclass(frozen=True)
class Parameters:
    """Numbers of one action in SI units (Tables A.1 to A.15)."""

    masses: dict
    rods: dict
    joints: dict
    wire_angle: float
    shapes: dict
    contacts: dict = field(default_factory=lambda: copy.deepcopy(CONTACT_TABLE))


def _unit(vector):
    """Normal vector of a table scaled to unit length (printed ones are unit to 1e-4)."""
    vector = np.asarray(vector, dtype=float)
    return vector / np.sqrt(vector @ vector)


def make_parameters(regulated: bool = True, unit_normals: bool = True) -> Parameters:
    """Return the parameters in SI units.

    Source: Tables A.1 to A.13. With `regulated`, the positions of the front rail circle Gp3
    and of the let-off button Gp10 are those of the regulation; else they are the printed ones.
    `unit_normals` scales printed normals to unit length.
    """
    masses = {
        body: (mass, inertia * MM**2, np.array(center) * MM)
        for body, (mass, inertia, center) in MASS_TABLE.items()
    }
    rods = {
        body: (density * area * MM**2 * length * MM, length * MM)
        for body, (density, length, area) in ROD_TABLE.items()
    }
    joints = {name: np.array(point) * MM for name, point in JOINT_TABLE.items()}
    shapes = {}
    for name, (body, kind, point, extra) in SHAPE_TABLE.items():
        position = np.array(point, dtype=float)
        if regulated and name == "Gp3":
            position[1] += FRONT_RAIL_RAISE
        if regulated and name == "Gp10":
            position[1] -= LET_OFF_LOWERING
        if kind == "line":
            data = _unit(extra) if unit_normals else np.array(extra)
        elif kind == "hybrid":
            data = (extra[0] * MM, extra[1], extra[2])
        else:
            data = extra * MM
        shapes[name] = (body, kind, position * MM, data)
    return Parameters(masses, rods, joints, np.deg2rad(WIRE_ANGLE_DEG), shapes)


# --------------------------------------------------------------------------------------
# SymPy: frames, Lagrangian
# --------------------------------------------------------------------------------------


def _translation(x, y):
    return sp.Matrix([[1, 0, x], [0, 1, y], [0, 0, 1]])


def _rotation(angle):
    c, s = sp.cos(angle), sp.sin(angle)
    return sp.Matrix([[c, -s, 0], [s, c, 0], [0, 0, 1]])


def _frames(parameters: Parameters, q):
    """Return homogeneous transforms of every body frame and the body angles.

    Source: Figure 4.2 and the frame conventions of the design note (shank turned +90 deg on
    the butt, head not turned on the shank, backcheck turned 180 deg on the wire).
    """
    lift, theta_k, theta_w, theta_j, theta_h, theta_d = q
    joint = {name: tuple(float(v) for v in p) for name, p in parameters.joints.items()}
    shank_length = parameters.rods["shank"][1]
    wire_length = parameters.rods["wire"][1]

    frames, angles = {}, {}
    frames["key"] = _translation(0, lift) * _rotation(theta_k)
    angles["key"] = theta_k
    frames["whippen"] = _translation(*joint["Gp4"]) * _rotation(theta_w)
    angles["whippen"] = theta_w
    frames["jack"] = frames["whippen"] * _translation(*joint["Wp5"]) * _rotation(theta_j)
    angles["jack"] = theta_w + theta_j
    wire_turn = sp.Float(parameters.wire_angle, 20)
    frames["wire"] = frames["whippen"] * _translation(*joint["Wp4"]) * _rotation(wire_turn)
    angles["wire"] = theta_w + wire_turn
    frames["backcheck"] = frames["wire"] * _translation(wire_length, 0) * _rotation(sp.pi)
    angles["backcheck"] = theta_w + wire_turn + sp.pi
    frames["butt"] = _translation(*joint["Gp7"]) * _rotation(theta_h)
    angles["butt"] = theta_h
    frames["shank"] = frames["butt"] * _translation(*joint["Hbp2"]) * _rotation(sp.pi / 2)
    angles["shank"] = theta_h + sp.pi / 2
    frames["head"] = frames["shank"] * _translation(shank_length, 0)
    angles["head"] = theta_h + sp.pi / 2
    frames["damper"] = _translation(*joint["Gp5"]) * _rotation(theta_d)
    angles["damper"] = theta_d
    return frames, angles


TREE_BODIES = {
    "key": ("key",),
    "whippen": ("whippen", "wire", "backcheck", "jack"),
    "hammer": ("butt", "shank", "head"),
    "damper": ("damper",),
}


class Model:
    """Symbolic model of the action turned into NumPy functions.

    Attributes are callables: `mass_matrix(q)`, `quadratic(q, qd)` (the vector h in
    M qdd + h = Q), `gravity(q)` (the generalized gravity force -dV/dq), `kinetic(q, qd)`,
    `potential(q)` and `poses(q)` (body -> x, y, cos, sin; accepts complex arrays).
    """

    def __init__(self, parameters: Parameters):
        """Derive the equations of motion and turn them into NumPy functions."""
        self.parameters = parameters
        q = sp.symbols("q0:6", real=True)
        qd = sp.symbols("w0:6", real=True)
        frames, angles = _frames(parameters, q)
        origin = sp.Matrix([0, 0, 1])

        mass = sp.zeros(6, 6)
        quadratic = [sp.Integer(0)] * 6
        gravity = [sp.Integer(0)] * 6
        kinetic_sum, potential_sum = sp.Integer(0), sp.Integer(0)
        for tree, indices in TREES.items():
            kinetic, potential = self._energies(tree, indices, frames, angles, q, qd)
            kinetic_sum += kinetic
            potential_sum += potential
            momenta = [sp.diff(kinetic, qd[i]) for i in indices]
            # Lagrange: d/dt(dT/dqd) - dT/dq + dV/dq = Q, the first term by the chain rule.
            for i, momentum in zip(indices, momenta, strict=True):
                for j in indices:
                    mass[i, j] = sp.diff(momentum, qd[j])
                drift = sum(sp.diff(momentum, q[j]) * qd[j] for j in indices)
                quadratic[i] = drift - sp.diff(kinetic, q[i])
                gravity[i] = -sp.diff(potential, q[i])

        self._mass = sp.lambdify((q,), mass, "numpy", cse=True)
        self._quadratic = sp.lambdify((q, qd), quadratic, "numpy", cse=True)
        self._gravity = sp.lambdify((q,), gravity, "numpy", cse=True)
        self._kinetic = sp.lambdify((q, qd), kinetic_sum, "numpy", cse=True)
        self._potential = sp.lambdify((q,), potential_sum, "numpy", cse=True)
        self._bodies = tuple(frames)
        flat = []
        for frame in frames.values():
            position = frame * origin
            flat += [position[0], position[1], frame[0, 0], frame[1, 0]]
        self._poses = sp.lambdify((q,), flat, "numpy", cse=True)

    def _energies(self, tree, indices, frames, angles, q, qd):
        """Kinetic and potential energy of one tree (T = sum m v^2/2 + I w^2/2, V = sum m g y).

        Rods: mass density * area * length, inertia m L^2/12 about the midpoint (Table A.2).
        """
        kinetic, potential = sp.Integer(0), sp.Integer(0)
        for body in TREE_BODIES[tree]:
            if body in self.parameters.rods:
                mass, length = self.parameters.rods[body]
                inertia = mass * length**2 / 12
                center = (length / 2, 0.0)
            else:
                mass, inertia, center = self.parameters.masses[body]
            place = frames[body] * sp.Matrix([float(center[0]), float(center[1]), 1])
            velocity = [sum(sp.diff(place[k], q[i]) * qd[i] for i in indices) for k in (0, 1)]
            spin = sum(sp.diff(angles[body], q[i]) * qd[i] for i in indices)
            half = sp.Rational(1, 2)
            kinetic += (
                half * mass * (velocity[0] ** 2 + velocity[1] ** 2) + half * inertia * spin**2
            )
            potential += mass * GRAVITY * place[1]
        return kinetic, potential

    def mass_matrix(self, q):
        """Mass matrix M of eq. 4.6, the Hessian of T with respect to the rates."""
        return np.array(self._mass(q))

    def quadratic(self, q, qd):
        """Quadratic velocity terms h of M qdd + h = Q (eq. 4.6)."""
        return np.array(self._quadratic(q, qd))

    def gravity(self, q):
        """Generalized gravity force -dV/dq."""
        return np.array(self._gravity(q))

    def kinetic(self, q, qd):
        """Kinetic energy T."""
        return self._kinetic(q, qd)

    def potential(self, q):
        """Gravity potential V (springs not included)."""
        return self._potential(q)

    def poses(self, q):
        """Return {body: (x, y, cos, sin)}; `q` may hold complex arrays."""
        flat = self._poses(q)
        poses = {body: tuple(flat[4 * k : 4 * k + 4]) for k, body in enumerate(self._bodies)}
        poses["ground"] = (0.0, 0.0, 1.0, 0.0)
        return poses


@functools.cache
def default_model() -> Model:
    """Model of the regulated action."""
    return Model(make_parameters())


@functools.cache
def bare_model() -> Model:
    """Model of the repaired tables before regulation of Gp3 and Gp10."""
    return Model(make_parameters(regulated=False))


# --------------------------------------------------------------------------------------
# Constitutive laws
# --------------------------------------------------------------------------------------


def curve(compression: float, constants) -> float:
    """Force of eq. 4.21, F = a e exp(b e) + c e, the exponential continued linearly beyond 40."""
    a, b, c = constants
    exponent = b * compression
    if exponent > EXPONENT_LIMIT:
        growth = np.exp(EXPONENT_LIMIT) * (1.0 + exponent - EXPONENT_LIMIT)
    else:
        growth = np.exp(exponent)
    return a * compression * growth + c * compression


def contact_force(compression, rate, loading, unloading, law="guarded") -> float:
    """Normal force of eq. 4.22 from the curves of eq. 4.21.

    `printed` takes the curves literally. `guarded` uses max(F_L, 0) and F_U clamped to
    0 <= F_U <= F_L. No force for compression <= 0.
    """
    if compression <= 0.0:
        return 0.0
    load = curve(compression, loading)
    unload = curve(compression, unloading)
    if law == "guarded":
        load = max(load, 0.0)
        unload = min(max(unload, 0.0), load)
    elif law != "printed":
        raise ValueError(f"unknown contact law {law!r}")
    if rate >= 0.0:
        return load
    return load + (load - unload) * np.tanh(ALPHA * rate)


def friction_coefficient(slip: float, constants) -> float:
    """Signed friction coefficient of eq. A.1, with the sliding speed as argument."""
    a, b1, b2 = constants
    x = slip / SLIP_THRESHOLD
    return a * (np.tanh(x) + b1 * x / (1.0 + b2 * x**4))


def strap_force(elongation: float) -> float:
    """Tension of the bridle strap, eq. 4.5 with K of Appendix A.4, never negative."""
    if elongation <= 0.0:
        return 0.0
    stiffness = 3.47e7 * elongation**2 + 1.84e5 * elongation - 63.45
    return max(stiffness * elongation, 0.0)


# --------------------------------------------------------------------------------------
# Gap functions (complex-safe)
# --------------------------------------------------------------------------------------


def _place(pose, point):
    """World position of a body-fixed point."""
    x, y, c, s = pose
    return x + c * point[0] - s * point[1], y + s * point[0] + c * point[1]


def _turn(pose, vector):
    """World direction of a body-fixed vector."""
    _, _, c, s = pose
    return c * vector[0] - s * vector[1], s * vector[0] + c * vector[1]


def _norm(vector):
    """Euclidean length, analytic in both components."""
    return np.sqrt(vector[0] * vector[0] + vector[1] * vector[1])


def _first_real(value):
    return float(np.real(np.ravel(value)[0]))


@dataclass
class Gap:
    """Geometry of one contact: compression, unit normal out of the second shape, contact point.

    `normal` is the direction in which the plain circle is pushed. `region` names the part of
    the other shape that is met (`arc`, `top`, `side` for the hybrid).
    """

    compression: object
    normal: tuple
    point: tuple
    circle_body: str
    other_body: str
    region: str


def _line_height(center, foot, normal):
    """Signed height of a point over a line (positive out of the material)."""
    return (center[0] - foot[0]) * normal[0] + (center[1] - foot[1]) * normal[1]


def contact_gap(model: Model, number: int, poses, lift) -> Gap:
    """Compression of one contact (Table 4.2, geometry of the design note, section 1).

    Line and circle: r - n.(c - p). Hybrid and circle: the same against one of the two tangent
    lines, or r1 + r2 - |c1 - c2| against the arc. Concave and circle: |c - C| + r - R.
    Contact 15: -Y_key, vertical, at the pin. The contact point is the middle of the overlap.
    """
    if number == 15:
        return Gap(-lift, (0.0, 1.0), (0.0 * lift, lift / 2), "key", "ground", "pin")
    shapes = model.parameters.shapes
    first, second = (shapes[name] for name in model.parameters.contacts[number][:2])
    circle, other = (first, second) if first[1] == "circle" else (second, first)
    circle_body, _, circle_point, radius = circle
    other_body, kind, other_point, data = other
    center = _place(poses[circle_body], circle_point)
    anchor = _place(poses[other_body], other_point)
    other_pose = poses[other_body]

    region = kind
    if kind == "line":
        normal = _turn(other_pose, data)
        compression = radius - _line_height(center, anchor, normal)
    elif kind == "concave":
        offset = (center[0] - anchor[0], center[1] - anchor[1])
        distance = _norm(offset)
        compression = distance + radius - data
        normal = (-offset[0] / distance, -offset[1] / distance)
    elif kind == "hybrid":
        arc_radius, start, end = data
        offset = (center[0] - anchor[0], center[1] - anchor[1])
        top = _turn(other_pose, (np.cos(start), np.sin(start)))
        side = _turn(other_pose, (np.cos(end), np.sin(end)))
        region = _hybrid_region(offset, top, side)
        if region == "arc":
            distance = _norm(offset)
            compression = radius + arc_radius - distance
            normal = (offset[0] / distance, offset[1] / distance)
        else:
            normal = top if region == "top" else side
            height = offset[0] * normal[0] + offset[1] * normal[1] - arc_radius
            compression = radius - height
    else:
        raise ValueError(kind)
    # Deepest point of the circle is center - radius * normal; the other surface lies
    # `compression` further along the normal; halfway between the two:
    reach = radius - compression / 2
    point = (center[0] - reach * normal[0], center[1] - reach * normal[1])
    return Gap(compression, normal, point, circle_body, other_body, region)


def _hybrid_region(offset, top, side):
    """Part of the hybrid nearest to a circle center at `offset` from the arc center.

    `top` and `side` are the outward normals at the start and the end of the arc; the tangent
    half-lines leave the arc along `top` turned by -90 deg and `side` turned by +90 deg.
    """
    dx, dy = (_first_real(v) for v in offset)
    nx1, ny1 = (_first_real(v) for v in top)
    nx2, ny2 = (_first_real(v) for v in side)
    along_top = dx * ny1 - dy * nx1
    along_side = -dx * ny2 + dy * nx2
    if along_top <= 0.0 and along_side <= 0.0:
        return "arc"
    if along_side <= 0.0:
        return "top"
    if along_top <= 0.0:
        return "side"
    return "top" if dx * nx1 + dy * ny1 >= dx * nx2 + dy * ny2 else "side"


def compressions(q, model: Model | None = None) -> dict[int, float]:
    """Signed compression of every contact (negative: gap)."""
    model = model or default_model()
    q = np.asarray(q, dtype=float)
    poses = model.poses(q)
    return {
        number: float(contact_gap(model, number, poses, q[0]).compression)
        for number in model.parameters.contacts
    }


def hybrid_region(q, model: Model | None = None) -> str:
    """Part of the jack top met by the butt (contact 4): `arc`, `top` or `side`."""
    model = model or default_model()
    return contact_gap(model, 4, model.poses(np.asarray(q, dtype=float)), q[0]).region


# --------------------------------------------------------------------------------------
# Evaluation
# --------------------------------------------------------------------------------------


@dataclass
class Evaluation:
    """Result of `evaluate`.

    `force` is the right-hand side of M qdd = force (eq. 4.6); `contributions` maps the names
    gravity, quadratic, normal.N, friction.N, springs, strap, joint_friction, finger to their
    generalized forces, which add up to `force`.
    """

    mass_matrix: np.ndarray
    force: np.ndarray
    acceleration: np.ndarray
    contacts: dict
    contributions: dict
    strap_tension: float

    def scale(self) -> np.ndarray:
        """Largest absolute contribution to each coordinate."""
        return np.max(np.abs(list(self.contributions.values())), axis=0)


def _jacobian(value):
    """Row of partial derivatives of a complex-stepped quantity with respect to q."""
    return np.imag(np.broadcast_to(value, (6,))) / STEP


def _real_pose(pose):
    return tuple(_first_real(v) for v in pose)


def _material_jacobian(pose, point):
    """Partial derivatives of the world position of the material point now at `point`."""
    x, y, c, s = _real_pose(pose)
    dx, dy = point[0] - x, point[1] - y
    local = (c * dx + s * dy, -s * dx + c * dy)
    world = _place(pose, local)
    return np.array([_jacobian(world[0]), _jacobian(world[1])])


def evaluate(q, qd, finger_force=0.0, law="guarded", model: Model | None = None) -> Evaluation:
    """Evaluate eq. 4.6 of the rigid action.

    The force of a contact on the coordinates is -F_n d(compression)/dq and
    -f d(slip speed)/d(qd), with F_n of eq. 4.22 and f = mu F_n, mu of eq. A.1. The slip speed is
    the velocity of the plain circle's body minus that of the other body at the contact point,
    along the normal (which points to the circle) turned by +90 deg; f has the sign of the slip.
    Springs: -K (theta - theta_0), Table A.15. Joint friction: -A tanh(rate / threshold),
    Table A.14. Finger force: vertical at Kp5, positive down.
    """
    model = model or default_model()
    q = np.asarray(q, dtype=float)
    qd = np.asarray(qd, dtype=float)
    stepped = q[:, None] + 1j * STEP * np.eye(6)
    poses = model.poses(stepped)

    contributions = {
        "gravity": model.gravity(q),
        "quadratic": -model.quadratic(q, qd),
    }
    contacts = {}
    for number, (_, _, loading, unloading, friction) in model.parameters.contacts.items():
        gap = contact_gap(model, number, poses, stepped[0])
        compression = _first_real(gap.compression)
        gradient = _jacobian(gap.compression)
        rate = float(gradient @ qd)
        force = contact_force(compression, rate, loading, unloading, law)
        point = (_first_real(gap.point[0]), _first_real(gap.point[1]))
        normal = (_first_real(gap.normal[0]), _first_real(gap.normal[1]))
        tangent = np.array([-normal[1], normal[0]])
        relative = _material_jacobian(poses[gap.circle_body], point)
        relative = relative - _material_jacobian(poses[gap.other_body], point)
        slip_gradient = tangent @ relative
        slip = float(slip_gradient @ qd)
        drag = friction_coefficient(slip, friction) * force
        contributions[f"normal.{number}"] = -force * gradient
        contributions[f"friction.{number}"] = -drag * slip_gradient
        contacts[number] = {
            "compression": compression,
            "rate": rate,
            "normal_force": float(force),
            "slip_speed": slip,
            "friction_force": float(drag),
            "x": point[0],
            "y": point[1],
        }

    springs = np.zeros(6)
    for index, (stiffness, neutral) in SPRINGS.items():
        springs[index] = -stiffness * (q[index] - neutral)
    contributions["springs"] = springs

    ends = [
        _place(poses[body], np.array(point) * MM) for body, point in (STRAP_WHIPPEN, STRAP_BUTT)
    ]
    span = _norm((ends[0][0] - ends[1][0], ends[0][1] - ends[1][1]))
    tension = strap_force(_first_real(span) - STRAP_LENGTH)
    contributions["strap"] = -tension * _jacobian(span)

    contributions["joint_friction"] = np.array(
        [-a * np.tanh(rate / limit) for (a, limit), rate in zip(JOINT_FRICTION, qd, strict=True)]
    )
    fingertip = _place(poses[FINGER_POINT[0]], np.array(FINGER_POINT[1]) * MM)
    contributions["finger"] = -finger_force * _jacobian(fingertip[1])

    mass = model.mass_matrix(q)
    total = np.sum(list(contributions.values()), axis=0)
    return Evaluation(mass, total, np.linalg.solve(mass, total), contacts, contributions, tension)


def spring_energy(q) -> float:
    """Energy of the torsion springs of Table A.15, K (theta - theta_0)^2 / 2 each."""
    return sum(0.5 * k * (q[i] - neutral) ** 2 for i, (k, neutral) in SPRINGS.items())


def equilibrium(guess, finger_force=0.0, model: Model | None = None) -> np.ndarray:
    """Pose at which the generalized force vanishes with all rates zero (loading curves)."""
    model = model or default_model()
    scale = np.array([1e-5, 1e-4, 1e-4, 1e-3, 1e-4, 1e-4])
    guess = np.asarray(guess, dtype=float)

    def residual(x):
        return evaluate(guess + scale * x, np.zeros(6), finger_force, model=model).force

    solution = root(residual, np.zeros(6), method="hybr", options={"xtol": 1e-14})
    return guess + scale * solution.x


def hammer_gap(q, model: Model | None = None) -> float:
    """Distance of the hammer felt from the string line, minus the compression of contact 6."""
    return -compressions(q, model)[6]


def pose_with(targets: dict[int, float], guess, model: Model | None = None, steps=60):
    """Pose near `guess` at which the contacts in `targets` have the given compressions.

    Gauss-Newton steps of minimum norm (weights: 1 mm of lift to 0.02 rad). Fewer targets than
    coordinates leave the remaining motion where it was.
    """
    model = model or default_model()
    q = np.array(guess, dtype=float)
    weight = np.array([1e-3, 0.02, 0.02, 0.02, 0.02, 0.02])
    for _ in range(steps):
        stepped = q[:, None] + 1j * STEP * np.eye(6)
        poses = model.poses(stepped)
        miss, rows = [], []
        for number, wanted in targets.items():
            gap = contact_gap(model, number, poses, stepped[0])
            miss.append(wanted - _first_real(gap.compression))
            rows.append(_jacobian(gap.compression) * weight)
        change = np.linalg.lstsq(np.array(rows), np.array(miss), rcond=1e-9)[0]
        change *= min(1.0, 3.0 / max(np.max(np.abs(change)), 1e-300))
        q = q + weight * change
        if np.max(np.abs(miss)) < 1e-13:
            break
    return q


# --------------------------------------------------------------------------------------
# Brute-force geometry: sampled boundary curves, no distance formula
# --------------------------------------------------------------------------------------


def chained_pose(body: str, q, parameters: Parameters | None = None) -> tuple[complex, complex]:
    """Origin and unit direction of a body frame in complex numbers, z = origin + direction * p.

    A second route to the frames, separate from the SymPy transforms.
    """
    p = parameters or make_parameters()
    joint = {name: complex(*point) for name, point in p.joints.items()}
    lift, theta_k, theta_w, theta_j, theta_h, theta_d = (float(v) for v in q)
    whippen = np.exp(1j * theta_w)
    butt = np.exp(1j * theta_h)
    wire = whippen * np.exp(1j * p.wire_angle)
    wire_base = joint["Gp4"] + whippen * joint["Wp4"]
    shank_base = joint["Gp7"] + butt * joint["Hbp2"]
    table = {
        "ground": (0j, 1 + 0j),
        "key": (1j * lift, np.exp(1j * theta_k)),
        "whippen": (joint["Gp4"], whippen),
        "jack": (joint["Gp4"] + whippen * joint["Wp5"], whippen * np.exp(1j * theta_j)),
        "wire": (wire_base, wire),
        "backcheck": (wire_base + wire * p.rods["wire"][1], -wire),
        "butt": (joint["Gp7"], butt),
        "shank": (shank_base, 1j * butt),
        "head": (shank_base + 1j * butt * p.rods["shank"][1], 1j * butt),
        "damper": (joint["Gp5"], np.exp(1j * theta_d)),
    }
    return table[body]


def boundary_curve(name: str, q, parameters: Parameters | None = None):
    """Return (curve, low, high): world boundary of a shape as a function of one parameter.

    The curve is traversed so that the material lies on the left of the direction of travel.
    Circle: angle. Line: arc length, +-1 m. Hybrid: arc length along top line, arc, side line.
    """
    p = parameters or make_parameters()
    body, kind, point, data = p.shapes[name]
    origin, direction = chained_pose(body, q, p)
    local = complex(*point)

    def line(base, normal):
        return lambda s: base + 1j * normal * s

    if kind == "circle":
        shape, low, high = (lambda s: local + data * np.exp(1j * s)), 0.0, 2 * np.pi
    elif kind == "concave":
        shape, low, high = (lambda s: local + data * np.exp(-1j * s)), 0.0, 2 * np.pi
    elif kind == "line":
        shape, low, high = line(local, complex(*data)), -1.0, 1.0
    else:
        radius, start, end = data
        length = radius * (end - start)
        first, last = np.exp(1j * start), np.exp(1j * end)

        def shape(s):
            s = np.asarray(s, dtype=float)
            angle = start + np.clip(s, 0.0, length) / radius
            overshoot = np.where(s > length, s - length, 0.0) * 1j * last
            undershoot = np.where(s < 0.0, s, 0.0) * 1j * first
            return local + radius * np.exp(1j * angle) + overshoot + undershoot

        low, high = -0.1, 0.1
    return (lambda s: origin + direction * shape(s)), low, high


def brute_force_compression(q, number: int, parameters: Parameters | None = None) -> float:
    """Compression of one of the contacts 1 to 14 by searching over boundary points.

    The signed distance of a point from the non-circular shape is the smallest distance to its
    sampled and refined boundary, negative on the material side (left of the direction of travel,
    found from a finite difference of the curve). The compression is minus the smallest signed
    distance over the boundary points of the circle.
    """
    p = parameters or make_parameters()
    first, second = p.contacts[number][:2]
    if p.shapes[first][1] != "circle":
        first, second = second, first
    circle, circle_low, circle_high = boundary_curve(first, q, p)
    other, low, high = boundary_curve(second, q, p)

    grid = np.linspace(low, high, 4001)
    step = grid[1] - grid[0]
    samples = other(grid)

    def signed_distance(point):
        nearest = grid[np.argmin(np.abs(samples - point))]
        span = (nearest - step, nearest + step)
        found = minimize_scalar(
            lambda t: abs(other(t) - point) ** 2,
            bounds=span,
            method="bounded",
            options={"xatol": 1e-13},
        )
        t = found.x
        travel = other(t + 1e-7) - other(t - 1e-7)
        outward = (np.conj(travel) * (point - other(t))).imag < 0.0
        return np.sqrt(found.fun) * (1.0 if outward else -1.0)

    angles = np.linspace(circle_low, circle_high, 721)
    coarse = [signed_distance(circle(a)) for a in angles[:-1:8]]
    best = angles[:-1:8][int(np.argmin(coarse))]
    width = 8 * (angles[1] - angles[0])
    found = minimize_scalar(
        lambda a: signed_distance(circle(a)),
        bounds=(best - width, best + width),
        method="bounded",
        options={"xatol": 1e-10},
    )
    return -min(found.fun, min(coarse))
