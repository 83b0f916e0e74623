"""Write bench/speed/steinway45.hpp: the packaged mechanism as C++ for the benchmark without Python.

Run it when params/steinway45.toml changes: python tools/make_bench_model.py
A test compares the file with what this script would write.
"""

from __future__ import annotations

from pathlib import Path

import feltmb
from feltmb.mechanism import MechanismFile

HEAD = """// Made by tools/make_bench_model.py from params/steinway45.toml. Do not edit.
// Hash of the parameters: {hash}
// clang-format off
#pragma once

#include <map>

#include "feltmb/contact/felt_layer.hpp"
#include "feltmb/planar/description.hpp"

namespace feltmb::bench {{

/// The packaged action; shank and wire flexible as packaged, or rigid.
inline MechanismDescription steinway45(bool flexible) {{
  MechanismDescription d;
  d.name = "steinway45";
  d.gravity = {gravity};
"""


def number(value: float) -> str:
    """Shortest text that is read back as the same double."""
    return repr(float(value))


def vec(value: tuple[float, ...]) -> str:
    return "{" + ", ".join(number(v) for v in value) + "}"


def friction(f: object) -> str:
    coulomb = (f.amplitude, f.b1, f.b2, f.threshold_speed)
    return "{{" + ", ".join(number(v) for v in coulomb) + "}, {}, {}}"


def body(name: str, b: object) -> str:
    mass, com, inertia = b.mass, b.center_of_mass, b.inertia
    if b.kind == "beam":
        mass = b.density * b.area * b.length
        com, inertia = (0.5 * b.length, 0.0), mass * b.length**2 / 12.0
    text = (
        f'  d.bodies.push_back({{"{name}", "{b.parent}", JointKind::k{b.joint.capitalize()},\n'
        f"                      {vec(b.position)}, {vec(b.axis)}, {number(b.angle)},\n"
        f'                      "{b.coordinate}", {friction(b.friction)}, {number(mass)},\n'
        f"                      {vec(com)}, {number(inertia)}, {{}}}});"
    )
    if b.kind == "beam" and not b.rigid:
        shapes = "".join(part.capitalize() for part in b.shapes.split("_"))
        text += (
            "\n  if (flexible) {\n"
            "    auto& beam = d.bodies.back();\n"
            "    beam.mass = 0.0;\n"
            "    beam.center_of_mass = {};\n"
            "    beam.inertia = 0.0;\n"
            f"    beam.beam = BeamDescription{{{number(b.length)}, {number(b.density * b.area)},\n"
            f"                                {number(b.young_modulus * b.area)},\n"
            f"                                {number(b.young_modulus * b.second_moment)},\n"
            f"                                ShapeSet::k{shapes}, {b.axial_shapes},\n"
            f"                                {b.lateral_shapes}, {number(b.damping_time)},\n"
            f"                                {str(b.condense_axial).lower()}}};\n"
            "  }"
        )
    return text


def surface(name: str, s: object) -> str:
    normal = s.normal if s.normal is not None else (0.0, 1.0)
    arc = s.arc if s.arc is not None else (0.0, 0.0)
    return (
        f'  d.surfaces.push_back({{"{name}", "{s.body}", SurfaceKind::k{s.kind.capitalize()},\n'
        f"                        {vec(s.point)}, {vec(normal)}, {number(s.radius or 0.0)},\n"
        f"                        {{{number(arc[0])}, {number(arc[1])}}}}});"
    )


def curve(c: object) -> str:
    return f"{{{number(c.a)}, {number(c.b)}, {number(c.c)}}}"


def contact(key: str, c: object) -> str:
    form = "kGuarded" if c.law == "guarded" else "kPrinted"
    return (
        f'  d.contacts.push_back({{{int(key)}, "", "{c.surfaces[0]}", "{c.surfaces[1]}",\n'
        f"                        ExponentialPair{{{curve(c.loading)}, {curve(c.unloading)},\n"
        f"                                        {number(c.alpha)},\n"
        f"                                        ExponentialPair::Form::{form}}},\n"
        f"                        {friction(c.friction)}, {str(c.enabled).lower()}}});"
    )


