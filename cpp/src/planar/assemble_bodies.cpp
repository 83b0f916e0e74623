#include <algorithm>
#include <cmath>

#include "assembler.hpp"
#include "feltmb/core/error.hpp"
#include "feltmb/numeric/quadrature.hpp"

namespace feltmb {

LinkPoint Assembler::place(const Placement& p, Vec2 local, const std::string& where) {
  if (p.beam < 0) return {p.link, p.offset + Rotation::of(p.angle) * local};
  return {station(p.beam, local.x, where), {0.0, local.y}};
}

Placement Assembler::frame(const Placement& p, Vec2 local, const std::string& where) {
  const LinkPoint point = place(p, local, where);
  return {point.link, point.local, p.beam < 0 ? p.angle : 0.0, -1};
}

int Assembler::station(int beam, double x, const std::string& where) {
  const double length = m_->beams[as_index(beam)].length;
  if (!(x >= -1e-12 && x <= length * (1.0 + 1e-9))) {
    fault(where + format(": x = %.6g m lies outside the beam \"%s\" of %.6g m", x,
                         m_->beams[as_index(beam)].name.c_str(), length));
    return 0;
  }
  for (std::size_t i = 0; i < m_->links.size(); ++i) {
    const Link& link = m_->links[i];
    if (link.kind == LinkKind::kStation && !link.lump &&
        link.name == m_->beams[as_index(beam)].name &&
        std::fabs(link.station - x) < 1e-9 * length) {
      return static_cast<int>(i);
    }
  }
  return add_station(beam, x, false);
}

int Assembler::add_station(int index, double x, bool lump) {
  const FlexibleBeam& beam = m_->beams[as_index(index)];
  const ShapeValues values = beam.shapes.at(std::min(std::max(x, 0.0), beam.length));
  Link link;
  link.name = beam.name;
  link.parent = beam.base.link;
  link.kind = LinkKind::kStation;
  link.position = beam.base.offset;
  link.angle = beam.base.angle;
  link.base = Rotation::of(link.angle);
  link.station = x;
  link.lump = lump;
  link.path = m_->links[as_index(link.parent)].path;
  const int own = static_cast<int>(m_->links.size());
  for (int k = 0; k < beam.count; ++k) {
    Motion motion;
    motion.coordinate = beam.first + k;
    motion.link = own;
    motion.group = beam.first;
    const int lateral = k - beam.shapes.axial();
    if (lateral < 0) {
      motion.translation = {values.axial[as_index(k)], 0.0};
    } else {
      motion.translation = {0.0, values.lateral[as_index(lateral)]};
      motion.rho = lump ? 0.0 : values.lateral_slope[as_index(lateral)];
    }
    link.motions.push_back(static_cast<int>(m_->motions.size()));
    link.path.push_back(static_cast<int>(m_->motions.size()));
    m_->motions.push_back(motion);
  }
  m_->links.push_back(link);
  return own;
}

void Assembler::add_bodies() {
  m_->links.push_back(Link{});
  m_->links[0].name = "ground";
  placement_["ground"] = Placement{};
  std::set<std::string> names{"ground"};
  for (const auto& b : d_.bodies) {
    const std::string where = "body \"" + b.name + "\"";
    if (!names.insert(b.name).second) fault(where + ": the name is given twice");
    check(b, where + ": ");
    if (!finite(b.position) || !finite(b.center_of_mass)) {
      fault(where + ": position or center of mass is not a finite number");
    }
    if (b.joint == JointKind::kPrismatic && !(std::abs(norm(b.axis) - 1.0) <= 1e-6)) {
      fault(where + format(": axis has length %.6g, must be 1", norm(b.axis)));
    }
    check(b.friction, where + ": friction ",
          b.joint == JointKind::kPrismatic ? Site::kPrismatic : Site::kRevolute);
  }
  std::vector<const BodyDescription*> waiting;
  for (const auto& b : d_.bodies) waiting.push_back(&b);
  bool progress = true;
  while (!waiting.empty() && progress) {
    progress = false;
    std::vector<const BodyDescription*> next;
    for (const auto* b : waiting) {
      const auto parent = placement_.find(b->parent);
      if (parent == placement_.end()) {
        next.push_back(b);
        continue;
      }
      place_body(*b, parent->second);
      progress = true;
    }
    waiting = std::move(next);
  }
  for (const auto* b : waiting) unplaced_.insert(b->name);
  for (const auto* b : waiting) {
    if (names.contains(b->parent)) {
      fault("body \"" + b->name + "\": its chain of parents (" + b->parent +
            ", ...) never reaches the ground");
    } else {
      fault("body \"" + b->name + "\": parent \"" + b->parent + "\" is missing");
    }
  }
}

void Assembler::place_body(const BodyDescription& b, const Placement& parent_body) {
  const std::string where = "body \"" + b.name + "\"";
  const Placement parent = frame(parent_body, b.position, where);
  if (b.beam) {
    if (b.joint != JointKind::kWeld) {
      fault(where + ": a flexible beam must be welded to its parent; put a body in between");
    }
    add_beam(b, {parent.link, parent.offset, parent.angle + b.angle, -1});
    return;
  }
  if (b.joint == JointKind::kWeld) {
    const Placement p{parent.link, parent.offset, parent.angle + b.angle, -1};
    placement_[b.name] = p;
    m_->bodies.emplace_back(b.name, p);
    if (p.link == 0) return;
    merge(m_->links[as_index(p.link)], b.mass, p.offset + Rotation::of(p.angle) * b.center_of_mass,
          b.inertia);
    return;
  }
  const bool revolute = b.joint == JointKind::kRevolute;
  Link link;
  link.name = b.name;
  link.parent = parent.link;
  link.kind = revolute ? LinkKind::kRevolute : LinkKind::kPrismatic;
  link.position = parent.offset;
  link.angle = parent.angle + b.angle;
  link.base = Rotation::of(link.angle);
  link.mass = b.mass;
  link.center_of_mass = b.center_of_mass;
  link.inertia = b.inertia;
  Motion motion;
  motion.coordinate = add_coordinate(b.coordinate, revolute, where, link.parent, b.friction);
  motion.link = static_cast<int>(m_->links.size());
  motion.group = motion.coordinate;
  motion.rho = revolute ? 1.0 : 0.0;
  // The axis is given in the parent's frame; translations are kept in that of the joint.
  if (!revolute) motion.translation = Rotation::of(-b.angle) * b.axis;
  const int index = static_cast<int>(m_->motions.size());
  m_->motions.push_back(motion);
  link.motions = {index};
  link.path = m_->links[as_index(link.parent)].path;
  link.path.push_back(index);
  const Placement p{static_cast<int>(m_->links.size()), {}, 0.0, -1};
  placement_[b.name] = p;
  m_->bodies.emplace_back(b.name, p);
  m_->links.push_back(link);
}

int Assembler::add_coordinate(const std::string& name, bool angle, const std::string& where,
                              int parent_link, const Friction& friction) {
  if (name.empty()) fault(where + ": its joint coordinate has no name");
  if (m_->coordinate_index(name) >= 0) {
    fault(where + ": coordinate \"" + name + "\" is given twice");
  }
  const auto& path = m_->links[as_index(parent_link)].path;
  m_->coordinates.push_back(name);
  m_->coordinate_is_angle.push_back(angle);
  m_->coordinate_parent.push_back(path.empty() ? -1
                                               : m_->motions[as_index(path.back())].coordinate);
  m_->joint_friction.push_back(friction);
  return m_->size() - 1;
}

void Assembler::add_beam(const BodyDescription& b, const Placement& base) {
  const BeamDescription& d = *b.beam;
  const std::string where = "body \"" + b.name + "\"";
  check(d, where + ": ");
  if (b.mass != 0.0) fault(where + ": a flexible beam has its mass from its density, not mass");
  try {
    FlexibleBeam beam{b.name,
                      m_->size(),
                      0,
                      {},
                      d.damping_time,
                      base,
                      BeamShapes(d.shapes, d.length, d.axial_shapes, d.lateral_shapes),
                      d.length,
                      d.condense_axial,
                      0.0,
                      0.0,
                      0.0,
                      {},
                      {},
                      {},
                      {},
                      {},
                      {},
                      {}};
    beam.count = d.axial_shapes + d.lateral_shapes;
    for (int k = 0; k < beam.count; ++k) {
      const bool axial = k < d.axial_shapes;
      const std::string name =
          b.name + (axial ? ".u" : ".v") + std::to_string(axial ? k + 1 : k - d.axial_shapes + 1);
      add_coordinate(name, false, where, base.link, Friction{});
      if (k > 0) m_->coordinate_parent.back() = m_->size() - 2;
    }
    integrate_stiffness(beam, d);
    integrate_mass(beam, d);
    const int index = static_cast<int>(m_->beams.size());
    m_->beams.push_back(beam);
    const QuadratureRule rule = make_gauss_legendre(as_index(beam.shapes.quadrature_points()));
    for (std::size_t i = 0; i < rule.nodes.size(); ++i) {
      const double x = 0.5 * d.length * (1.0 + rule.nodes[i]);
      const int lump = add_station(index, x, true);
      m_->links[as_index(lump)].mass = 0.5 * d.length * rule.weights[i] * d.linear_density;
    }
    Placement p = base;
    p.beam = index;
    placement_[b.name] = p;
    m_->bodies.emplace_back(b.name, p);
  } catch (const InvalidParameter& error) {
    fault(where + ": " + error.what());
    unplaced_.insert(b.name);
  }
}

void Assembler::integrate_mass(FlexibleBeam& beam, const BeamDescription& d) {
  beam.shape_moment.assign(as_index(beam.count), {});
  beam.radial.assign(as_index(beam.count), 0.0);
  beam.transverse.assign(as_index(beam.count), 0.0);
  beam.shape_product.setZero(beam.count, beam.count);
  beam.shape_cross.setZero(beam.count, beam.count);
  const QuadratureRule rule = make_gauss_legendre(as_index(beam.shapes.quadrature_points()));
  beam.axial_at.setZero(4, beam.count);
  beam.lateral_at.setZero(4, beam.count);
  for (int quarter = 1; quarter <= 4; ++quarter) {
    const ShapeValues v = beam.shapes.at(0.25 * quarter * d.length);
    for (int k = 0; k < beam.count; ++k) {
      const int lateral = k - d.axial_shapes;
      (lateral < 0 ? beam.axial_at : beam.lateral_at)(quarter - 1, k) =
          lateral < 0 ? v.axial[as_index(k)] : v.lateral[as_index(lateral)];
    }
  }
  std::vector<Vec2> shape(as_index(beam.count));
  for (std::size_t i = 0; i < rule.nodes.size(); ++i) {
    const double mass = 0.5 * d.length * rule.weights[i] * d.linear_density;
    const double x = 0.5 * d.length * (1.0 + rule.nodes[i]);
    const ShapeValues v = beam.shapes.at(x);
    beam.mass += mass;
    beam.first_moment += mass * x;
    beam.second_moment += mass * x * x;
    for (int k = 0; k < beam.count; ++k) {
      const int lateral = k - d.axial_shapes;
      shape[as_index(k)] =
          lateral < 0 ? Vec2{v.axial[as_index(k)], 0.0} : Vec2{0.0, v.lateral[as_index(lateral)]};
      beam.shape_moment[as_index(k)] += mass * shape[as_index(k)];
      beam.radial[as_index(k)] += mass * x * shape[as_index(k)].x;
      beam.transverse[as_index(k)] += mass * x * shape[as_index(k)].y;
    }
    for (int k = 0; k < beam.count; ++k) {
      for (int l = 0; l < beam.count; ++l) {
        beam.shape_product(k, l) += mass * dot(shape[as_index(k)], shape[as_index(l)]);
        beam.shape_cross(k, l) += mass * cross(shape[as_index(k)], shape[as_index(l)]);
      }
    }
  }
}

void Assembler::integrate_stiffness(FlexibleBeam& beam, const BeamDescription& d) {
  beam.stiffness.setZero(beam.count, beam.count);
  const QuadratureRule rule = make_gauss_legendre(as_index(beam.shapes.quadrature_points()));
  for (std::size_t i = 0; i < rule.nodes.size(); ++i) {
    const double weight = 0.5 * d.length * rule.weights[i];
    const ShapeValues v = beam.shapes.at(0.5 * d.length * (1.0 + rule.nodes[i]));
    for (int k = 0; k < beam.count; ++k) {
      for (int j = 0; j < beam.count; ++j) {
        const int kl = k - d.axial_shapes;
        const int jl = j - d.axial_shapes;
        if (kl < 0 && jl < 0) {
          beam.stiffness(k, j) +=
              weight * d.axial_stiffness * v.axial_slope[as_index(k)] * v.axial_slope[as_index(j)];
        } else if (kl >= 0 && jl >= 0) {
          beam.stiffness(k, j) += weight * d.bending_stiffness * v.lateral_curvature[as_index(kl)] *
                                  v.lateral_curvature[as_index(jl)];
        }
      }
    }
  }
}

void Assembler::merge(Link& link, double mass, Vec2 center, double inertia) {
  const double total = link.mass + mass;
  if (total <= 0.0) {
    link.inertia += inertia;
    return;
  }
  const Vec2 joint_center = (1.0 / total) * (link.mass * link.center_of_mass + mass * center);
  const Vec2 d1 = link.center_of_mass - joint_center;
  const Vec2 d2 = center - joint_center;
  link.inertia += inertia + link.mass * dot(d1, d1) + mass * dot(d2, d2);
  link.mass = total;
  link.center_of_mass = joint_center;
}

}  // namespace feltmb
