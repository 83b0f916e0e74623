#include <algorithm>
#include <cmath>

#include "assembler.hpp"
#include "feltmb/core/error.hpp"

namespace feltmb {

void Assembler::add_surfaces() {
  for (const auto& s : d_.surfaces) {
    const std::string where = "surface \"" + s.name + "\"";
    if (surfaces_.contains(s.name)) fault(where + ": the name is given twice");
    find_body(s.body, where);
    if (!finite(s.point)) fault(where + ": point is not a finite number");
    if (s.kind == SurfaceKind::kLine) {
      if (std::abs(norm(s.normal) - 1.0) > 2e-4) {
        fault(where + format(": normal has length %.6g, must be 1 (within 2e-4)", norm(s.normal)));
      }
    } else if (!(std::isfinite(s.radius) && s.radius >= 0.0)) {
      fault(where + format(": radius = %.6g m, must be >= 0", s.radius));
    } else if (s.kind == SurfaceKind::kConcave && s.radius <= 0.0) {
      fault(where + format(": radius = %.6g m of a concave circle, must be > 0", s.radius));
    }
    if (s.kind == SurfaceKind::kHybrid &&
        !(s.arc[1] > s.arc[0] && s.arc[1] - s.arc[0] < 3.1415926535)) {
      fault(where +
            format(": arc from %.6g to %.6g rad, must grow by less than pi", s.arc[0], s.arc[1]));
    }
    surfaces_[s.name] = &s;
  }
}

const char* Assembler::kind_name(SurfaceKind kind) {
  switch (kind) {
    case SurfaceKind::kLine:
      return "line";
    case SurfaceKind::kCircle:
      return "circle";
    case SurfaceKind::kConcave:
      return "concave circle";
    case SurfaceKind::kHybrid:
      return "hybrid";
  }
  return "?";
}

const SurfaceDescription* Assembler::find_surface(const std::string& name,
                                                  const std::string& where) {
  const auto it = surfaces_.find(name);
  if (it != surfaces_.end()) return it->second;
  std::string known;
  for (const auto& s : d_.surfaces) known += (known.empty() ? "" : ", ") + s.name;
  fault(where + ": surface \"" + name + "\" is missing; surfaces are " +
        (known.empty() ? "none" : known));
  return nullptr;
}

void Assembler::add_contacts() {
  std::set<int> numbers;
  for (const auto& c : d_.contacts) {
    const std::string where = format("contact %02d", c.number);
    if (c.number < 1 || c.number > 9999) {
      fault(where + ": number must be between 1 and 9999");
    }
    if (!numbers.insert(c.number).second) fault(where + ": the number is given twice");
    const auto* sa = find_surface(c.surface_a, where);
    const auto* sb = find_surface(c.surface_b, where);
    check(c.friction, where + ": friction ");
    Contact contact;
    contact.number = c.number;
    contact.name = format("contact%02d", c.number);
    contact.label = c.label;
    contact.friction = c.friction;
    contact.enabled = c.enabled;
    try {
      const ContactLaw law(c.law);
      // A contact that is off keeps a law without states: it has nothing to remember.
      if (c.enabled) contact.law = law;
    } catch (const InvalidParameter& error) {
      fault(where + ": " + error.what());
    }
    if (sa == nullptr || sb == nullptr) continue;
    if (sa->kind == SurfaceKind::kCircle && sb->kind != SurfaceKind::kCircle) {
      std::swap(sa, sb);
      contact.swapped = true;
    }
    if (sb->kind != SurfaceKind::kCircle) {
      fault(where + ": a " + kind_name(sa->kind) + " (" + sa->name + ") cannot meet a " +
            kind_name(sb->kind) + " (" + sb->name + "); one of the pair must be a circle");
      continue;
    }
    if (sa->kind == SurfaceKind::kConcave && sa->radius <= sb->radius) {
      fault(where + format(": circle of radius %.6g m does not fit into the concave one of "
                           "%.6g m",
                           sb->radius, sa->radius));
    }
    set_geometry(contact, *sa, *sb, where);
    m_->contacts.push_back(contact);
  }
  if (d_.finger) add_finger();
  if (d_.motor) add_motor();
}

void Assembler::set_geometry(Contact& contact, const SurfaceDescription& sa,
                             const SurfaceDescription& sb, const std::string& where) {
  const auto* pa = find_body(sa.body, where);
  const auto* pb = find_body(sb.body, where);
  if (pa == nullptr || pb == nullptr) return;
  contact.a = place(*pa, sa.point, "surface \"" + sa.name + "\"");
  contact.b = place(*pb, sb.point, "surface \"" + sb.name + "\"");
  if (contact.a.link == contact.b.link) {
    fault(where + ": surfaces " + sa.name + " and " + sb.name +
          " belong to bodies that cannot move against each other");
  }
  contact.radius_b = sb.radius;
  const Rotation turn = Rotation::of(pa->beam < 0 ? pa->angle : 0.0);
  switch (sa.kind) {
    case SurfaceKind::kLine:
      contact.kind = PairKind::kLineCircle;
      // Printed normals carry four digits; a unit normal keeps rates and energy consistent.
      contact.normal_a = turn * ((1.0 / norm(sa.normal)) * sa.normal);
      break;
    case SurfaceKind::kCircle:
      contact.kind = PairKind::kCircleCircle;
      break;
    case SurfaceKind::kConcave:
      contact.kind = PairKind::kConcaveCircle;
      break;
    case SurfaceKind::kHybrid: {
      contact.kind = PairKind::kHybridCircle;
      for (int i = 0; i < 2; ++i) {
        const double angle = sa.arc[static_cast<std::size_t>(i)];
        const Vec2 outward{std::cos(angle), std::sin(angle)};
        contact.arc_normal[i] = turn * outward;
        contact.arc_tangent[i] = turn * (i == 0 ? -perp(outward) : perp(outward));
      }
      break;
    }
  }
  contact.radius_a = sa.kind == SurfaceKind::kLine ? 0.0 : sa.radius;
  set_coordinates(contact.coordinates, contact.a.link, contact.b.link);
}

void Assembler::set_coordinates(std::vector<int>& out, int link_a, int link_b) const {
  std::set<int> both;
  for (const int link : {link_a, link_b}) {
    const auto& path = m_->links[static_cast<std::size_t>(link)].path;
    for (const int motion : path) both.insert(m_->motions[at(motion)].coordinate);
  }
  out.assign(both.begin(), both.end());
}

void Assembler::add_finger() {
  const auto& f = *d_.finger;
  const auto* p = find_body(f.body, "finger");
  if (std::abs(norm(f.direction) - 1.0) > 1e-6) {
    fault(format("finger: direction has length %.6g, must be 1", norm(f.direction)));
  }
  if (p == nullptr) return;
  if (p->link == 0) fault("finger: its point is fixed to the ground");
  m_->finger_point = place(*p, f.point, "finger");
  m_->finger_direction = f.direction;
  Contact contact;
  contact.name = "finger";
  contact.label = "finger pad";
  contact.kind = PairKind::kLineCircle;
  contact.a = LinkPoint{0, {}};
  contact.normal_a = f.direction;
  contact.b = m_->finger_point;
  contact.finger = true;
  contact.enabled = false;
  try {
    contact.law = ContactLaw(f.pad);
  } catch (const InvalidParameter& error) {
    fault(std::string("finger pad: ") + error.what());
  }
  set_coordinates(contact.coordinates, 0, m_->finger_point.link);
  m_->finger_contact = static_cast<int>(m_->contacts.size());
  m_->contacts.push_back(contact);
}

void Assembler::add_motor() {
  m_->motor_coordinate = m_->coordinate_index(d_.motor->coordinate);
  if (m_->motor_coordinate < 0) {
    fault("motor: there is no coordinate \"" + d_.motor->coordinate + "\"");
  } else if (!m_->coordinate_is_angle[at(m_->motor_coordinate)]) {
    fault("motor: coordinate \"" + d_.motor->coordinate + "\" is no angle");
  }
  if (d_.motor->contact == 0) return;
  m_->motor_contact = m_->contact_index(d_.motor->contact);
  if (m_->motor_contact < 0) fault(format("motor: there is no contact %d", d_.motor->contact));
}

void Assembler::add_strings() {
  for (const auto& s : d_.strings) {
    const std::string where = "string \"" + s.name + "\"";
    int found = -1;
    for (const auto& c : d_.contacts) {
      if (c.surface_a != s.surface && c.surface_b != s.surface) continue;
      if (found >= 0) {
        fault(where + ": surface \"" + s.surface + "\" is struck by two contacts");
      }
      found = m_->contact_index(c.number);
    }
    const auto it = surfaces_.find(s.surface);
    if (it == surfaces_.end() || it->second->kind != SurfaceKind::kLine ||
        it->second->body != "ground") {
      fault(where + ": surface \"" + s.surface + "\" must be a line of the ground");
      continue;
    }
    if (found < 0) {
      fault(where + ": no contact uses its surface \"" + s.surface + "\"");
      continue;
    }
    try {
      AttachedString a{s.name,
                       ModalString(s.parameters),
                       s.anchor,
                       1.0,
                       s.moving_strike_point,
                       s.strike_position,
                       found,
                       m_->total_modes};
      const Vec2 along = perp(it->second->normal);
      if (std::abs(dot(along, s.direction)) < 0.5) {
        fault(where + ": direction is not along the surface \"" + s.surface + "\"");
      }
      a.sense = dot(along, s.direction) < 0.0 ? -1.0 : 1.0;
      if (!(s.anchor >= 0.0 && s.anchor <= s.parameters.length)) {
        fault(where +
              format(": anchor = %.6g m, must lie in [0, %.6g]", s.anchor, s.parameters.length));
      }
      if (!s.moving_strike_point &&
          !(s.strike_position > 0.0 && s.strike_position < s.parameters.length)) {
        fault(where + format(": strike_position = %.6g m, must lie inside (0, %.6g)",
                             s.strike_position, s.parameters.length));
      }
      if (s.rigid) continue;
      m_->contacts[static_cast<std::size_t>(found)].string = static_cast<int>(m_->strings.size());
      m_->total_modes += a.string.modes();
      m_->strings.push_back(std::move(a));
    } catch (const InvalidParameter& error) {
      fault(error.what());
    }
  }
}

}  // namespace feltmb
