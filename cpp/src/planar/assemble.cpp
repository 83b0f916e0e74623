#include <algorithm>
#include <cmath>
#include <map>
#include <set>

#include "feltmb/core/error.hpp"
#include "feltmb/numeric/quadrature.hpp"
#include "feltmb/planar/mechanism.hpp"

namespace feltmb {
namespace {

class Assembler {
 public:
  explicit Assembler(const MechanismDescription& description) : d_(description) {}

  std::shared_ptr<const Mechanism> run() {
    m_ = std::make_shared<Mechanism>();
    m_->name = d_.name;
    m_->gravity = d_.gravity;
    add_bodies();
    const bool bodies_are_sound = faults_.empty();
    add_surfaces();
    add_contacts();
    add_strings();
    add_springs();
    add_dashpots();
    add_straps();
    add_points();
    add_start_pose();
    for (Contact& contact : m_->contacts) {
      contact.first_state = m_->total_law_states;
      m_->total_law_states += static_cast<int>(contact.law.n_states());
    }
    if (bodies_are_sound) check_inertia();
    if (faults_.empty()) set_scales();
    if (!faults_.empty()) {
      std::string text = "mechanism \"" + d_.name + "\": " + std::to_string(faults_.size()) +
                         (faults_.size() == 1 ? " fault" : " faults");
      for (const auto& fault : faults_) text += "\n  " + fault;
      throw InvalidParameter(text);
    }
    return m_;
  }

 private:
  void fault(const std::string& text) { faults_.push_back(text); }

  bool finite(Vec2 v) const { return std::isfinite(v.x) && std::isfinite(v.y); }

  const Placement* find_body(const std::string& body, const std::string& where) {
    const auto it = placement_.find(body);
    if (it != placement_.end()) return &it->second;
    if (unplaced_.contains(body)) return nullptr;  // its own fault is already listed
    std::string known = "ground";
    for (const auto& b : d_.bodies) known += ", " + b.name;
    fault(where + ": body \"" + body + "\" is missing; bodies are " + known);
    return nullptr;
  }

  /// A point of a body as a point of a link; on a flexible beam, of the station at its x.
  LinkPoint place(const Placement& p, Vec2 local, const std::string& where) {
    if (p.beam < 0) return {p.link, p.offset + Rotation::of(p.angle) * local};
    return {station(p.beam, local.x, where), {0.0, local.y}};
  }

  /// Frame at a point of a body, for a joint there.
  Placement frame(const Placement& p, Vec2 local, const std::string& where) {
    const LinkPoint point = place(p, local, where);
    return {point.link, point.local, p.beam < 0 ? p.angle : 0.0, -1};
  }

  /// Link of the cross section of a beam at x; made when first asked for.
  int station(int beam, double x, const std::string& where) {
    const double length = m_->beams[at(beam)].length;
    if (!(x >= -1e-12 && x <= length * (1.0 + 1e-9))) {
      fault(where + format(": x = %.6g m lies outside the beam \"%s\" of %.6g m", x,
                           m_->beams[at(beam)].name.c_str(), length));
      return 0;
    }
    for (std::size_t i = 0; i < m_->links.size(); ++i) {
      const Link& link = m_->links[i];
      if (link.kind == LinkKind::kStation && !link.lump && link.name == m_->beams[at(beam)].name &&
          std::fabs(link.station - x) < 1e-9 * length) {
        return static_cast<int>(i);
      }
    }
    return add_station(beam, x, false);
  }

  int add_station(int index, double x, bool lump) {
    const FlexibleBeam& beam = m_->beams[at(index)];
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
    link.path = m_->links[at(link.parent)].path;
    const int own = static_cast<int>(m_->links.size());
    for (int k = 0; k < beam.count; ++k) {
      Motion motion;
      motion.coordinate = beam.first + k;
      motion.link = own;
      motion.group = beam.first;
      const int lateral = k - beam.shapes.axial();
      if (lateral < 0) {
        motion.translation = {values.axial[at(k)], 0.0};
      } else {
        motion.translation = {0.0, values.lateral[at(lateral)]};
        motion.rho = lump ? 0.0 : values.lateral_slope[at(lateral)];
      }
      link.motions.push_back(static_cast<int>(m_->motions.size()));
      link.path.push_back(static_cast<int>(m_->motions.size()));
      m_->motions.push_back(motion);
    }
    m_->links.push_back(link);
    return own;
  }

  static std::size_t at(int i) { return static_cast<std::size_t>(i); }

