"""Independent witness for planar trees of rigid bodies and flexible beams.

Lagrange's equations in SymPy of any tree of bodies joined by pins, slides and welds, in which some
bodies are Euler-Bernoulli beams along their x axis, clamped at their origin. With
u(x) = sum U_k(x) u_k and v(x) = sum V_k(x) v_k a point (x, y) of a cross section lies at
(x + u, v) + R(v') (0, y) in the clamped frame: the section turns by the linear angle v', has no
rotary inertia, and the beam does not shorten. The kinetic energy
T = rho A/2 int |d/dt (x + u, v)|^2 dx and the strain energy int (E A u'^2 + E I v''^2)/2 dx are
integrated over the beam by SymPy (polynomials) or mpmath (vibration modes).

`default_action` is the upright action of the thesis with flexible wire and shank (eqs 4.1-4.9,
Table A.2). Contacts, friction and straps come from the rigid witness, here on deformed geometry.
Closed forms of clamped beams with a tip body are at the end. All quantities are in SI units.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass, field

import action_witness as aw
import mpmath
import numpy as np
import sympy as sp
from scipy.optimize import brentq

S = sp.Symbol("s", real=True)  # x/L
DIGITS = 30


# --------------------------------------------------------------------------------------
# Shapes
# --------------------------------------------------------------------------------------


def clamped_free_roots(count: int) -> list:
    """Roots of cos(b) cosh(b) = -1 to 30 digits."""
    with mpmath.workdps(DIGITS):
        return [
            mpmath.findroot(
                lambda b: mpmath.cos(b) + 1 / mpmath.cosh(b), (k - 0.5) * mpmath.pi + 0.3 * (k == 1)
            )
            for k in range(1, count + 1)
        ]


def shapes(kind: str, axial: int, lateral: int) -> tuple[list, list]:
    """Axial and lateral shapes as SymPy expressions of s = x/L, all coordinates lengths.

    polynomial: s^k and s^(k+1) (eqs 4.1-4.4, scaled by powers of L). clamped_free:
    (-1)^(k+1) sin((2k - 1) pi s/2) and modes with cos(b) cosh(b) = -1, scaled to 1 at the tip.
    craig_bampton: s, sin(k pi s); 3 s^2 - 2 s^3, s^3 - s^2 (no more than two lateral ones here).
    """
    if kind == "polynomial":
        return [S**k for k in range(1, axial + 1)], [S ** (k + 1) for k in range(1, lateral + 1)]
    if kind == "craig_bampton":
        assert lateral == 2
        modes = [sp.sin(k * sp.pi * S) for k in range(1, axial)]
        return [S, *modes][:axial], [3 * S**2 - 2 * S**3, S**3 - S**2]
    assert kind == "clamped_free"
    bending = []
    for root in clamped_free_roots(lateral):
        b = sp.Float(str(root), DIGITS)
        ratio = (sp.cosh(b) + sp.cos(b)) / (sp.sinh(b) + sp.sin(b))
        mode = sp.cosh(b * S) - sp.cos(b * S) - ratio * (sp.sinh(b * S) - sp.sin(b * S))
        bending.append(mode / mode.subs(S, 1))
    axials = [(-1) ** (k + 1) * sp.sin((2 * k - 1) * sp.pi * S / 2) for k in range(1, axial + 1)]
    return axials, bending


def integral(expression) -> sp.Expr:
    """Integral over s from 0 to 1: exact for polynomials, else by Gauss points to 17 digits.

    Vibration modes are small differences of large hyperbolic functions: 30 digits are left with 17.
    """
    if expression.is_polynomial(S):
        return sp.integrate(expression, (S, 0, 1))
    with mpmath.workdps(DIGITS):
        curve = sp.lambdify(S, expression, "mpmath")
        return sp.Float(str(mpmath.quad(curve, [0, 1], method="gauss-legendre")), 17)


@dataclass(frozen=True)
class Beam:
    """Uniform beam: length, mass per length, E A, E I, beta of the damping -beta K de/dt."""

    length: float
    linear_density: float
    axial_stiffness: float
    bending_stiffness: float
    kind: str = "polynomial"
    axial: int = 1
    lateral: int = 2
    damping_time: float = 0.0


@dataclass(frozen=True)
class Body:
    """Rigid body or beam and its joint; positions in the frame of the parent."""

    parent: str = "ground"
    joint: str = "weld"
    coordinate: str = ""
    position: tuple = (0.0, 0.0)
    angle: object = 0.0
    mass: float = 0.0
    center: tuple = (0.0, 0.0)
    inertia: float = 0.0
    beam: Beam | None = None


# --------------------------------------------------------------------------------------
# Lagrange's equations of a tree
# --------------------------------------------------------------------------------------


def _shift(x, y):
    return sp.Matrix([[1, 0, x], [0, 1, y], [0, 0, 1]])


def _turn(angle):
    c, s = sp.cos(angle), sp.sin(angle)
    return sp.Matrix([[c, -s, 0], [s, c, 0], [0, 0, 1]])


class Tree:
    """Symbolic equations of motion of a tree, M qdd + h = -dV/dq, as NumPy functions.

    `coordinates` fixes the order; the elastic ones of a beam are NAME.u1.., NAME.v1.. . `sections`
    names places of beams, (beam, x), whose frames are wanted for contacts.
    """

    def __init__(self, bodies: dict, coordinates, gravity=(0.0, -aw.GRAVITY), sections=()):
        """Write T and V, differentiate, and turn the result into functions."""
        self.bodies = bodies
        self.coordinates = tuple(coordinates)
        n = len(self.coordinates)
        self.q = sp.symbols(f"q0:{n}", real=True)
        self.qd = sp.symbols(f"w0:{n}", real=True)
        self._symbol = dict(zip(self.coordinates, self.q, strict=True))
        self._frames = {"ground": (sp.eye(3), sp.Integer(0))}
        self._shapes = {
            name: shapes(b.beam.kind, b.beam.axial, b.beam.lateral)
            for name, b in bodies.items()
            if b.beam is not None
        }
        self._hessian = {}
        potential = strain = sp.Integer(0)
        for name, body in bodies.items():
            self._place(name, body)
            v, e = self._add_energies(name, body, gravity)
            potential += v
            strain += e
        self._compile(potential, strain)
        self.damping = np.zeros((n, n))
        for name, body in bodies.items():
            if body.beam is not None:
                index = [i for i, c in enumerate(self.coordinates) if self._of(name, c)]
                block = np.ix_(index, index)
                self.damping[block] = body.beam.damping_time * self.stiffness[block]
        self._tabulate(sections)

    @staticmethod
    def _of(name, coordinate):
        """Whether a coordinate is an elastic one of the beam `name`."""
        owner, _, part = coordinate.rpartition(".")
        return owner == name and part[:1] in "uv" and part[1:].isdigit()

    def _elastic(self, name):
        """Symbols of the axial and lateral coordinates of a beam."""
        beam = self.bodies[name].beam
        return (
            [self._symbol[f"{name}.u{k}"] for k in range(1, beam.axial + 1)],
            [self._symbol[f"{name}.v{k}"] for k in range(1, beam.lateral + 1)],
        )

    def section(self, name, x):
        """Frame and angle of the cross section of a body at x: (x + u, v), turned by v'."""
        frame, angle = self._frames[name]
        if name not in self._shapes:
            return frame * _shift(x, 0), angle
        length = self.bodies[name].beam.length
        axial, lateral = self._shapes[name]
        us, vs = self._elastic(name)
        station = sp.Float(x / length, 17)
        if abs(x / length - 1.0) < 1e-15:
            station = sp.Integer(1)
        u = sum(f.subs(S, station) * c for f, c in zip(axial, us, strict=True))
        v = sum(f.subs(S, station) * c for f, c in zip(lateral, vs, strict=True))
        slope = sum(
            f.diff(S).subs(S, station) / length * c for f, c in zip(lateral, vs, strict=True)
        )
        return frame * _shift(x + u, v) * _turn(slope), angle + slope

    def _place(self, name, body):
        """Frame of a body from that of its parent."""
        x, y = (float(v) for v in body.position)
        frame, angle = self.section(body.parent, x)
        frame = frame * _shift(0, y)
        if body.joint == "prismatic":
            frame = frame * _shift(0, self._symbol[body.coordinate])
            turn = body.angle
        elif body.joint == "revolute":
            turn = body.angle + self._symbol[body.coordinate]
        else:
            turn = body.angle
        self._frames[name] = (frame * _turn(turn), angle + turn)

    def _columns(self, expressions):
        """Partial derivatives of d/dt(expressions) with respect to the rates, column by column.

        d/dt f(q) = sum df/dq_i qd_i, so these are df/dq_i.
        """
        return [[sp.diff(f, c) for f in expressions] for c in self.q]

    def _add_kinetic(self, columns, weight):
        """Add to M the Hessian of weight |rate|^2/2 in the rates, by columns of the rate."""
        moving = [i for i, column in enumerate(columns) if any(f != 0 for f in column)]
        for i in moving:
            for j in moving:
                if j <= i:
                    self._hessian.setdefault((i, j), []).append(
                        weight * sum(f * g for f, g in zip(columns[i], columns[j], strict=True))
                    )

    def _add_energies(self, name, body, gravity):
        """Add T, and return gravity potential and strain energy, of one body.

        A beam's centerline is linear in the functions b = (1, s, U_k, V_k): r = sum b_i p_i(q), so
        T = rho A L/2 sum_ij (int b_i b_j ds) dp_i/dt . dp_j/dt.
        """
        frame, angle = self._frames[name]
        g = [sp.Float(c) if c else sp.Integer(0) for c in gravity]
        potential = strain = sp.Integer(0)
        if body.mass or body.inertia:
            place = frame * sp.Matrix([float(body.center[0]), float(body.center[1]), 1])
            self._add_kinetic(self._columns([place[0], place[1]]), body.mass)
            self._add_kinetic(self._columns([angle]), body.inertia)
            potential -= body.mass * (g[0] * place[0] + g[1] * place[1])
        if body.beam is not None:
            beam = body.beam
            axial, lateral = self._shapes[name]
            us, vs = self._elastic(name)
            functions = [sp.Integer(1), S, *axial, *lateral]
            places = [frame[:2, 2], frame[:2, 0] * beam.length]
            places += [frame[:2, 0] * c for c in us] + [frame[:2, 1] * c for c in vs]
            columns = [self._columns(list(p)) for p in places]
            mass = sp.Float(beam.linear_density * beam.length, 17)
            gram = [[integral(sp.expand(f * h)) for h in functions] for f in functions]
            for i, p in enumerate(places):
                potential -= mass * gram[0][i] * (g[0] * p[0] + g[1] * p[1])
            n = len(self.q)
            for i in range(n):
                for j in range(i + 1):
                    terms = [
                        gram[a][b] * (columns[a][i][k] * columns[b][j][k])
                        for a in range(len(places))
                        for b in range(len(places))
                        for k in (0, 1)
                        if columns[a][i][k] != 0 and columns[b][j][k] != 0
                    ]
                    if terms:
                        self._hessian.setdefault((i, j), []).append(mass * sp.Add(*terms))
            strain += self._strain(axial, us, 1, beam.axial_stiffness / beam.length)
            strain += self._strain(lateral, vs, 2, beam.bending_stiffness / beam.length**3)
        return potential, strain

    @staticmethod
    def _strain(functions, coordinates, order, stiffness):
        """Strain energy stiffness/2 int (d^order sum f_k c_k/ds^order)^2 ds."""
        total = sp.Integer(0)
        for first, c in zip(functions, coordinates, strict=True):
            for second, d in zip(functions, coordinates, strict=True):
                weight = integral(sp.expand(first.diff(S, order) * second.diff(S, order)))
                total += sp.Rational(1, 2) * stiffness * weight * c * d
        return total

    def _compile(self, potential, strain):
        """Functions of M, -dV/dq and the elastic stiffness."""
        self._entries = tuple(self._hessian)
        values = [sp.Add(*terms) for terms in self._hessian.values()]
        self._mass = sp.lambdify((self.q,), values, "numpy", cse=True)
        downhill = [-sp.diff(potential, c) for c in self.q]
        self._gravity = sp.lambdify((self.q,), downhill, "numpy", cse=True)
        self.stiffness = np.array(sp.hessian(strain, self.q).evalf(), dtype=float)

    def _mass_table(self, q):
        """M for one or (last axis) many poses, real or complex."""
        n = len(self.q)
        tail = np.shape(q)[1:]
        table = np.zeros((n, n, *tail), dtype=np.asarray(q).dtype)
        for (i, j), value in zip(self._entries, self._mass(q), strict=True):
            table[i, j] = value
            table[j, i] = value
        return table

    def _quadratic(self, q, qd):
        """Terms h of Lagrange's equations: d/dt(dT/dqd) - dT/dq = M qdd + h, T = qd' M qd/2.

        h = (sum_k dM/dq_k qd_k) qd - (qd' dM/dq_i qd)/2; dM/dq by complex steps, which are exact.
        """
        n = len(q)
        slopes = np.imag(self._mass_table(q[:, None] + 1j * aw.STEP * np.eye(n))) / aw.STEP
        moving = np.einsum("ijk,k,j->i", slopes, qd, qd)
        return moving - 0.5 * np.einsum("ijk,i,j->k", slopes, qd, qd)

    def _tabulate(self, sections):
        """Frames as functions: (x, y, cos, sin) of every body, and of the named sections.

        A section's entry is the frame that a rigid body would have that carries the section, so
        that points given in the frame of the undeformed beam are placed by it.
        """
        origin = sp.Matrix([0, 0, 1])
        frames = {name: frame for name, (frame, _) in self._frames.items() if name != "ground"}
        for name, x in sections:
            frames[name] = self.section(name, x)[0] * _shift(-x, 0)
        self._names = tuple(frames)
        flat = []
        for frame in frames.values():
            place = frame * origin
            flat += [place[0], place[1], frame[0, 0], frame[1, 0]]
        self._poses = sp.lambdify((self.q,), flat, "numpy", cse=True)

    def mass_matrix(self, q):
        """Mass matrix M(q), the Hessian of T in the rates."""
        return self._mass_table(q)

    def contributions(self, q, qd) -> dict[str, np.ndarray]:
        """Generalized forces of gravity, the quadratic velocity terms, elasticity and damping."""
        return {
            "gravity": np.array(self._gravity(q), dtype=float),
            "quadratic": -self._quadratic(q, qd),
            "elastic": -self.stiffness @ q,
            "damping": -self.damping @ qd,
        }

    def poses(self, q):
        """{body: (x, y, cos, sin)}; `q` may hold complex arrays."""
        flat = self._poses(q)
        poses = {name: tuple(flat[4 * k : 4 * k + 4]) for k, name in enumerate(self._names)}
        poses["ground"] = (0.0, 0.0, 1.0, 0.0)
        return poses


