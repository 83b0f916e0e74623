#include "feltmb/model/channels.hpp"

#include "feltmb/core/index.hpp"

namespace feltmb {
namespace {

using View = ChannelView;

double finger_force(const View& v) {
  const Mechanism& m = v.mechanism();
  const Drive drive = v.system.drive(v.t);
  if (is_of_motor(drive.kind) || m.motor_contact >= 0) {
    return m.motor_contact >= 0 ? v.dynamics().contacts()[as_index(m.motor_contact)].law.force
                                : 0.0;
  }
  if (is_prescribed(drive.kind)) return v.dynamics().prescription().reaction;
  if (drive.kind == InputKind::kMotion) {
    return v.dynamics().contacts()[as_index(m.finger_contact)].law.force;
  }
  return drive.force;
}

double motor_torque(const View& v) {
  const Drive drive = v.system.drive(v.t);
  if (!is_of_motor(drive.kind)) return 0.0;
  return is_prescribed(drive.kind) ? v.dynamics().prescription().reaction : drive.force;
}

double elastic_energy(const View& v) {
  const Mechanism& m = v.mechanism();
  const auto q = v.y.subspan(0, m.coordinates.size());
  double sum = v.dynamics().spring_energy(q);
  for (std::size_t s = 0; s < m.straps.size(); ++s) {
    sum += v.dynamics().strap_energy(static_cast<int>(s));
  }
  for (std::size_t b = 0; b < m.beams.size(); ++b) {
    sum += v.dynamics().beam_energy(static_cast<int>(b), q);
  }
  return sum;
}

double contact_energy(const View& v) {
  const Mechanism& m = v.mechanism();
  double sum = 0.0;
  for (std::size_t c = 0; c < m.contacts.size(); ++c) {
    const ContactState& s = v.dynamics().contacts()[c];
    if (!s.closed && m.contacts[c].law.n_states() == 0) continue;
    sum += m.contacts[c].law.stored_energy(s.closed ? s.compression : 0.0, v.dynamics().memory(c));
  }
  return sum;
}

/// Modal coordinates of a string.
std::span<const double> eta(const View& v, std::size_t string) {
  const AttachedString& a = v.mechanism().strings[string];
  return v.system.parts(v.y).eta.subspan(as_index(a.offset), as_index(a.string.modes()));
}

double string_energy(const View& v) {
  double sum = 0.0;
  for (std::size_t s = 0; s < v.mechanism().strings.size(); ++s) {
    const AttachedString& a = v.mechanism().strings[s];
    const auto rate =
        v.system.parts(v.y).eta_rate.subspan(as_index(a.offset), as_index(a.string.modes()));
    sum += a.string.kinetic_energy(rate) + a.string.elastic_energy(eta(v, s));
  }
  return sum;
}

/// Whether a coordinate is an axial one of a beam that follows statically.
bool is_condensed(const Mechanism& m, std::size_t coordinate) {
  for (const auto& beam : m.beams) {
    const int k = static_cast<int>(coordinate) - beam.first;
    if (beam.condense_axial && k >= 0 && k < beam.shapes.axial()) return true;
  }
  return false;
}

}  // namespace

Channels::Channels(const Mechanism& m) {
  using Value = std::function<double(const View&)>;
  const auto row = [this](std::string name, const char* unit, std::string text, Value value) {
    rows_.push_back({std::move(name), unit, std::move(text), std::move(value), false});
  };
  const auto place = [this](std::string name, const char* unit, std::string text, Value value) {
    rows_.push_back({std::move(name), unit, std::move(text), std::move(value), true});
  };
  for (std::size_t k = 0; k < m.coordinates.size(); ++k) {
    const bool angle = m.coordinate_is_angle[k];
    const char* text = angle ? "angle, counterclockwise positive" : "displacement";
    place(m.coordinates[k], angle ? "rad" : "m", text, [k](const View& v) { return v.q[k]; });
    rows_.back().place = !is_condensed(m, k);
  }
  for (std::size_t k = 0; k < m.coordinates.size(); ++k) {
    const std::size_t i = m.coordinates.size() + k;
    place(m.coordinates[k] + ".rate", m.coordinate_is_angle[k] ? "rad/s" : "m/s", "rate",
          [i](const View& v) { return v.y[i]; });
  }
  for (std::size_t p = 0; p < m.points.size(); ++p) {
    const std::string& name = m.points[p].name;
    const auto position = [p](const View& v) {
      return v.dynamics().position(v.mechanism().points[p].point);
    };
    const auto velocity = [p](const View& v) {
      return v.dynamics().velocity(v.mechanism().points[p].point);
    };
    place(name + ".x", "m", "tracking point, x toward the player",
          [position](const View& v) { return position(v).x; });
    place(name + ".y", "m", "tracking point, y up",
          [position](const View& v) { return position(v).y; });
    place(name + ".vx", "m/s", "tracking point, speed in x",
          [velocity](const View& v) { return velocity(v).x; });
    place(name + ".vy", "m/s", "tracking point, speed in y",
          [velocity](const View& v) { return velocity(v).y; });
  }
  for (std::size_t c = 0; c < m.contacts.size(); ++c) {
    const Contact& contact = m.contacts[c];
    if (contact.finger) continue;
    const std::string what = contact.label.empty() ? contact.name : contact.label;
    const auto state = [c](const View& v) -> const ContactState& {
      return v.dynamics().contacts()[c];
    };
    row(contact.name + ".force", "N", "normal force: " + what,
        [state](const View& v) { return state(v).law.force; });
    row(contact.name + ".compression", "m", "compression, negative is the gap: " + what,
        [state](const View& v) { return state(v).compression; });
    row(contact.name + ".rate", "m/s", "compression rate: " + what,
        [state](const View& v) { return state(v).rate; });
    row(contact.name + ".friction", "N", "friction force: " + what,
        [state](const View& v) { return -state(v).friction.value * state(v).law.force; });
  }
  for (std::size_t s = 0; s < m.straps.size(); ++s) {
    row(m.straps[s].name + ".force", "N", "pull of the strap",
        [s](const View& v) { return v.dynamics().strap_force(static_cast<int>(s)); });
  }
  if (m.finger_contact >= 0) {
    row("finger.force", "N", "force of the finger on the key, positive pressing", finger_force);
    row("finger.displacement", "m",
        "travel of the point under the finger from its rest, positive pressing", [](const View& v) {
          return dot(v.mechanism().finger_direction,
                     v.dynamics().position(v.mechanism().finger_point)) -
                 v.system.finger_reference();
        });
  }
  if (m.motor_coordinate >= 0) {
    row("motor.torque", "N m",
        "torque of the motor along its coordinate; of a prescribed motion its reaction",
        motor_torque);
  }
  for (std::size_t s = 0; s < m.strings.size(); ++s) {
    const std::string& name = m.strings[s].name;
    row(name + ".strike", "m", "string displacement at the strike point, away from the striker",
        [s](const View& v) {
          return v.dynamics()
              .contacts()[as_index(v.mechanism().contacts_of(v.mechanism().strings[s])[0].contact)]
              .string.displacement;
        });
    row(name + ".bridge_force", "N", "transverse force on the end far from the strike point",
        [s](const View& v) { return v.mechanism().strings[s].string.bridge_force(eta(v, s)); });
  }
  // Stored energy comes last: the ledger of a run adds these up.
  row("energy.kinetic", "J", "kinetic energy of the bodies", [](const View& v) {
    const std::size_t n = v.mechanism().coordinates.size();
    return v.dynamics().kinetic_energy(v.y.subspan(n, n));
  });
  row("energy.gravity", "J", "potential energy of gravity, zero at the origin",
      [](const View& v) { return v.dynamics().gravity_energy(); });
  row("energy.elastic", "J", "elastic energy of springs, straps and flexible members",
      elastic_energy);
  row("energy.contact", "J", "energy stored in the contacts (integral of the loading curve)",
      contact_energy);
  row("energy.string", "J", "kinetic and elastic energy of the strings", string_energy);
}

void Channels::observe(MechanismSystem& system, double t, std::span<const double> y,
                       std::span<double> out) const {
  system.evaluate(t, y, Detail::kAllContacts);
  // The first outputs are the coordinates: their deflections are added where they will stand.
  const std::span<double> q = out.subspan(0, system.mechanism().coordinates.size());
  std::copy_n(y.begin(), q.size(), q.begin());
  system.dynamics().add_condensed_deflection(q);
  const ChannelView view{system, t, y, q};
  for (std::size_t i = 0; i < rows_.size(); ++i) out[i] = rows_[i].value(view);
}

void Channels::observe_places(MechanismSystem& system, std::span<const double> y,
                              std::span<double> out) const {
  system.place(y);
  const ChannelView view{system, 0.0, y, y};
  for (std::size_t i = 0; i < rows_.size(); ++i) {
    if (rows_[i].place) out[i] = rows_[i].value(view);
  }
}

}  // namespace feltmb
