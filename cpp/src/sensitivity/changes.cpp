#include "changes.hpp"

#include <algorithm>

#include "feltmb/contact/laws/catalog.hpp"

namespace feltmb::detail {
namespace {

bool same(const LinkPoint& a, const LinkPoint& b) { return a.link == b.link && a.local == b.local; }

bool same_joint(const Link& a, const Link& b) {
  return a.parent == b.parent && a.kind == b.kind && a.position == b.position &&
         a.base.c == b.base.c && a.base.s == b.base.s && a.angle == b.angle &&
         a.station == b.station && a.lump == b.lump && a.motions == b.motions && a.path == b.path;
}

bool same_motion(const Motion& a, const Motion& b) {
  return a.coordinate == b.coordinate && a.link == b.link && a.translation == b.translation &&
         a.rho == b.rho && a.group == b.group;
}

bool same_geometry(const Contact& a, const Contact& b) {
  return a.kind == b.kind && same(a.a, b.a) && a.normal_a == b.normal_a &&
         a.radius_a == b.radius_a && std::equal(a.arc_normal, a.arc_normal + 2, b.arc_normal) &&
         std::equal(a.end, a.end + 2, b.end) &&
         std::equal(a.arc_tangent, a.arc_tangent + 2, b.arc_tangent) && same(a.b, b.b) &&
         a.radius_b == b.radius_b && a.enabled == b.enabled;
}

bool same_strap(const Strap& a, const Strap& b) {
  return same(a.a, b.a) && same(a.b, b.b) && a.free_length == b.free_length &&
         a.coefficients == b.coefficients && a.slack == b.slack;
}

bool same_spring(const TorsionSpring& a, const TorsionSpring& b) {
  return a.coordinate == b.coordinate && a.stiffness == b.stiffness &&
         a.rest_angle == b.rest_angle && a.play.clearance == b.play.clearance &&
         a.play.seating == b.play.seating;
}

bool same_dashpot(const Dashpot& a, const Dashpot& b) {
  return a.coordinate == b.coordinate && a.coefficient == b.coefficient && a.side == b.side;
}

template <class T, class Same>
bool all_same(const std::vector<T>& a, const std::vector<T>& b, Same&& each) {
  return std::equal(a.begin(), a.end(), b.begin(), b.end(), each);
}

/// Adds the places where two lists of one length differ, each once.
template <class T, class Same>
void add_differing(const std::vector<T>& a, const std::vector<T>& b, Same&& same_part,
                   std::vector<std::size_t>& out) {
  for (std::size_t i = 0; i < a.size(); ++i) {
    if (same_part(a[i], b[i]) || std::find(out.begin(), out.end(), i) != out.end()) continue;
    out.push_back(i);
  }
}

/// Whether the parts that other parts hang on are the same: else nothing can be compared by place.
bool same_motions(const Mechanism& a, const Mechanism& b) {
  const auto joined = [](const Contact& x, const Contact& y) {
    return x.a.link == y.a.link && x.b.link == y.b.link && x.string_contact == y.string_contact &&
           x.finger == y.finger;
  };
  const auto strapped = [](const Strap& x, const Strap& y) {
    return x.a.link == y.a.link && x.b.link == y.b.link;
  };
  const auto held = [](const FlexibleBeam& x, const FlexibleBeam& y) {
    return x.first == y.first && x.count == y.count && x.condense_axial == y.condense_axial;
  };
  return all_same(a.links, b.links, same_joint) && all_same(a.motions, b.motions, same_motion) &&
         all_same(a.contacts, b.contacts, joined) && all_same(a.straps, b.straps, strapped) &&
         all_same(a.beams, b.beams, held) && a.springs.size() == b.springs.size() &&
         a.dashpots.size() == b.dashpots.size() && a.finger_point.link == b.finger_point.link &&
         a.motor_coordinate == b.motor_coordinate;
}

void compare_contacts(const Mechanism& a, const Mechanism& b, Changes& out) {
  for (std::size_t i = 0; i < a.contacts.size(); ++i) {
    const Contact& one = a.contacts[i];
    const Contact& other = b.contacts[i];
    Changes::OfContact of{i};
    of.law = !same_law(one.law.parameters(), other.law.parameters());
    of.friction = !same_fields(one.friction, other.friction);
    of.geometry = !same_geometry(one, other);
    if (!of.law && !of.friction && !of.geometry) continue;
    auto known = std::find_if(out.contacts.begin(), out.contacts.end(),
                              [&](const auto& each) { return each.contact == i; });
    if (known == out.contacts.end()) known = out.contacts.insert(known, {i});
    known->law = known->law || of.law;
    known->friction = known->friction || of.friction;
    known->geometry = known->geometry || of.geometry;
  }
}

void compare_strings(const Mechanism& a, const Mechanism& b, Changes& out) {
  for (std::size_t i = 0; i < a.strings.size(); ++i) {
    const AttachedString& one = a.strings[i];
    const AttachedString& other = b.strings[i];
    const auto differ = [](const auto& x, const auto& y) {
      return !std::equal(x.begin(), x.end(), y.begin(), y.end());
    };
    out.strings = out.strings || differ(one.string.stiffness(), other.string.stiffness()) ||
                  differ(one.string.damping(), other.string.damping());
    out.shapes = out.shapes || one.string.parameters().length != other.string.parameters().length ||
                 one.string.shape_scale() != other.string.shape_scale();
  }
  for (std::size_t i = 0; i < a.string_contacts.size(); ++i) {
    const StringContact& one = a.string_contacts[i];
    const StringContact& other = b.string_contacts[i];
    out.shapes = out.shapes || one.anchor != other.anchor || one.sense != other.sense ||
                 one.side != other.side || one.moving != other.moving ||
                 one.position != other.position;
  }
}

void sum_links(const Mechanism& base, const std::vector<Perturbed>& nodes, Changes& out) {
  for (std::size_t i = 1; i < base.links.size(); ++i) {
    Changes::OfLink sum{static_cast<int>(i), 0.0, {}, 0.0};
    const Link& own = base.links[i];
    bool differs = false;
    for (const Perturbed& p : nodes) {
      const Link& link = p.mechanism->links[i];
      const Vec2 c = link.center_of_mass;
      differs = differs || link.mass != own.mass || c != own.center_of_mass ||
                link.inertia != own.inertia;
      sum.mass += p.weight * link.mass;
      sum.first += (p.weight * link.mass) * c;
      sum.second += p.weight * (link.inertia + link.mass * dot(c, c));
    }
    if (differs) out.links.push_back(sum);
  }
}

void sum_beams(const Mechanism& base, const std::vector<Perturbed>& nodes, Changes& out) {
  for (std::size_t i = 0; i < base.beams.size(); ++i) {
    const FlexibleBeam& own = base.beams[i];
    bool differs = false;
    Changes::OfBeam sum{own.first, Eigen::MatrixXd::Zero(own.count, own.count), {}};
    sum.damping = sum.stiffness;
    for (const Perturbed& p : nodes) {
      const FlexibleBeam& beam = p.mechanism->beams[i];
      differs = differs || beam.stiffness != own.stiffness || beam.damping_time != own.damping_time;
      sum.stiffness += p.weight * beam.stiffness;
      sum.damping += (p.weight * beam.damping_time) * beam.stiffness;
    }
    if (differs) out.beams.push_back(std::move(sum));
  }
}

void sum_modes(const std::vector<Perturbed>& nodes, Changes& out) {
  for (const Perturbed& p : nodes) {
    const auto modes = static_cast<std::size_t>(p.mechanism->total_modes);
    out.mode_stiffness.resize(modes);
    out.mode_damping.resize(modes);
    for (const AttachedString& own : p.mechanism->strings) {
      const auto first = static_cast<std::size_t>(own.offset);
      for (std::size_t i = 0; i < own.string.stiffness().size(); ++i) {
        out.mode_stiffness[first + i] += p.weight * own.string.stiffness()[i];
        out.mode_damping[first + i] += p.weight * own.string.damping()[i];
      }
    }
  }
}

bool same_input(const InputSignal& a, const InputSignal& b) {
  return a.profile == b.profile && a.kind == b.kind && a.origin == b.origin;
}

}  // namespace

bool Changes::only_contacts() const {
  return !motions && !input && !finger && !strings && !shapes && !points && gravity == Vec2{} &&
         links.empty() && beams.empty() && joints.empty() && springs.empty() && dashpots.empty() &&
         straps.empty();
}

Changes find_changes(const Mechanism& mechanism, const InputSignal& input,
                     const std::vector<Perturbed>& nodes) {
  Changes out;
  for (const Perturbed& p : nodes) {
    out.input = out.input || !same_input(p.input, input);
    const Mechanism& other = *p.mechanism;
    if (&other == &mechanism) continue;
    if (!same_motions(mechanism, other)) {
      out.motions = true;
      continue;
    }
    compare_contacts(mechanism, other, out);
    compare_strings(mechanism, other, out);
    out.finger = out.finger || !same(mechanism.finger_point, other.finger_point) ||
                 mechanism.finger_direction != other.finger_direction;
    out.points = out.points ||
                 !all_same(mechanism.points, other.points,
                           [](const auto& a, const auto& b) { return same(a.point, b.point); });
    add_differing(mechanism.joint_friction, other.joint_friction, same_fields<Friction>,
                  out.joints);
    add_differing(mechanism.springs, other.springs, same_spring, out.springs);
    add_differing(mechanism.dashpots, other.dashpots, same_dashpot, out.dashpots);
    add_differing(mechanism.straps, other.straps, same_strap, out.straps);
  }
  if (out.motions) return out;
  for (const Perturbed& p : nodes) {
    if (p.mechanism->gravity != mechanism.gravity) {
      out.gravity = {};
      for (const Perturbed& each : nodes) out.gravity += each.weight * each.mechanism->gravity;
      break;
    }
  }
  sum_links(mechanism, nodes, out);
  sum_beams(mechanism, nodes, out);
  if (out.strings) sum_modes(nodes, out);
  return out;
}

}  // namespace feltmb::detail