# --------------------------------------------------------------------------------------
# The upright action with flexible wire and shank
# --------------------------------------------------------------------------------------

COORDINATES = (
    *aw.COORDINATES,
    *(f"{beam}.{part}" for beam in ("wire", "shank") for part in ("u1", "v1", "v2")),
)
RIGID = len(aw.COORDINATES)

# Table A.2: Young's modulus (Pa); round sections of the printed area (design note): A^2/(4 pi).
YOUNG = {"wire": 60.933e9, "shank": 12.618e9}
SECOND_MOMENT = {"wire": 3.23915e-12, "shank": 51.7858e-12}
REST_RAIL_STATION = ("shank", 62.1 * aw.MM)  # Hsp3, Table A.11, contact 7


def _action_bodies(parameters: aw.Parameters) -> dict:
    """Bodies of Tables A.1 to A.11 (frames as in the design note, section 1)."""
    beams = {}
    for name, (density, length, area) in aw.ROD_TABLE.items():
        section = area * aw.MM**2
        beams[name] = Beam(
            length * aw.MM,
            density * section,
            YOUNG[name] * section,
            YOUNG[name] * SECOND_MOMENT[name],
        )

    def solid(name):
        mass, inertia, center = parameters.masses[name]
        return {"mass": mass, "inertia": inertia, "center": tuple(center)}

    def pin(parent, joint, coordinate):
        place = tuple(parameters.joints[joint]) if joint else (0.0, 0.0)
        return {
            "parent": parent,
            "joint": "revolute",
            "coordinate": coordinate,
            "position": place,
        }

    joints = parameters.joints
    turn = sp.Float(parameters.wire_angle, 20)
    return {
        "slider": Body(joint="prismatic", coordinate="key.lift"),
        "key": Body(**pin("slider", None, "key.angle"), **solid("key")),
        "whippen": Body(**pin("ground", "Gp4", "whippen.angle"), **solid("whippen")),
        "jack": Body(**pin("whippen", "Wp5", "jack.angle"), **solid("jack")),
        "butt": Body(**pin("ground", "Gp7", "hammer.angle"), **solid("butt")),
        "damper": Body(**pin("ground", "Gp5", "damper.angle"), **solid("damper")),
        "wire": Body("whippen", position=tuple(joints["Wp4"]), angle=turn, beam=beams["wire"]),
        "backcheck": Body(
            "wire", position=(beams["wire"].length, 0.0), angle=sp.pi, **solid("backcheck")
        ),
        "shank": Body("butt", position=tuple(joints["Hbp2"]), angle=sp.pi / 2, beam=beams["shank"]),
        "head": Body("shank", position=(beams["shank"].length, 0.0), **solid("head")),
    }


