#include <algorithm>
#include <cmath>

#include "assembler.hpp"
#include "feltmb/core/error.hpp"

namespace feltmb {

std::shared_ptr<const Mechanism> Assembler::run() {
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

const Placement* Assembler::find_body(const std::string& body, const std::string& where) {
  const auto it = placement_.find(body);
  if (it != placement_.end()) return &it->second;
  if (unplaced_.contains(body)) return nullptr;  // its own fault is already listed
  std::string known = "ground";
  for (const auto& b : d_.bodies) known += ", " + b.name;
  fault(where + ": body \"" + body + "\" is missing; bodies are " + known);
  return nullptr;
}

int Assembler::find_coordinate(const std::string& name, const std::string& where) {
  const int index = m_->coordinate_index(name);
  if (index < 0) {
    std::string known;
    for (const auto& c : m_->coordinates) known += (known.empty() ? "" : ", ") + c;
    fault(where + ": coordinate \"" + name + "\" is missing; coordinates are " + known);
  }
  return index;
}

void Assembler::add_springs() {
  for (const auto& s : d_.springs) {
    const std::string where = "spring \"" + s.name + "\"";
    const int index = find_coordinate(s.coordinate, where);
    check(s, where + ": ", site_of(index));
    if (s.clearance > 0.0 && s.seating == 0.0) {
      fault(where + ": seating = 0, must be > 0 with a clearance");
    }
    if (index < 0) continue;
    m_->springs.push_back({s.name, index, s.stiffness, s.rest_angle, {s.clearance, s.seating}});
    m_->joint_friction[as_index(index)].viscous += s.damping;
  }
}

void Assembler::add_dashpots() {
  for (const auto& s : d_.dashpots) {
    const std::string where = "dashpot \"" + s.name + "\"";
    const int index = find_coordinate(s.coordinate, where);
    check(s, where + ": ", site_of(index));
    if (index >= 0) m_->dashpots.push_back({index, s.coefficient, s.side});
  }
}

void Assembler::add_straps() {
  for (const auto& s : d_.straps) {
    const std::string where = "strap \"" + s.name + "\"";
    const auto* a = find_body(s.body_a, where);
    const auto* b = find_body(s.body_b, where);
    check(s, where + ": ");
    const bool finite_cubic = std::isfinite(s.coefficients[0]) &&
                              std::isfinite(s.coefficients[1]) && std::isfinite(s.coefficients[2]);
    if (!(finite_cubic && s.coefficients[2] >= 0.0 &&
          (s.coefficients[2] > 0.0 || s.coefficients[1] > 0.0 || s.coefficients[0] > 0.0))) {
      fault(where + ": the cubic never pulls; its leading coefficient must be positive");
    } else if (const auto [k1, k2, k3] = s.coefficients;
               k1 >= 0.0 && k2 < 0.0 && !(k2 * k2 < 4.0 * k3 * k1)) {
      fault(where + format(": the cubic with k1 = %.6g, k2 = %.6g, k3 = %.6g turns negative beyond "
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

void Assembler::add_points() {
  std::set<std::string> names;
  for (const auto& p : d_.points) {
    const std::string where = "tracking point \"" + p.name + "\"";
    if (!names.insert(p.name).second) fault(where + ": the name is given twice");
    const auto* body = find_body(p.body, where);
    if (body != nullptr) m_->points.push_back({p.name, place(*body, p.point, where)});
  }
}

void Assembler::add_start_pose() {
  m_->start_pose.assign(m_->coordinates.size(), 0.0);
  for (const auto& [name, value] : d_.start_pose) {
    const int index = find_coordinate(name, "start_pose");
    if (!std::isfinite(value)) fault("start_pose: " + name + " is not a finite number");
    if (index >= 0) m_->start_pose[static_cast<std::size_t>(index)] = value;
  }
}

void Assembler::check_inertia() {
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
        const Motion& motion = m_->motions[as_index(index)];
        if (motion.coordinate != k) continue;
        rotates = rotates || m_->links[as_index(motion.link)].kind == LinkKind::kRevolute;
        mass += link.mass;
        inertia += link.inertia + link.mass * dot(link.center_of_mass, link.center_of_mass);
        if (&link != &m_->links[as_index(motion.link)]) inertia += link.mass;
      }
    }
    if (!(rotates ? inertia > 0.0 : mass > 0.0)) {
      fault("coordinate \"" + m_->coordinates[as_index(k)] +
            "\" moves no mass: give a mass to its body or to a body beyond it");
    }
  }
}

void Assembler::set_scales() {
  m_->coordinate_scale.assign(m_->coordinates.size(), kFeltTravel);
  std::vector<double> arm(m_->coordinates.size(), 0.0);
  const auto grow = [&](LinkPoint p) {
    const Link& link = m_->links[as_index(p.link)];
    if (link.kind != LinkKind::kRevolute) return;
    double& a = arm[as_index(m_->motions[as_index(link.motions[0])].coordinate)];
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
