#pragma once

#include "feltmb/planar/description.hpp"

namespace feltmb::test {

/// Adds a string before the nose of a hammer: a line at x = 0 of the ground, contact 6 between
/// both, and the string of problem H on the line. `moving`: its strike point follows the contact.
inline void add_struck_string(MechanismDescription& d, const SurfaceDescription& nose,
                              const LawParameters& law, double damping, int modes, bool moving) {
  SurfaceDescription line;
  line.name = "string";
  line.body = "ground";
  line.kind = SurfaceKind::kLine;
  line.normal = {-1.0, 0.0};
  d.surfaces = {line, nose};
  ContactDescription contact;
  contact.number = 6;
  contact.surface_a = "string";
  contact.surface_b = "nose";
  contact.law = law;
  d.contacts.push_back(contact);
  StringDescription string;
  string.surface = "string";
  string.parameters = {0.99e-3, 654.0, 0.6315, 5.98e-3, 2e11, damping, modes};
  string.moving_strike_point = moving;
  string.anchor = string.strike_position = 0.6315 / 8.0;
  d.strings.push_back(string);
}

}  // namespace feltmb::test
