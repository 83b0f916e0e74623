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
      if (!(std::abs(norm(s.normal) - 1.0) <= 2e-4)) {
        fault(where + format(": normal has length %.6g, must be 1 (within 2e-4)", norm(s.normal)));
      }
    } else if (!(std::isfinite(s.radius) && s.radius >= 0.0)) {
      fault(where + format(": radius = %.6g m, must be >= 0", s.radius));
    } else if (s.kind == SurfaceKind::kConcave && s.radius <= 0.0) {
      fault(where + format(": radius = %.6g m of a concave circle, must be > 0", s.radius));
    } else if (s.kind == SurfaceKind::kConcaveArc && s.radius <= 0.0) {
      fault(where + format(": radius = %.6g m of a concave arc, must be > 0", s.radius));
    }
    if (s.kind == SurfaceKind::kSegment) {
      const double length = norm(s.end - s.point);  // infinite beyond 1e154 m
      if (!(std::isfinite(length) && length > 1e-9)) {
        fault(where +
              format(": is %.6g m long from point to end, must be finite and > 1e-9 m", length));
      }
    }
    constexpr double turn = 6.283185307;
    if (s.kind == SurfaceKind::kConcaveArc &&
        !(s.arc[1] > s.arc[0] && s.arc[1] - s.arc[0] < turn)) {
      fault(where + format(": arc from %.6g to %.6g rad, must grow by less than a turn", s.arc[0],
                           s.arc[1]));
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
    case SurfaceKind::kSegment:
      return "segment";
    case SurfaceKind::kConcaveArc:
      return "concave arc";
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
    check(c.friction, where + ": friction ", Site::kContact);
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
    const bool concave = sa->kind == SurfaceKind::kConcave || sa->kind == SurfaceKind::kConcaveArc;
    if (concave && sa->radius <= sb->radius) {
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
    case SurfaceKind::kSegment: {
      contact.kind = PairKind::kSegmentCircle;
      const Vec2 way = (1.0 / norm(sa.end - sa.point)) * (sa.end - sa.point);
      contact.normal_a = turn * perp(way);
      contact.arc_tangent[0] = turn * -way;
      contact.arc_tangent[1] = turn * way;
      contact.end[1] = turn * (sa.end - sa.point);
      break;
    }
    case SurfaceKind::kConcaveArc: {
      contact.kind = PairKind::kConcaveArcCircle;
      contact.more_than_half = sa.arc[1] - sa.arc[0] > 3.141592653589793;
      for (int i = 0; i < 2; ++i) {
        const double angle = sa.arc[static_cast<std::size_t>(i)];
        const Vec2 outward{std::cos(angle), std::sin(angle)};
        contact.end[i] = turn * (sa.radius * outward);
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
    for (const int motion : path) both.insert(m_->motions[as_index(motion)].coordinate);
  }
  out.assign(both.begin(), both.end());
}

void Assembler::add_finger() {
  const auto& f = *d_.finger;
  const auto* p = find_body(f.body, "finger");
  if (!(std::abs(norm(f.direction) - 1.0) <= 1e-6)) {
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
  } else if (!m_->coordinate_is_angle[as_index(m_->motor_coordinate)]) {
    fault("motor: coordinate \"" + d_.motor->coordinate + "\" is no angle");
  }
  if (d_.motor->contact == 0) return;
  m_->motor_contact = m_->contact_index(d_.motor->contact);
  if (m_->motor_contact < 0) fault(format("motor: there is no contact %d", d_.motor->contact));
}

void Assembler::add_strings() {
  for (const auto& s : d_.strings) {
    const std::string where = "string \"" + s.name + "\"";
    const auto* first = string_line(s.surface, where);
    if (first != nullptr && std::abs(dot(perp(first->normal), s.direction)) < 0.5) {
      fault(where + ": direction is not along the surface \"" + s.surface + "\"");
    }
    if (!(s.anchor >= 0.0 && s.anchor <= s.parameters.length)) {
      fault(where +
            format(": anchor = %.6g m, must lie in [0, %.6g]", s.anchor, s.parameters.length));
    }
    std::vector<StringContact> touching;
    std::vector<std::string> lines{s.surface};
    for (const auto& name : s.other_surfaces) {
      const auto* line = string_line(name, where);
      if (std::find(lines.begin(), lines.end(), name) != lines.end()) {
        fault(where + ": surface \"" + name + "\" is given twice");
        continue;
      }
      if (first != nullptr && line != nullptr) check_along_string(s, *first, *line, where);
      lines.push_back(name);
    }
    if (first == nullptr) continue;
    for (const auto& name : lines) add_string_contacts(touching, s, *first, name, where);
    try {
      AttachedString a{s.name, ModalString(s.parameters), m_->total_modes,
                       static_cast<int>(m_->string_contacts.size()),
                       static_cast<int>(touching.size())};
      if (s.rigid) continue;
      for (StringContact& c : touching) {
        m_->contacts[as_index(c.contact)].string_contact =
            static_cast<int>(m_->string_contacts.size());
        c.string = static_cast<int>(m_->strings.size());
        c.shape = m_->total_shapes;
        m_->total_shapes += a.string.modes();
        m_->string_contacts.push_back(c);
      }
      m_->total_modes += a.string.modes();
      m_->strings.push_back(std::move(a));
    } catch (const InvalidParameter& error) {
      fault(error.what());
    }
  }
}

/// The line of the ground of this name, or nothing and a fault.
const SurfaceDescription* Assembler::string_line(const std::string& name,
                                                 const std::string& where) {
  const auto it = surfaces_.find(name);
  if (it == surfaces_.end() || it->second->kind != SurfaceKind::kLine ||
      it->second->body != "ground") {
    fault(where + ": surface \"" + name + "\" must be a line of the ground");
    return nullptr;
  }
  return it->second;
}

/// A line beside that of what strikes the string must lie on one of the string's two faces.
void Assembler::check_along_string(const StringDescription& s, const SurfaceDescription& first,
                                   const SurfaceDescription& line, const std::string& where) {
  constexpr double parallel = 1e-3;  // rad; printed normals carry four digits
  if (std::abs(cross(first.normal, line.normal)) > parallel) {
    fault(where + ": surface \"" + line.name + "\" is not parallel to \"" + first.name + "\"");
    return;
  }
  const double off = dot(first.normal, line.point - first.point);
  if (!(std::abs(off) <= 2.0 * s.parameters.diameter)) {
    fault(where + format(": surface \"%s\" runs %.4g m beside \"%s\", expected on the same string: "
                         "within two diameters, %.4g m",
                         line.name.c_str(), std::abs(off), first.name.c_str(),
                         2.0 * s.parameters.diameter));
  }
}

void Assembler::add_string_contacts(std::vector<StringContact>& touching,
                                    const StringDescription& s, const SurfaceDescription& first,
                                    const std::string& name, const std::string& where) {
  const auto it = surfaces_.find(name);
  if (it == surfaces_.end()) return;  // its own fault is already listed
  const SurfaceDescription& line = *it->second;
  const auto along = [&](Vec2 normal) {
    return (dot(perp(normal), s.direction) < 0.0 ? -1.0 : 1.0) * perp(normal);
  };
  StringContact c;
  c.side = dot(first.normal, line.normal) < 0.0 ? -1.0 : 1.0;
  c.sense = dot(perp(line.normal), s.direction) < 0.0 ? -1.0 : 1.0;
  c.anchor =
      &line == &first ? s.anchor : s.anchor + dot(along(first.normal), line.point - first.point);
  c.moving = s.moving_strike_point;
  c.position = &line == &first ? s.strike_position : c.anchor;
  if (!c.moving && !(c.position > 0.0 && c.position < s.parameters.length)) {
    fault(
        where +
        (&line == &first
             ? format(": strike_position = %.6g m, must lie inside (0, %.6g)", c.position,
                      s.parameters.length)
             : format(": the point of surface \"%s\" is %.6g m from the end y = 0, must lie inside "
                      "(0, %.6g) where points of contact are held",
                      name.c_str(), c.position, s.parameters.length)));
  }
  bool found = false;
  for (const auto& contact : d_.contacts) {
    if (contact.surface_a != name && contact.surface_b != name) continue;
    found = true;
    c.contact = m_->contact_index(contact.number);
    // One that could not be made has its own fault.
    if (c.contact >= 0) touching.push_back(c);
  }
  if (!found) fault(where + ": no contact uses its surface \"" + name + "\"");
}

}  // namespace feltmb