@dataclass
class Action:
    """The flexible action: a tree, and the tables of contacts in `parameters`."""

    tree: Tree
    parameters: aw.Parameters = field(default_factory=aw.make_parameters)


@functools.cache
def default_action() -> Action:
    """Flexible action `steinway45` with the regulation of the design note."""
    parameters = aw.make_parameters()
    bodies = _action_bodies(parameters)
    return Action(Tree(bodies, COORDINATES, sections=(REST_RAIL_STATION,)), parameters)


def _stepped(q):
    return q[:, None] + 1j * aw.STEP * np.eye(len(q))


def _gradient(value, n):
    """Partial derivatives of a complex-stepped quantity."""
    return np.imag(np.broadcast_to(value, (n,))) / aw.STEP


def _real(value):
    return float(np.real(np.ravel(value)[0]))


def _material_gradient(pose, point, n):
    """Partial derivatives of the position of the material (of a section) now at `point`."""
    x, y, c, s = (_real(v) for v in pose)
    dx, dy = point[0] - x, point[1] - y
    px, py, pc, ps = pose
    local = (c * dx + s * dy, -s * dx + c * dy)
    world = (px + pc * local[0] - ps * local[1], py + ps * local[0] + pc * local[1])
    return np.array([_gradient(world[0], n), _gradient(world[1], n)])


