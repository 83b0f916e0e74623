#include "shifted_models.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <exception>

#include "feltmb/core/error.hpp"
#include "feltmb/core/index.hpp"
#include "feltmb/model/equilibrium.hpp"

namespace feltmb::detail {

ShiftedModels::ShiftedModels(const std::shared_ptr<const Mechanism>& mechanism,
                             const InputSignal& input,
                             const std::vector<SensitivityParameter>& parameters,
                             const SensitivityOptions& options, bool rest)
    : mechanism_(mechanism), input_(input), options_(options) {
  const auto make = [](const std::shared_ptr<const Mechanism>& m, const InputSignal& i) {
    return std::make_unique<MechanismSystem>(m, i, false, std::vector<Monitor>{}, false);
  };
  // cppcheck-suppress useInitializationList  // both are made alike
  base_ = make(mechanism, input);
  probe_ = make(mechanism, input);
  const std::size_t states = base_->size();
  const std::vector<double> atol = base_->absolute_tolerances(1.0);
  weight_.resize(static_cast<Eigen::Index>(states));
  for (std::size_t i = 0; i < states; ++i) weight_[static_cast<Eigen::Index>(i)] = 1.0 / atol[i];
  scratch_.resize(states);
  for (const auto& beam : mechanism->beams) {
    for (int k = 0; beam.condense_axial && k < beam.shapes.axial(); ++k) {
      condensed_.push_back(beam.first + k);
    }
  }
  parameters_.resize(parameters.size());
  for (std::size_t j = 0; j < parameters.size(); ++j) {
    floor_.push_back(1e-2 / parameters[j].scale);
    for (const Perturbed& p : parameters[j].nodes) {
      Node node;
      node.system = make(p.mechanism, p.input);
      const Mechanism& m = *p.mechanism;
      if (node.system->size() != states || m.contacts.size() != mechanism->contacts.size() ||
          m.coordinates != mechanism->coordinates) {
        throw InvalidParameter("parameter \"" + parameters[j].name +
                               "\" changes the number of states: it has no derivative");
      }
      node.mechanism = p.mechanism;
      node.shift = p.shift;
      node.weight = p.weight;
      node.input = p.input;
      parameters_[j].push_back(std::move(node));
    }
    changes_.push_back(find_changes(*mechanism, input, parameters[j].nodes));
    if (options.whole_models) {
      changes_.back() = {};
      changes_.back().motions = true;
    }
  }
  if (rest) find_rests();
}

void ShiftedModels::find_rests() {
  const std::size_t states = base_->size();
  const auto count = static_cast<Eigen::Index>(parameters_.size());
  rest_columns_.state.setZero(static_cast<Eigen::Index>(states), count);
  rest_columns_.memory.setZero(static_cast<Eigen::Index>(mechanism_->contacts.size()), count);
  rest_ = find_rest(mechanism_, {}, input_);
  const std::vector<double> near(rest_.state.data(), rest_.state.data() + mechanism_->size());
  // Polished like the shifted ones, so that their differences are of the parameter only.
  rest_ = find_rest(mechanism_, near, input_);
  base_->set_finger_reference(rest_.finger);
  probe_->set_finger_reference(rest_.finger);
  base_->locate(0.0, {rest_.state.data(), states});
  for (std::size_t j = 0; j < parameters_.size(); ++j) {
    // Contacts that are open at rest do not move the rest pose.
    const Changes& changes = changes_[j];
    const bool still =
        changes.only_contacts() && std::none_of(changes.contacts.begin(), changes.contacts.end(),
                                                [&](const auto& of) { return closed(of.contact); });
    for (Node& node : parameters_[j]) {
      const bool same = still || node.mechanism == mechanism_;
      const Rest moved = same ? rest_ : find_rest(node.mechanism, near, node.input);
      node.levels = moved.levels;
      node.system->set_finger_reference(moved.finger);
      rest_columns_.state.col(static_cast<Eigen::Index>(j)) += node.weight * moved.state;
      rest_columns_.memory.col(static_cast<Eigen::Index>(j)) += node.weight * moved.memory;
    }
  }
}

void ShiftedModels::begin(double begin, std::size_t directions, std::span<const double> start,
                          const RowMatrix& moves) {
  directions_ = directions;
  const auto set = [&](MechanismSystem& system, double origin, std::span<const double> place) {
    system.set_origin(origin + begin);
    system.set_prescribed_reference(0.0, place);
  };
  set(*base_, input_.origin, start);
  set(*probe_, input_.origin, start);
  std::vector<double> own(start.begin(), start.end());
  for (std::size_t j = 0; j < parameters_.size(); ++j) {
    for (auto& node : parameters_[j]) {
      for (std::size_t i = 0; is_prescribed(input_.kind) && i < own.size(); ++i) {
        own[i] = start[i] +
                 node.shift * moves(static_cast<Eigen::Index>(i), static_cast<Eigen::Index>(j));
      }
      set(*node.system, node.input.origin, own);
    }
  }
  reference_.assign(parameters_.size(), 0.0);
  for (std::size_t j = 0; is_prescribed(input_.kind) && j < parameters_.size(); ++j) {
    if (!changes_[j].input) reference_[j] = wanted(j, 0.0);
  }
}

ShiftedModels::Rest ShiftedModels::find_rest(const std::shared_ptr<const Mechanism>& mechanism,
                                             std::span<const double> near,
                                             const InputSignal& input) {
  const Equilibrium found = find_equilibrium(mechanism, 0.0, near);
  Rest rest;
  MechanismSystem system(mechanism, input, false, {}, false);
  rest.state.setZero(static_cast<Eigen::Index>(system.size()));
  double* y = rest.state.data();
  std::copy(found.q.begin(), found.q.end(), y);
  double* laws = y + 2 * found.q.size();
  std::copy(found.law.begin(), found.law.end(), laws);
  std::copy(found.eta.begin(), found.eta.end(), laws + found.law.size());
  rest.memory = Eigen::Map<const Eigen::VectorXd>(
      found.largest_compression.data(),
      static_cast<Eigen::Index>(found.largest_compression.size()));
  system.locate(0.0, {y, system.size()});
  if (mechanism->finger_contact >= 0) {
    rest.finger =
        dot(mechanism->finger_direction, system.dynamics().position(mechanism->finger_point));
  }
  for (const auto& rule : options_.rules) {
    const auto& point = mechanism->points[static_cast<std::size_t>(rule.point)].point;
    rest.levels.push_back(dot(rule.direction, system.dynamics().position(point)) + rule.travel);
  }
  return rest;
}

SimulationState ShiftedModels::rest() const {
  SimulationState out;
  out.y.assign(rest_.state.begin(), rest_.state.end());
  out.largest_compression.assign(rest_.memory.begin(), rest_.memory.end());
  return out;
}

double ShiftedModels::level(std::size_t rule, int parameter, std::size_t node) const {
  if (parameter < 0) return rest_.levels[rule];
  return parameters_[static_cast<std::size_t>(parameter)][node].levels[rule];
}

void ShiftedModels::rates(double t, std::span<const double> y, std::span<const double> memory,
                          const Eigen::MatrixXd& memory_columns, RowMatrix& out, RowMatrix& loads) {
  loads.setZero(base_->coordinates(), static_cast<Eigen::Index>(columns()));
  out.setZero(out.rows(), static_cast<Eigen::Index>(columns()));
  has_base_ = false;
  find_pieces(*base_);
  one_.resize(base_->coordinates());
  const Drive drive = base_->drive(t);
  for (std::size_t j = 0; j < parameters_.size(); ++j) {
    const Changes& changes = changes_[j];
    if (!told_by_parts(changes, drive)) {
      whole_rates(j, t, y, memory, out);
      continue;
    }
    one_.setZero();
    for (const auto& of : changes.contacts) add_contact(j, of, t, y, out);
    add_links(changes);
    add_members(j, y);
    if (!changes.straps.empty()) add_straps(j);
    if (is_prescribed(input_.kind)) {
      add_prescription(j, t, out);
    } else if (changes.input || changes.finger) {
      add_finger(j, t);
    }
    if (changes.strings) add_modes(j, y, out);
    for (const int k : condensed_) one_[k] = 0.0;
    loads.col(static_cast<Eigen::Index>(j)) = one_;
  }
  if (!memory.empty()) memory_rates(memory_columns, out, loads);
}

/// Whether the forces of the parts that changed, each at the state of the base, are all there is.
bool ShiftedModels::told_by_parts(const Changes& changes, const Drive& drive) const {
  if (changes.motions) return false;
  if ((is_prescribed(drive.kind) && changes.finger) ||
      (drive.kind == InputKind::kMotion && changes.input)) {
    return false;
  }
  if (changes.shapes) {
    for (const StringContact& c : mechanism_->string_contacts) {
      if (closed(static_cast<std::size_t>(c.contact))) return false;
    }
  }
  return std::none_of(changes.contacts.begin(), changes.contacts.end(), [&](const auto& of) {
    return of.geometry && mechanism_->contacts[of.contact].string_contact >= 0 &&
           closed(of.contact);
  });
}

void ShiftedModels::whole_rates(std::size_t j, double t, std::span<const double> y,
                                std::span<const double> memory, RowMatrix& out) {
  three_.resize(static_cast<Eigen::Index>(y.size()));
  if (!has_base_) {
    // The base was evaluated here to be linearized.
    two_.resize(three_.size());
    base_->read_rates(y, {two_.data(), y.size()});
    has_base_ = true;
  }
  const Node& node = beside(j, [&](const Node& each) {
    remember(*each.system, memory);
    each.system->rhs(t, y, {three_.data(), y.size()});
    return on_pieces(*each.system);
  });
  const auto n = out.rows();
  out.col(static_cast<Eigen::Index>(j)) = (three_.head(n) - two_.head(n)) / node.shift;
}

template <class Evaluate>
const ShiftedModels::Node& ShiftedModels::beside(std::size_t j, Evaluate&& evaluate) {
  const Node& first = nearest(parameters_[j]);
  ++evaluations_;
  if (evaluate(first)) return first;
  for (const Node& node : parameters_[j]) {
    if (&node == &first || node.shift == 0.0) continue;
    ++evaluations_;
    if (evaluate(node)) return node;
  }
  evaluate(first);
  return first;
}

void ShiftedModels::find_pieces(const MechanismSystem& system) {
  pieces_.clear();
  for (std::size_t c = 0; c < mechanism_->contacts.size(); ++c) {
    pieces_.push_back(piece_of(system, c));
  }
}

bool ShiftedModels::on_pieces(const MechanismSystem& system) const {
  for (std::size_t c = 0; c < pieces_.size(); ++c) {
    if (piece_of(system, c) != pieces_[c]) return false;
  }
  return true;
}

/// One side is enough where the value in the middle is known: the shift is a millionth of the
/// parameter, its curvature is not seen.
const ShiftedModels::Node& ShiftedModels::nearest(const std::vector<Node>& nodes) {
  std::size_t best = 0;
  for (std::size_t k = 1; k < nodes.size(); ++k) {
    const double shift = std::fabs(nodes[k].shift);
    const double least = std::fabs(nodes[best].shift);
    if (shift > 0.0 && (least == 0.0 || shift < least)) best = k;
  }
  return nodes[best];
}

void ShiftedModels::memory_rates(const Eigen::MatrixXd& memory_columns, RowMatrix& out,
                                 RowMatrix& loads) {
  Dynamics& dynamics = base_->dynamics();
  const int n = base_->coordinates();
  constexpr double shift = 1e-9;  // m of remembered compression
  for (std::size_t c = 0; c < mechanism_->contacts.size(); ++c) {
    const Contact& contact = mechanism_->contacts[c];
    const auto row = memory_columns.row(static_cast<Eigen::Index>(c));
    if (!contact.law.has_memory() || row.isZero(0.0)) continue;
    const ContactState& s = dynamics.contacts()[c];
    if (!s.closed && contact.law.n_states() == 0) continue;
    double force = 0.0;
    std::array<double, kMaxLawStates> rates{};
    const double compression = s.closed ? s.compression : std::min(0.0, s.compression);
    const double rate = s.closed ? s.rate : 0.0;
    LawMemory up = dynamics.memory(c);
    LawMemory down = up;
    up.largest += shift;
    down.largest -= shift;
    const int piece = contact.law.piece(compression, rate, dynamics.memory(c));
    const auto on = [&](const LawMemory& m) {
      return contact.law.piece(compression, rate, m) == piece;
    };
    const Sides weights(on(up), on(down), shift);
    for (const auto& [memory, weight] :
         {std::pair{up, weights.up}, {down, weights.down}, {dynamics.memory(c), weights.middle}}) {
      LawStates states;
      const LawValue v = contact.law.evaluate(compression, rate, memory, &states);
      if (s.closed) force += weight * v.force;
      for (std::size_t i = 0; i < contact.law.n_states(); ++i) rates[i] += weight * states.rate[i];
      ++evaluations_;
    }
    for (std::size_t i = 0; i < contact.law.n_states(); ++i) {
      out.row(2 * n + contact.first_state + static_cast<int>(i)) += rates[i] * row;
    }
    if (force == 0.0) continue;
    loads.noalias() += (force * by_force(c)) * row;
    for (Eigen::Index j = 0; j < row.cols(); ++j) add_string_force(c, force * row[j], j, out);
  }
}

/// A contact force acts on its string, if it has one and that is integrated.
void ShiftedModels::add_string_force(std::size_t contact, double force, Eigen::Index column,
                                     RowMatrix& out) {
  const int index = mechanism_->contacts[contact].string_contact;
  if (index < 0 || out.rows() < static_cast<Eigen::Index>(base_->size())) return;
  const auto phi = base_->dynamics().phi(index);
  const AttachedString& string =
      mechanism_->string_of(mechanism_->string_contacts[static_cast<std::size_t>(index)]);
  const auto first = static_cast<Eigen::Index>(first_mode() + modes()) + string.offset;
  for (std::size_t k = 0; k < phi.size(); ++k) {
    out(first + static_cast<Eigen::Index>(k), column) += force * phi[k];
  }
}

const Eigen::VectorXd& ShiftedModels::by_force(std::size_t contact) {
  const auto gradients = base_->dynamics().gradients();
  const auto own = std::find_if(gradients.begin(), gradients.end(), [&](const auto& g) {
    return g.contact == static_cast<int>(contact);
  });
  return own->by_force;
}

void ShiftedModels::add_contact(std::size_t j, const Changes::OfContact& of, double t,
                                std::span<const double> y, RowMatrix& out) {
  const std::size_t c = of.contact;
  const Dynamics& dynamics = base_->dynamics();
  const Contact& contact = mechanism_->contacts[c];
  const ContactState& s = dynamics.contacts()[c];
  if (!s.closed && contact.law.still_when_open()) return;
  const Node& node = beside(j, [&](const Node& each) {
    if (!of.geometry) return true;
    each.system->dynamics().press(c, dynamics, base_->parts(y), each.system->drive(t));
    return piece_of(*each.system, c) == pieces_[c];
  });
  const double per_shift = 1.0 / node.shift;
  const auto column = static_cast<Eigen::Index>(j);
  const auto add_states = [&](const LawStates& moved) {
    const auto first = static_cast<Eigen::Index>(2 * base_->coordinates() + contact.first_state);
    for (std::size_t i = 0; i < contact.law.n_states(); ++i) {
      out(first + static_cast<Eigen::Index>(i), column) +=
          (moved.rate[i] - dynamics.law_states(c).rate[i]) * per_shift;
    }
  };
  const auto push = [&](Vec2 force, double moment) {
    base_->dynamics().add_wrench(contact.b.link, force, moment, one_);
    if (contact.a.link != 0) {
      base_->dynamics().add_wrench(contact.a.link, -force, -moment, one_);
    }
  };
  if (of.geometry) {
    const Dynamics& other = node.system->dynamics();
    const ContactState& moved = other.contacts()[c];
    add_states(other.law_states(c));
    if (!s.closed) return;
    const auto force_of = [](const ContactState& at) {
      return at.law.force * (at.normal - at.friction.value * perp(at.normal));
    };
    const Vec2 before = force_of(s);
    const Vec2 after = moved.closed ? force_of(moved) : Vec2{};
    push(per_shift * (after - before),
         per_shift * (cross(moved.point, after) - cross(s.point, before)));
    return;
  }
  const Contact& other = node.system->mechanism().contacts[c];
  if (of.law) {
    LawStates states;
    const LawMemory own = dynamics.memory(c);
    const LawValue v = s.closed
                           ? other.law.evaluate(s.compression, s.rate, own, &states)
                           : other.law.evaluate(std::min(0.0, s.compression), 0.0, own, &states);
    add_states(states);
    const double force = s.closed ? (v.force - s.law.force) * per_shift : 0.0;
    if (force != 0.0) {
      one_ += force * by_force(c);
      add_string_force(c, force, column, out);
    }
  }
  if (of.friction && s.closed) {
    const double more = other.friction.at(s.slip).value - s.friction.value;
    const Vec2 force = (-s.law.force * more * per_shift) * perp(s.normal);
    push(force, cross(s.point, force));
  }
}

void ShiftedModels::add_links(const Changes& changes) {
  // M a = Q is linear in mass, first moment and inertia: minus their inertial force and weight.
  const Dynamics& dynamics = base_->dynamics();
  for (const auto& of : changes.links) {
    const LinkState& s = dynamics.links()[static_cast<std::size_t>(of.link)];
    const Vec2 r = s.rotation * of.first;
    const Vec2 a = s.acceleration - mechanism_->gravity;
    const Vec2 force = (-of.mass) * a - s.alpha * perp(r) + (s.omega * s.omega) * r;
    const double moment = -(cross(r, a) + of.second * s.alpha);
    dynamics.add_wrench(of.link, force, cross(s.origin, force) + moment, one_);
  }
  if (changes.gravity == Vec2{}) return;
  for (std::size_t i = 1; i < mechanism_->links.size(); ++i) {
    const Link& link = mechanism_->links[i];
    if (link.mass == 0.0) continue;
    const LinkState& s = dynamics.links()[i];
    const Vec2 force = link.mass * changes.gravity;
    const Vec2 center = s.origin + s.rotation * link.center_of_mass;
    dynamics.add_wrench(static_cast<int>(i), force, cross(center, force), one_);
  }
}

/// Springs, dashpots, friction of joints, beams.
void ShiftedModels::add_members(std::size_t j, std::span<const double> y) {
  const auto n = static_cast<std::size_t>(base_->coordinates());
  const auto q = y.first(n);
  const auto v = y.subspan(n, n);
  const Changes& changes = changes_[j];
  for (const Node& node : parameters_[j]) {
    const Mechanism& m = *node.mechanism;
    for (const std::size_t k : changes.joints) {
      one_[static_cast<Eigen::Index>(k)] -= node.weight * m.joint_friction[k].at(v[k]).value;
    }
    for (const std::size_t i : changes.dashpots) {
      const Dashpot& d = m.dashpots[i];
      one_[d.coordinate] -= node.weight * d.against(v[as_index(d.coordinate)]).value;
    }
    for (const std::size_t i : changes.springs) {
      const TorsionSpring& spring = m.springs[i];
      const double x = q[as_index(spring.coordinate)] - spring.rest_angle;
      one_[spring.coordinate] -= node.weight * (spring.stiffness * x + spring.play.at(x).force);
    }
  }
  for (const auto& of : changes.beams) {
    const Eigen::Index count = of.stiffness.rows();
    const Eigen::Map<const Eigen::VectorXd> bend(q.data() + of.first, count);
    const Eigen::Map<const Eigen::VectorXd> rate(v.data() + of.first, count);
    one_.segment(of.first, count) -= of.stiffness * bend + of.damping * rate;
  }
}

void ShiftedModels::add_straps(std::size_t j) {
  const Dynamics& dynamics = base_->dynamics();
  for (const std::size_t i : changes_[j].straps) {
    for (const Node& node : parameters_[j]) {
      const Strap& strap = node.system->mechanism().straps[i];
      const Vec2 a = dynamics.position(strap.a);
      const Vec2 b = dynamics.position(strap.b);
      const Vec2 pull = node.weight * strap.pull(b - a);
      dynamics.add_wrench(strap.a.link, pull, cross(a, pull), one_);
      dynamics.add_wrench(strap.b.link, -pull, -cross(b, pull), one_);
    }
  }
}

/// A force, of the finger or of a motor, or where the finger is.
void ShiftedModels::add_finger(std::size_t j, double t) {
  for (const Node& node : parameters_[j]) {
    const Drive drive = node.system->drive(t);
    if (drive.kind == InputKind::kMotion) return;
    if (drive.coordinate >= 0) {
      one_[drive.coordinate] += node.weight * drive.force;
      continue;
    }
    const Mechanism& m = node.system->mechanism();
    const Vec2 force = (node.weight * drive.force) * m.finger_direction;
    const Vec2 place = base_->dynamics().position(m.finger_point);
    base_->dynamics().add_wrench(m.finger_point.link, force, cross(place, force), one_);
  }
}

/// Change of the acceleration that a prescribed motion wants, see Prescription.
double ShiftedModels::wanted(std::size_t j, double t) {
  constexpr double c = Prescription::rate;
  double sum = 0.0;
  for (const Node& node : parameters_[j]) {
    const Drive drive = node.system->drive(t);
    sum += node.weight * (drive.acceleration + 2.0 * c * drive.speed + c * c * drive.displacement);
  }
  return sum;
}

/// The reaction sees to it that the accelerations change along its row as the motion wants.
void ShiftedModels::add_prescription(std::size_t j, double t, RowMatrix& out) {
  const double change = changes_[j].input ? wanted(j, t) : reference_[j];
  if (change == 0.0) return;
  const Eigen::VectorXd& row = base_->dynamics().prescription().row;
  two_ = row;
  has_base_ = false;
  base_->dynamics().solve_mass(two_);
  out.col(static_cast<Eigen::Index>(j)).segment(base_->coordinates(), base_->coordinates()) +=
      change / row.dot(two_) * two_;
}

void ShiftedModels::add_modes(std::size_t j, std::span<const double> y, RowMatrix& out) const {
  if (out.rows() < static_cast<Eigen::Index>(y.size())) return;
  const Changes& changes = changes_[j];
  const std::size_t eta = first_mode();
  for (std::size_t i = 0; i < modes(); ++i) {
    out(static_cast<Eigen::Index>(eta + modes() + i), static_cast<Eigen::Index>(j)) -=
        changes.mode_stiffness[i] * y[eta + i] + changes.mode_damping[i] * y[eta + modes() + i];
  }
}

void ShiftedModels::places(std::span<const double> y, const RowMatrix& columns,
                           std::span<const PlaceOf> wanted, Eigen::MatrixXd& out) {
  const Eigen::Index n = base_->coordinates();
  probe_->place(y);
  const Dynamics& dynamics = probe_->dynamics();
  out.resize(static_cast<Eigen::Index>(wanted.size()), columns.cols());
  one_.resize(n);
  Eigen::Index row = 0;
  for (const PlaceOf& of : wanted) {
    if (of.state >= 0) {
      out.row(row++) = columns.row(of.state);
      continue;
    }
    // What a unit rate does to a point is what a unit force at it does to a coordinate.
    const LinkPoint point = mechanism_->points[static_cast<std::size_t>(of.point)].point;
    one_.setZero();
    dynamics.add_wrench(point.link, of.direction, cross(dynamics.position(point), of.direction),
                        one_);
    out.row(row) = one_.transpose() * columns.topRows(n);
    for (std::size_t j = 0; j < parameters_.size(); ++j) {
      if (!changes_[j].points && !changes_[j].motions) continue;
      for (const Node& node : parameters_[j]) {
        node.system->place(y);
        const auto& own = node.mechanism->points[static_cast<std::size_t>(of.point)].point;
        out(row, static_cast<Eigen::Index>(j)) +=
            node.weight * dot(of.direction, node.system->dynamics().position(own));
      }
    }
    ++row;
  }
}

void ShiftedModels::add_recovery(std::size_t contact, double remembered, double open, double time,
                                 Eigen::MatrixXd& memory_columns) const {
  for (std::size_t j = 0; j < parameters_.size(); ++j) {
    double sum = 0.0;
    for (const Node& node : parameters_[j]) {
      const double recovery = node.system->mechanism().contacts[contact].law.recovery_time();
      const double own = recovery > 0.0 ? 1.0 / recovery : 0.0;
      sum += node.weight * std::exp(open * (1.0 / time - own));
    }
    memory_columns(static_cast<Eigen::Index>(contact), static_cast<Eigen::Index>(j)) +=
        remembered * sum;
  }
}

void ShiftedModels::stop_time(std::size_t index, Eigen::VectorXd& out) const {
  out.setZero(static_cast<Eigen::Index>(columns()));
  for (std::size_t j = 0; j < parameters_.size(); ++j) {
    for (const Node& node : parameters_[j]) {
      const auto& breakpoints = node.input.profile.breakpoints();
      const auto& knots = node.input.profile.knots();
      // A shift that removes or adds a breakpoint has no derivative; it then moves none.
      const std::size_t count = input_.profile.breakpoints().size();
      if (breakpoints.size() != count) continue;
      const double t = index < count ? breakpoints[index] : knots[index - count];
      out[static_cast<Eigen::Index>(j)] += node.weight * (t - node.input.origin);
    }
  }
}

}  // namespace feltmb::detail
