#include "feltmb/model/observables.hpp"

#include "feltmb/core/error.hpp"

namespace feltmb {
namespace {

std::size_t at(int i) { return static_cast<std::size_t>(i); }

}  // namespace

std::vector<ObservableInfo> list_observables(const Mechanism& m) {
  std::vector<ObservableInfo> out;
  const auto add = [&](const std::string& name, const char* unit, const std::string& text) {
    out.push_back({name, unit, text});
  };
  for (std::size_t k = 0; k < m.coordinates.size(); ++k) {
    const bool angle = m.coordinate_is_angle[k];
    add(m.coordinates[k], angle ? "rad" : "m",
        angle ? "angle, counterclockwise positive" : "displacement");
  }
  for (std::size_t k = 0; k < m.coordinates.size(); ++k) {
    const bool angle = m.coordinate_is_angle[k];
    add(m.coordinates[k] + ".rate", angle ? "rad/s" : "m/s", "rate");
  }
  for (const auto& p : m.points) {
    add(p.name + ".x", "m", "tracking point, x toward the player");
    add(p.name + ".y", "m", "tracking point, y up");
    add(p.name + ".vx", "m/s", "tracking point, speed in x");
    add(p.name + ".vy", "m/s", "tracking point, speed in y");
  }
  for (const auto& c : m.contacts) {
    if (c.finger) continue;
    const std::string what = c.label.empty() ? c.name : c.label;
    add(c.name + ".force", "N", "normal force: " + what);
    add(c.name + ".compression", "m", "compression, negative is the gap: " + what);
    add(c.name + ".rate", "m/s", "compression rate: " + what);
    add(c.name + ".friction", "N", "friction force: " + what);
  }
  for (const auto& s : m.straps) add(s.name + ".force", "N", "pull of the strap");
  if (m.finger_contact >= 0) {
    add("finger.force", "N", "force of the finger on the key, positive pressing");
    add("finger.displacement", "m",
        "travel of the point under the finger from its rest, positive pressing");
  }
  if (m.motor_coordinate >= 0) {
    add("motor.torque", "N m",
        "torque of the motor along its coordinate; of a prescribed motion its reaction");
  }
  for (const auto& s : m.strings) {
    add(s.name + ".strike", "m", "string displacement at the strike point, away from the striker");
    add(s.name + ".bridge_force", "N", "transverse force on the end far from the strike point");
  }
  add("energy.kinetic", "J", "kinetic energy of the bodies");
  add("energy.gravity", "J", "potential energy of gravity, zero at the origin");
  add("energy.elastic", "J", "elastic energy of springs, straps and flexible members");
  add("energy.contact", "J", "energy stored in the contacts (integral of the loading curve)");
  add("energy.string", "J", "kinetic and elastic energy of the strings");
  return out;
}

void observe(MechanismSystem& system, double t, std::span<const double> y, std::span<double> out) {
  system.evaluate(t, y, Detail::kAllContacts);
  const Mechanism& m = system.mechanism();
  Dynamics& dynamics = system.dynamics();
  const std::size_t n = m.coordinates.size();
  std::size_t i = 0;
  for (std::size_t k = 0; k < 2 * n; ++k) out[i++] = y[k];
  dynamics.add_condensed_deflection(out.subspan(0, n));
  for (const auto& p : m.points) {
    const Vec2 r = dynamics.position(p.point);
    const Vec2 v = dynamics.velocity(p.point);
    out[i++] = r.x;
    out[i++] = r.y;
    out[i++] = v.x;
    out[i++] = v.y;
  }
  double stored = 0.0;
  for (std::size_t c = 0; c < m.contacts.size(); ++c) {
    const ContactState& s = dynamics.contacts()[c];
    if (s.closed || m.contacts[c].law.n_states() > 0) {
      stored += m.contacts[c].law.stored_energy(s.closed ? s.compression : 0.0, dynamics.memory(c));
    }
    if (m.contacts[c].finger) continue;
    out[i++] = s.law.force;
    out[i++] = s.compression;
    out[i++] = s.rate;
    out[i++] = -s.friction.value * s.law.force;
  }
  double elastic = dynamics.spring_energy(y.subspan(0, n));
  for (std::size_t s = 0; s < m.straps.size(); ++s) {
    out[i++] = dynamics.strap_force(static_cast<int>(s));
    elastic += dynamics.strap_energy(static_cast<int>(s));
  }
  if (m.finger_contact >= 0) {
    const Drive drive = system.drive(t);
    double force = drive.force;
    if (drive.coordinate >= 0 || m.motor_contact >= 0) {
      force = m.motor_contact >= 0 ? dynamics.contacts()[at(m.motor_contact)].law.force : 0.0;
    } else if (drive.prescribed) {
      force = dynamics.prescription().reaction;
    } else if (drive.motion) {
      force = dynamics.contacts()[at(m.finger_contact)].law.force;
    }
    out[i++] = force;
    out[i++] =
        dot(m.finger_direction, dynamics.position(m.finger_point)) - system.finger_reference();
  }
  if (m.motor_coordinate >= 0) {
    const Drive drive = system.drive(t);
    out[i++] = drive.coordinate < 0 ? 0.0
               : drive.prescribed   ? dynamics.prescription().reaction
                                    : drive.force;
  }
  for (std::size_t b = 0; b < m.beams.size(); ++b) {
    elastic += dynamics.beam_energy(static_cast<int>(b), y.subspan(0, n));
  }
  double string_energy = 0.0;
  for (std::size_t s = 0; s < m.strings.size(); ++s) {
    const auto& a = m.strings[s];
    const auto count = at(a.string.modes());
    const MechanicalState parts = system.parts(y);
    const auto eta = parts.eta.subspan(at(a.offset), count);
    const auto rate = parts.eta_rate.subspan(at(a.offset), count);
    out[i++] = dynamics.contacts()[at(a.contact)].string.displacement;
    out[i++] = a.string.bridge_force(eta);
    string_energy += a.string.kinetic_energy(rate) + a.string.elastic_energy(eta);
  }
  out[i++] = dynamics.kinetic_energy(y.subspan(n, n));
  out[i++] = dynamics.gravity_energy();
  out[i++] = elastic;
  out[i++] = stored;
  out[i++] = string_energy;
}

bool is_place(const Mechanism& m, int output) {
  const int n = static_cast<int>(m.coordinates.size());
  for (const auto& beam : m.beams) {
    const int k = output - beam.first;
    if (beam.condense_axial && k >= 0 && k < beam.shapes.axial()) return false;
  }
  return output < 2 * n + 4 * static_cast<int>(m.points.size());
}

void observe_places(MechanismSystem& system, std::span<const double> y, std::span<double> out) {
  system.place(y);
  const Mechanism& m = system.mechanism();
  std::size_t i = 0;
  for (; i < 2 * m.coordinates.size(); ++i) out[i] = y[i];
  for (const auto& p : m.points) {
    const Vec2 r = system.dynamics().position(p.point);
    const Vec2 v = system.dynamics().velocity(p.point);
    out[i++] = r.x;
    out[i++] = r.y;
    out[i++] = v.x;
    out[i++] = v.y;
  }
}

}  // namespace feltmb