def compressions(q) -> dict[int, float]:
    """Signed compression of every contact of the deformed action (negative: gap)."""
    action = default_action()
    poses = action.tree.poses(q)
    return {
        number: float(aw.contact_gap(action, number, poses, q[0]).compression)
        for number in action.parameters.contacts
    }


def pose_with(targets: dict[int, float], guess, steps=60):
    """Pose near `guess` at which contacts have given compressions, elastic coordinates held.

    Gauss-Newton steps of minimum norm in the rigid coordinates, as in the rigid witness.
    """
    action = default_action()
    q = np.array(guess, dtype=float)
    weight = np.array([1e-3, 0.02, 0.02, 0.02, 0.02, 0.02])
    for _ in range(steps):
        stepped = _stepped(q)
        poses = action.tree.poses(stepped)
        miss, rows = [], []
        for number, wanted in targets.items():
            gap = aw.contact_gap(action, number, poses, stepped[0])
            miss.append(wanted - _real(gap.compression))
            rows.append(_gradient(gap.compression, len(q))[:RIGID] * weight)
        change = np.linalg.lstsq(np.array(rows), np.array(miss), rcond=1e-9)[0]
        change *= min(1.0, 3.0 / max(np.max(np.abs(change)), 1e-300))
        q[:RIGID] += weight * change
        if np.max(np.abs(miss)) < 1e-13:
            break
    return q