def make(config: MechanismFile, digest: str) -> str:
    out = [HEAD.format(hash=digest[:16], gravity=vec(config.gravity)).rstrip("\n")]
    out += [body(n, b) for n, b in config.bodies.items()]
    out += [surface(n, s) for n, s in config.surfaces.items()]
    out += [contact(k, c) for k, c in config.contacts.items()]
    out += [
        f'  d.springs.push_back({{"{n}", "{s.coordinate}", {number(s.stiffness)}, '
        f"{number(s.rest_angle)}}});"
        for n, s in config.springs.items()
    ]
    out += [
        f'  d.straps.push_back({{"{n}", "{s.body_a}", {vec(s.point_a)}, "{s.body_b}",\n'
        f"                      {vec(s.point_b)}, {number(s.free_length)},\n"
        f"                      {{{number(s.k1)}, {number(s.k2)}, {number(s.k3)}}}}});"
        for n, s in config.straps.items()
    ]
    s = config.string
    out.append(
        f'  d.strings.push_back({{"string", "{s.surface}", false,\n'
        f"                       {{{number(s.diameter)}, {number(s.tension)}, {number(s.length)},\n"
        f"                        {number(s.linear_density)}, {number(s.young_modulus)},\n"
        f"                        {number(s.damping_ratio)}, {s.modes}, {s.count}}},\n"
        f"                       {number(s.anchor)}, {vec(s.direction)}, true, 0.0, {{}}}});"
    )
    f = config.finger
    out.append(
        f'  d.finger = FingerDescription{{"{f.body}", {vec(f.point)}, {vec(f.direction)},\n'
        f"                               HuntCrossley{{{number(f.pad.stiffness)}, "
        f"{number(f.pad.exponent)}, {number(f.pad.damping)}}}}};"
    )
    pairs = ", ".join(f'{{"{k}", {number(v)}}}' for k, v in config.start_pose.items())
    out.append(f"  d.start_pose = {{{pairs}}};")
    out += ["  return d;", "}", ""]
    return "\n".join(out)


def layer(key: str, c: object) -> str:
    p = c.micromechanical
    felt, fiber = p.felt, p.felt.fiber
    kinds = {
        "constant": ("ConstantArea", ("size",)),
        "crossed_cylinders": ("CrossedCylinders", ("radius_a", "radius_b")),
        "circle_on_layer": ("CircleOnLayer", ("radius", "width", "length")),
    }
    kind, names = kinds[p.area.kind]
    numbers = [getattr(p.area, n) for n in names if getattr(p.area, n) is not None]
    area = f"{kind}{{{', '.join(number(x) for x in numbers)}}}"
    return (
        f"  add({int(key)}, {{{number(fiber.friction)}, {number(fiber.withdrawal_force)}, "
        f"{number(fiber.diameter)}, {number(felt.v_f0)}, {number(felt.end)}, {number(fiber.Q)},\n"
        f"          {{{number(felt.loading.K_p)}, {number(felt.loading.gamma)}}}, "
        f"{{{number(felt.unloading.K_p)}, {number(felt.unloading.gamma)}}}}},\n"
        f"      {number(p.thickness)}, {area});"
    )


def make_layers(config: MechanismFile) -> str:
    """The felts of steinway45_felt."""
    rows = [layer(key, c) for key, c in config.contacts.items()]
    return "\n".join(
        [
            "/// Felt of every contact of steinway45_felt, by the number of the contact.",
            "inline std::map<int, FeltLayer> felts() {",
            "  std::map<int, FeltLayer> out;",
            "  const auto add = [&](int number, const FeltMaterial& felt, double thickness,",
            "                       const ContactArea& area) {",
            "    out[number] = {pressure_envelope(felt), thickness, area,",
            "                   LayerCompression::kEven};",
            "  };",
            *rows,
            "  return out;",
            "}",
            "",
            "}  // namespace feltmb::bench",
            "",
        ]
    )


def text() -> str:
    """The whole header."""
    action = feltmb.load_action("steinway45")
    felts = feltmb.load_action("steinway45_felt")
    return make(action.config, action.hash) + "\n" + make_layers(felts.config)


def main() -> None:
    target = Path(__file__).parent.parent / "bench" / "speed" / "steinway45.hpp"
    target.write_text(text())
    print(f"wrote {target.name}")


if __name__ == "__main__":
    main()