  void add_bodies() {
    m_->links.push_back(Link{});
    m_->links[0].name = "ground";
    placement_["ground"] = Placement{};
    std::set<std::string> names{"ground"};
    for (const auto& b : d_.bodies) {
      const std::string where = "body \"" + b.name + "\"";
      if (!names.insert(b.name).second) fault(where + ": the name is given twice");
      if (!(std::isfinite(b.mass) && b.mass >= 0.0)) {
        fault(where + format(": mass = %.6g kg, must be >= 0", b.mass));
      }
      if (!(std::isfinite(b.inertia) && b.inertia >= 0.0)) {
        fault(where + format(": inertia = %.6g kg m^2, must be >= 0", b.inertia));
      }
      if (!finite(b.position) || !finite(b.center_of_mass) || !std::isfinite(b.angle)) {
        fault(where + ": position, angle or center of mass is not a finite number");
      }
      if (b.joint == JointKind::kPrismatic && std::abs(norm(b.axis) - 1.0) > 1e-6) {
        fault(where + format(": axis has length %.6g, must be 1", norm(b.axis)));
      }
      check_friction(b.friction, where);
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

  void place_body(const BodyDescription& b, const Placement& parent_body) {
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
      merge(m_->links[at(p.link)], b.mass, p.offset + Rotation::of(p.angle) * b.center_of_mass,
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
    link.path = m_->links[at(link.parent)].path;
    link.path.push_back(index);
    const Placement p{static_cast<int>(m_->links.size()), {}, 0.0, -1};
    placement_[b.name] = p;
    m_->bodies.emplace_back(b.name, p);
    m_->links.push_back(link);
  }

  int add_coordinate(const std::string& name, bool angle, const std::string& where, int parent_link,
                     const Friction& friction) {
    if (name.empty()) fault(where + ": its joint coordinate has no name");
    if (m_->coordinate_index(name) >= 0) {
      fault(where + ": coordinate \"" + name + "\" is given twice");
    }
    const auto& path = m_->links[at(parent_link)].path;
    m_->coordinates.push_back(name);
    m_->coordinate_is_angle.push_back(angle);
    m_->coordinate_parent.push_back(path.empty() ? -1 : m_->motions[at(path.back())].coordinate);
    m_->joint_friction.push_back(friction);
    return m_->size() - 1;
  }

  void add_beam(const BodyDescription& b, const Placement& base) {
    const BeamDescription& d = *b.beam;
    const std::string where = "body \"" + b.name + "\"";
    const auto positive = [&](double value, const char* field) {
      if (!(std::isfinite(value) && value > 0.0)) {
        fault(where + format(": %s = %.6g, must be > 0", field, value));
      }
    };
    positive(d.linear_density, "linear_density [kg/m]");
    positive(d.axial_stiffness, "axial_stiffness [N]");
    positive(d.bending_stiffness, "bending_stiffness [N m^2]");
    if (!(std::isfinite(d.damping_time) && d.damping_time >= 0.0)) {
      fault(where + format(": damping_time = %.6g s, must be >= 0", d.damping_time));
    }
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
      const QuadratureRule rule = make_gauss_legendre(at(beam.shapes.quadrature_points()));
      for (std::size_t i = 0; i < rule.nodes.size(); ++i) {
        const double x = 0.5 * d.length * (1.0 + rule.nodes[i]);
        const int lump = add_station(index, x, true);
        m_->links[at(lump)].mass = 0.5 * d.length * rule.weights[i] * d.linear_density;
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

  static void integrate_mass(FlexibleBeam& beam, const BeamDescription& d) {
    beam.shape_moment.assign(at(beam.count), {});
    beam.radial.assign(at(beam.count), 0.0);
    beam.transverse.assign(at(beam.count), 0.0);
    beam.shape_product.setZero(beam.count, beam.count);
    beam.shape_cross.setZero(beam.count, beam.count);
    const QuadratureRule rule = make_gauss_legendre(at(beam.shapes.quadrature_points()));
    std::vector<Vec2> shape(at(beam.count));
    for (std::size_t i = 0; i < rule.nodes.size(); ++i) {
      const double mass = 0.5 * d.length * rule.weights[i] * d.linear_density;
      const double x = 0.5 * d.length * (1.0 + rule.nodes[i]);
      const ShapeValues v = beam.shapes.at(x);
      beam.mass += mass;
      beam.first_moment += mass * x;
      beam.second_moment += mass * x * x;
      for (int k = 0; k < beam.count; ++k) {
        const int lateral = k - d.axial_shapes;
        shape[at(k)] = lateral < 0 ? Vec2{v.axial[at(k)], 0.0} : Vec2{0.0, v.lateral[at(lateral)]};
        beam.shape_moment[at(k)] += mass * shape[at(k)];
        beam.radial[at(k)] += mass * x * shape[at(k)].x;
        beam.transverse[at(k)] += mass * x * shape[at(k)].y;
      }
      for (int k = 0; k < beam.count; ++k) {
        for (int l = 0; l < beam.count; ++l) {
          beam.shape_product(k, l) += mass * dot(shape[at(k)], shape[at(l)]);
          beam.shape_cross(k, l) += mass * cross(shape[at(k)], shape[at(l)]);
        }
      }
    }
  }

  static void integrate_stiffness(FlexibleBeam& beam, const BeamDescription& d) {
    beam.stiffness.setZero(beam.count, beam.count);
    const QuadratureRule rule = make_gauss_legendre(at(beam.shapes.quadrature_points()));
    for (std::size_t i = 0; i < rule.nodes.size(); ++i) {
      const double weight = 0.5 * d.length * rule.weights[i];
      const ShapeValues v = beam.shapes.at(0.5 * d.length * (1.0 + rule.nodes[i]));
      for (int k = 0; k < beam.count; ++k) {
        for (int j = 0; j < beam.count; ++j) {
          const int kl = k - d.axial_shapes;
          const int jl = j - d.axial_shapes;
          if (kl < 0 && jl < 0) {
            beam.stiffness(k, j) +=
                weight * d.axial_stiffness * v.axial_slope[at(k)] * v.axial_slope[at(j)];
          } else if (kl >= 0 && jl >= 0) {
            beam.stiffness(k, j) += weight * d.bending_stiffness * v.lateral_curvature[at(kl)] *
                                    v.lateral_curvature[at(jl)];
          }
        }
      }
    }
  }

  static void merge(Link& link, double mass, Vec2 center, double inertia) {
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

  void check_friction(const Friction& f, const std::string& where) {
    if (!(std::isfinite(f.amplitude) && f.amplitude >= 0.0)) {
      fault(where + format(": friction amplitude A = %.6g, must be >= 0", f.amplitude));
    }
    if (!(std::isfinite(f.b1) && f.b1 >= 0.0 && std::isfinite(f.b2) && f.b2 >= 0.0)) {
      fault(where + format(": friction B1 = %.6g, B2 = %.6g, must be >= 0", f.b1, f.b2));
    }
    if (!(std::isfinite(f.threshold_speed) && f.threshold_speed > 0.0)) {
      fault(where + format(": friction threshold_speed = %.6g, must be > 0", f.threshold_speed));
    }
    if (!(std::isfinite(f.viscous) && f.viscous >= 0.0 && std::isfinite(f.quadratic) &&
          f.quadratic >= 0.0 && std::isfinite(f.stribeck) && f.stribeck >= 0.0)) {
      fault(where + format(": friction viscous = %.6g, quadratic = %.6g, stribeck = %.6g, must be "
                           ">= 0",
                           f.viscous, f.quadratic, f.stribeck));
    }
    if (!(std::isfinite(f.stribeck_speed) && f.stribeck_speed > 0.0)) {
      fault(where + format(": friction stribeck_speed = %.6g, must be > 0", f.stribeck_speed));
    }
  }

  void add_surfaces() {
    for (const auto& s : d_.surfaces) {
      const std::string where = "surface \"" + s.name + "\"";
      if (surfaces_.contains(s.name)) fault(where + ": the name is given twice");
      find_body(s.body, where);
      if (!finite(s.point)) fault(where + ": point is not a finite number");
      if (s.kind == SurfaceKind::kLine) {
        if (std::abs(norm(s.normal) - 1.0) > 2e-4) {
          fault(where +
                format(": normal has length %.6g, must be 1 (within 2e-4)", norm(s.normal)));
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

  static const char* kind_name(SurfaceKind kind) {
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

  const SurfaceDescription* find_surface(const std::string& name, const std::string& where) {
    const auto it = surfaces_.find(name);
    if (it != surfaces_.end()) return it->second;
    std::string known;
    for (const auto& s : d_.surfaces) known += (known.empty() ? "" : ", ") + s.name;
    fault(where + ": surface \"" + name + "\" is missing; surfaces are " +
          (known.empty() ? "none" : known));
    return nullptr;
  }

  void add_contacts() {
    std::set<int> numbers;
    for (const auto& c : d_.contacts) {
      const std::string where = format("contact %02d", c.number);
      if (c.number < 1 || c.number > 9999) {
        fault(where + ": number must be between 1 and 9999");
      }
      if (!numbers.insert(c.number).second) fault(where + ": the number is given twice");
      const auto* sa = find_surface(c.surface_a, where);
      const auto* sb = find_surface(c.surface_b, where);
      check_friction(c.friction, where);
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

  void set_geometry(Contact& contact, const SurfaceDescription& sa, const SurfaceDescription& sb,
                    const std::string& where) {
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

  void set_coordinates(std::vector<int>& out, int link_a, int link_b) const {
    std::set<int> both;
    for (const int link : {link_a, link_b}) {
      const auto& path = m_->links[static_cast<std::size_t>(link)].path;
      for (const int motion : path) both.insert(m_->motions[at(motion)].coordinate);
    }
    out.assign(both.begin(), both.end());
  }

  void add_finger() {
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

  void add_motor() {
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

  void add_strings() {
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

  int find_coordinate(const std::string& name, const std::string& where) {
    const int index = m_->coordinate_index(name);
    if (index < 0) {
      std::string known;
      for (const auto& c : m_->coordinates) known += (known.empty() ? "" : ", ") + c;
      fault(where + ": coordinate \"" + name + "\" is missing; coordinates are " + known);
    }
    return index;
  }

  void add_springs() {
    for (const auto& s : d_.springs) {
      const std::string where = "spring \"" + s.name + "\"";
      const int index = find_coordinate(s.coordinate, where);
      if (!(std::isfinite(s.stiffness) && s.stiffness >= 0.0)) {
        fault(where + format(": stiffness = %.6g N m/rad, must be >= 0", s.stiffness));
      }
      if (!std::isfinite(s.rest_angle)) fault(where + ": rest_angle is not a finite number");
      if (!(std::isfinite(s.damping) && s.damping >= 0.0)) {
        fault(where + format(": damping = %.6g N m s/rad, must be >= 0", s.damping));
      }
      if (!(std::isfinite(s.clearance) && s.clearance >= 0.0)) {
        fault(where + format(": clearance = %.6g, must be >= 0", s.clearance));
      } else if (s.clearance > 0.0 && !(std::isfinite(s.seating) && s.seating > 0.0)) {
        fault(where + format(": seating = %.6g, must be > 0 with a clearance", s.seating));
      }
      if (index < 0) continue;
      m_->springs.push_back({s.name, index, s.stiffness, s.rest_angle, {s.clearance, s.seating}});
      m_->joint_friction[at(index)].viscous += s.damping;
    }
  }

  void add_dashpots() {
    for (const auto& s : d_.dashpots) {
      const std::string where = "dashpot \"" + s.name + "\"";
      const int index = find_coordinate(s.coordinate, where);
      if (!(std::isfinite(s.coefficient) && s.coefficient >= 0.0)) {
        fault(where + format(": coefficient = %.6g, must be >= 0", s.coefficient));
      }
      if (index >= 0) m_->dashpots.push_back({index, s.coefficient, s.side});
    }
  }

  void add_straps() {
    for (const auto& s : d_.straps) {
      const std::string where = "strap \"" + s.name + "\"";
      const auto* a = find_body(s.body_a, where);
      const auto* b = find_body(s.body_b, where);
      if (!(std::isfinite(s.free_length) && s.free_length > 0.0)) {
        fault(where + format(": free_length = %.6g m, must be > 0", s.free_length));
      }
      const bool finite_cubic = std::isfinite(s.coefficients[0]) &&
                                std::isfinite(s.coefficients[1]) &&
                                std::isfinite(s.coefficients[2]);
      if (!(finite_cubic && s.coefficients[2] >= 0.0 &&
            (s.coefficients[2] > 0.0 || s.coefficients[1] > 0.0 || s.coefficients[0] > 0.0))) {
        fault(where + ": the cubic never pulls; its leading coefficient must be positive");
      } else if (const auto [k1, k2, k3] = s.coefficients;
                 k1 >= 0.0 && k2 < 0.0 && !(k2 * k2 < 4.0 * k3 * k1)) {
        fault(where +
              format(": the cubic with k1 = %.6g, k2 = %.6g, k3 = %.6g turns negative beyond "
                     "slack",
                     k1, k2, k3));
      }
      if (a == nullptr || b == nullptr) continue;
      Strap strap{s.name,
                  place(*a, s.point_a, where),
                  place(*b, s.point_b, where),
                  s.free_length,
                  s.coefficients,
                  0.0,
                  {}};
      const auto [k1, k2, k3] = s.coefficients;
      if (k1 < 0.0) {
        strap.slack = k3 > 0.0 ? (-k2 + std::sqrt(k2 * k2 - 4.0 * k3 * k1)) / (2.0 * k3) : -k1 / k2;
      }
      set_coordinates(strap.coordinates, strap.a.link, strap.b.link);
      m_->straps.push_back(strap);
    }
  }

  void add_points() {
    std::set<std::string> names;
    for (const auto& p : d_.points) {
      const std::string where = "tracking point \"" + p.name + "\"";
      if (!names.insert(p.name).second) fault(where + ": the name is given twice");
      const auto* body = find_body(p.body, where);
      if (body != nullptr) m_->points.push_back({p.name, place(*body, p.point, where)});
    }
  }

  void add_start_pose() {
    m_->start_pose.assign(m_->coordinates.size(), 0.0);
    for (const auto& [name, value] : d_.start_pose) {
      const int index = find_coordinate(name, "start_pose");
      if (!std::isfinite(value)) fault("start_pose: " + name + " is not a finite number");
      if (index >= 0) m_->start_pose[static_cast<std::size_t>(index)] = value;
    }
  }

  void check_inertia() {
    if (m_->coordinates.empty()) {
      fault("no body has a joint that moves; at least one coordinate is needed");
    }
    // A coordinate needs mass behind it, a revolute one rotational inertia about its pivot.
    for (int k = 0; k < m_->size(); ++k) {
      double mass = 0.0;
      double inertia = 0.0;
      bool rotates = false;
      for (const auto& link : m_->links) {
        for (const int index : link.path) {
          const Motion& motion = m_->motions[at(index)];
          if (motion.coordinate != k) continue;
          rotates = rotates || m_->links[at(motion.link)].kind == LinkKind::kRevolute;
          mass += link.mass;
          inertia += link.inertia + link.mass * dot(link.center_of_mass, link.center_of_mass);
          if (&link != &m_->links[at(motion.link)]) inertia += link.mass;
        }
      }
      if (!(rotates ? inertia > 0.0 : mass > 0.0)) {
        fault("coordinate \"" + m_->coordinates[at(k)] +
              "\" moves no mass: give a mass to its body or to a body beyond it");
      }
    }
  }

  void set_scales() {
    m_->coordinate_scale.assign(m_->coordinates.size(), kFeltTravel);
    std::vector<double> arm(m_->coordinates.size(), 0.0);
    const auto grow = [&](LinkPoint p) {
      const Link& link = m_->links[at(p.link)];
      if (link.kind != LinkKind::kRevolute) return;
      double& a = arm[at(m_->motions[at(link.motions[0])].coordinate)];
      a = std::max(a, norm(p.local));
    };
    for (const auto& c : m_->contacts) {
      grow(c.b);
      grow(c.a);
    }
    for (std::size_t i = 1; i < m_->links.size(); ++i) {
      grow({static_cast<int>(i), m_->links[i].center_of_mass});
    }
    for (std::size_t k = 0; k < arm.size(); ++k) {
      if (arm[k] > 0.0) m_->coordinate_scale[k] = kFeltTravel / arm[k];
    }
  }

  const MechanismDescription& d_;
  std::shared_ptr<Mechanism> m_;
  std::map<std::string, Placement> placement_;
  std::set<std::string> unplaced_;
  std::map<std::string, const SurfaceDescription*> surfaces_;
  std::vector<std::string> faults_;
};

}  // namespace

int Mechanism::coordinate_index(const std::string& coordinate) const {
  const auto it = std::find(coordinates.begin(), coordinates.end(), coordinate);
  return it == coordinates.end() ? -1 : static_cast<int>(it - coordinates.begin());
}

int Mechanism::contact_index(int number) const {
  for (std::size_t i = 0; i < contacts.size(); ++i) {
    if (contacts[i].number == number && !contacts[i].finger) return static_cast<int>(i);
  }
  return -1;
}

int Mechanism::point_index(const std::string& point) const {
  for (std::size_t i = 0; i < points.size(); ++i) {
    if (points[i].name == point) return static_cast<int>(i);
  }
  return -1;
}

std::shared_ptr<const Mechanism> assemble(const MechanismDescription& description) {
  return Assembler(description).run();
}

}  // namespace feltmb