def evaluate(q, qd, finger_force=0.0, law="guarded") -> aw.Evaluation:
    """Evaluate eq. 4.6 of the flexible action; forces as in the rigid witness.

    Normal force -F_n d(compression)/dq; friction -mu F_n d(slip)/d(qd), the slip between the two
    materials at the contact point, each moving with its body or its cross section.
    """
    action = default_action()
    tree, parameters = action.tree, action.parameters
    q, qd = np.asarray(q, dtype=float), np.asarray(qd, dtype=float)
    n = len(q)
    stepped = _stepped(q)
    poses = tree.poses(stepped)
    contributions = tree.contributions(q, qd)
    contacts = {}
    for number, (_, _, loading, unloading, friction) in parameters.contacts.items():
        gap = aw.contact_gap(action, number, poses, stepped[0])
        compression = _real(gap.compression)
        gradient = _gradient(gap.compression, n)
        rate = float(gradient @ qd)
        force = aw.contact_force(compression, rate, loading, unloading, law)
        point = (_real(gap.point[0]), _real(gap.point[1]))
        tangent = np.array([-_real(gap.normal[1]), _real(gap.normal[0])])
        relative = _material_gradient(poses[gap.circle_body], point, n)
        relative = relative - _material_gradient(poses[gap.other_body], point, n)
        slip_gradient = tangent @ relative
        slip = float(slip_gradient @ qd)
        drag = aw.friction_coefficient(slip, friction) * force
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

    springs = np.zeros(n)
    for index, (stiffness, neutral) in aw.SPRINGS.items():
        springs[index] = -stiffness * (q[index] - neutral)
    contributions["springs"] = springs

    ends = []
    for body, point in (aw.STRAP_WHIPPEN, aw.STRAP_BUTT):
        x, y, c, s = poses[body]
        px, py = (v * aw.MM for v in point)
        ends.append((x + c * px - s * py, y + s * px + c * py))
    dx, dy = ends[0][0] - ends[1][0], ends[0][1] - ends[1][1]
    span = np.sqrt(dx * dx + dy * dy)
    tension = aw.strap_force(_real(span) - aw.STRAP_LENGTH)
    contributions["strap"] = -tension * _gradient(span, n)

    contributions["joint_friction"] = np.zeros(n)
    for k, (amplitude, limit) in enumerate(aw.JOINT_FRICTION):
        contributions["joint_friction"][k] = -amplitude * np.tanh(qd[k] / limit)
    x, y, c, s = poses[aw.FINGER_POINT[0]]
    px, py = (v * aw.MM for v in aw.FINGER_POINT[1])
    contributions["finger"] = -finger_force * _gradient(y + s * px + c * py, n)

    mass = tree.mass_matrix(q)
    total = np.sum(list(contributions.values()), axis=0)
    return aw.Evaluation(
        mass, total, np.linalg.solve(mass, total), contacts, contributions, tension
    )


# --------------------------------------------------------------------------------------
# Closed forms: clamped beam with a tip body
# --------------------------------------------------------------------------------------


@dataclass(frozen=True)
class TipBody:
    """Body at the end of a beam: mass, inertia about its center, center (a, b) from the end."""

    mass: float
    inertia: float
    center: tuple = (0.0, 0.0)


def _tip_determinant(omega: float, beam: Beam, tip: TipBody, part: str) -> float:
    """Determinant of the boundary conditions at the end of a clamped beam in harmonic motion.

    Field: v = A (cosh kx - cos kx) + B (sinh kx - sin kx) with k^4 = rho A omega^2/(E I) and
    u = C sin(kappa x) with kappa^2 = rho omega^2/E. Newton and Euler for the tip body with its
    center at (a, b), displaced by (u - b v', v + a v'):
    E A u' = m omega^2 (u - b v');  E I v''' = -m omega^2 (v + a v');
    E I v'' = omega^2 [J v' + m a (v + a v') - m b (u - b v')].
    """
    a, b = tip.center
    k = (beam.linear_density * omega**2 / beam.bending_stiffness) ** 0.25
    z = k * beam.length
    grow = np.exp(z)  # scales both columns
    c, s = np.cosh(z) / grow, np.sinh(z) / grow
    p, r = np.cos(z) / grow, np.sin(z) / grow
    # rows: v, v', v'', v''' for A and B
    first = np.array([c - p, k * (s + r), k**2 * (c + p), k**3 * (s - r)])
    second = np.array([s - r, k * (c - p), k**2 * (s + r), k**3 * (c + p)])
    kappa = omega * np.sqrt(beam.linear_density / beam.axial_stiffness)
    axial = np.array([np.sin(kappa * beam.length), kappa * np.cos(kappa * beam.length)])
    inertial = tip.mass * omega**2

    def lateral(column):
        v, slope, curvature, third = column
        shear = beam.bending_stiffness * third + inertial * (v + a * slope)
        moment = beam.bending_stiffness * curvature - omega**2 * (
            tip.inertia * slope + tip.mass * a * (v + a * slope) + tip.mass * b * b * slope
        )
        return shear, moment, inertial * b * slope

    f, g = lateral(first), lateral(second)
    pull = beam.axial_stiffness * axial[1] - inertial * axial[0]
    if part == "axial":
        return pull
    if part == "lateral":
        return f[0] * g[1] - f[1] * g[0]
    table = np.array(
        [
            [f[0], g[0], 0.0],
            [f[1], g[1], inertial * b * axial[0]],
            [f[2], g[2], pull],
        ]
    )
    table = table / np.max(np.abs(table), axis=1, keepdims=True)
    return float(np.linalg.det(table))


def tip_frequencies(beam: Beam, tip: TipBody, count: int, part: str = "both") -> np.ndarray:
    """Lowest angular frequencies of a clamped beam with a tip body, from the exact field.

    `part`: lateral or axial (center on the axis, b = 0), or both coupled (`both`).
    """
    found = []
    fine = 0.002 * np.sqrt(beam.bending_stiffness / beam.linear_density) / beam.length**2
    if part == "axial":
        fine = 0.01 * np.sqrt(beam.axial_stiffness / beam.linear_density) / beam.length

    def miss(omega):
        return _tip_determinant(omega, beam, tip, part)

    low, value = fine, miss(fine)
    while len(found) < count:
        high = low * 1.002 + fine
        step = miss(high)
        if value * step < 0.0:
            found.append(brentq(miss, low, high, xtol=1e-13 * high, rtol=1e-14))
        low, value = high, step
    return np.array(found)
