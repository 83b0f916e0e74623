#include "shifted_models.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <exception>

#include "feltmb/core/error.hpp"
#include "feltmb/model/equilibrium.hpp"

namespace feltmb::detail {

ShiftedModels::ShiftedModels(const std::shared_ptr<const Mechanism>& mechanism, const Input& input,
                             const std::vector<SensitivityParameter>& parameters,
                             const SensitivityOptions& options)
    : mechanism_(mechanism), input_(input), options_(options) {
  const auto make = [](const std::shared_ptr<const Mechanism>& m, const Input& i) {
    return std::make_unique<MechanismSystem>(m, i, false, std::vector<Monitor>{}, false);
  };
  // cppcheck-suppress useInitializationList  // both are made alike
  base_ = make(mechanism, input);
  probe_ = make(mechanism, input);
  const std::size_t states = base_->size();
  const auto contacts = static_cast<Eigen::Index>(mechanism->contacts.size());
  const std::vector<double> atol = base_->absolute_tolerances(1.0);
  weight_.resize(static_cast<Eigen::Index>(states));
  for (std::size_t i = 0; i < states; ++i) weight_[static_cast<Eigen::Index>(i)] = 1.0 / atol[i];
  scratch_.resize(states);
  try {
    rest_ = find_rest(mechanism, {}, input);
  } catch (const ModelError&) {
    // Segments from a given state need none, unless the input or an event is counted from it.
    if (is_motion(input.kind) || !options.rules.empty()) throw;
    no_rest_ = std::current_exception();
  }
  const auto count = static_cast<Eigen::Index>(parameters.size());
  rest_columns_.state.setZero(static_cast<Eigen::Index>(states), count);
  rest_columns_.memory.setZero(contacts, count);
  std::vector<double> near;
  if (!no_rest_) near.assign(rest_.state.data(), rest_.state.data() + mechanism->size());
  // Polished like the shifted ones, so that their differences are of the parameter only.
  if (!no_rest_) rest_ = find_rest(mechanism, near, input);
  base_->set_finger_reference(rest_.finger);
  probe_->set_finger_reference(rest_.finger);
  parameters_.resize(parameters.size());
  for (const auto& beam : mechanism->beams) {
    for (int k = 0; beam.condense_axial && k < beam.shapes.axial(); ++k) {
      condensed_.push_back(beam.first + k);
    }
  }
  for (const auto& parameter : parameters) {
    inertial_.emplace_back();
    for (std::size_t i = 1;
         parameter.inertial && !is_prescribed(input.kind) && i < mechanism->links.size(); ++i) {
      InertialShift shift{i, 0.0, {}, 0.0};
      for (const Perturbed& p : parameter.nodes) {
        const Link& link = p.mechanism->links[i];
        const Vec2 c = link.center_of_mass;
        shift.mass += p.weight * link.mass;
        shift.first += (p.weight * link.mass) * c;
        shift.second += p.weight * (link.inertia + link.mass * dot(c, c));
      }
      if (shift.mass != 0.0 || dot(shift.first, shift.first) != 0.0 || shift.second != 0.0) {
        inertial_.back().push_back(shift);
      }
    }
  }
  for (const auto& parameter : parameters) {
    modal_.emplace_back();
    if (!parameter.modal || is_prescribed(input.kind) || mechanism->strings.empty()) continue;
    auto shift = std::make_unique<ModalShift>();
    const auto modes = static_cast<std::size_t>(mechanism->total_modes);
    shift->stiffness.assign(modes, 0.0);
    shift->damping.assign(modes, 0.0);
    for (const Perturbed& p : parameter.nodes) {
      for (std::size_t s = 0; s < mechanism->strings.size(); ++s) {
        const AttachedString& own = p.mechanism->strings[s];
        const auto first = static_cast<std::size_t>(own.offset);
        for (std::size_t i = 0; i < own.string.stiffness().size(); ++i) {
          shift->stiffness[first + i] += p.weight * own.string.stiffness()[i];
          shift->damping[first + i] += p.weight * own.string.damping()[i];
        }
        const ModalString& base = mechanism->strings[s].string;
        if (own.string.parameters().length != base.parameters().length ||
            own.string.shape_scale() != base.shape_scale()) {
          shift->shapes = true;
        }
      }
    }
    modal_.back() = std::move(shift);
  }
  if (!no_rest_) base_->locate(0.0, {rest_.state.data(), states});
  for (const auto& parameter : parameters) {
    floor_.push_back(1e-2 / parameter.scale);
    law_.push_back(is_prescribed(input.kind) ? -1 : parameter.law);
    contacts_.push_back(parameter.contacts);
  }
  for (std::size_t j = 0; j < parameters.size(); ++j) {
    for (const Perturbed& p : parameters[j].nodes) {
      Node node;
      node.system = make(p.mechanism, p.input);
      const Mechanism& m = *p.mechanism;
      if (node.system->size() != states || m.contacts.size() != mechanism->contacts.size() ||
          m.coordinates != mechanism->coordinates) {
        throw InvalidParameter("parameter \"" + parameters[j].name +
                               "\" changes the number of states: it has no derivative");
      }
      node.shift = p.shift;
      node.weight = p.weight;
      node.input = p.input;
      if (no_rest_) {
        parameters_[j].push_back(std::move(node));
        continue;
      }
      // A contact that is open at rest does not move the rest pose.
      const int law = parameters[j].law;
      const bool same =
          p.mechanism == mechanism ||
          (law >= 0 && !base_->dynamics().contacts()[static_cast<std::size_t>(law)].closed) ||
          (parameters[j].contacts && !any_closed(*parameters[j].contacts));
      const Rest moved = same ? rest_ : find_rest(p.mechanism, near, p.input);
      node.levels = moved.levels;
      if (is_prescribed(input.kind)) node.rest.assign(moved.state.begin(), moved.state.end());
      node.system->set_finger_reference(moved.finger);
      rest_columns_.state.col(static_cast<Eigen::Index>(j)) += p.weight * moved.state;
      rest_columns_.memory.col(static_cast<Eigen::Index>(j)) += p.weight * moved.memory;
      parameters_[j].push_back(std::move(node));
    }
  }
  begin(0.0, 0, {}, false);
}

void ShiftedModels::begin(double begin, std::size_t directions, std::span<const double> start,
                          bool from_rest) {
  directions_ = directions;
  const auto set = [&](MechanismSystem& system, double origin, std::span<const double> place) {
    system.set_origin(origin + begin);
    if (!place.empty()) system.set_prescribed_reference(0.0, place);
  };
  set(*base_, input_.origin, start);
  set(*probe_, input_.origin, start);
  for (auto& nodes : parameters_) {
    for (auto& node : nodes) {
      const bool own = from_rest && !node.rest.empty();
      set(*node.system, node.input.origin, own ? std::span<const double>(node.rest) : start);
    }
  }
}

ShiftedModels::Rest ShiftedModels::find_rest(const std::shared_ptr<const Mechanism>& mechanism,
                                             std::span<const double> near, const Input& input) {
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
  if (no_rest_) std::rethrow_exception(no_rest_);
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
                          const Eigen::MatrixXd& memory_columns, RowMatrix& out) {
  loads_.setZero(base_->coordinates(), static_cast<Eigen::Index>(columns()));
  out.setZero(out.rows(), static_cast<Eigen::Index>(columns()));
  const auto n = out.rows();
  const bool strings = n == static_cast<Eigen::Index>(y.size());
  three_.resize(static_cast<Eigen::Index>(y.size()));
  const std::span<double> rate{three_.data(), y.size()};
  bool has_base = false;
  const bool touched = std::any_of(
      mechanism_->strings.begin(), mechanism_->strings.end(), [&](const AttachedString& s) {
        return base_->dynamics().contacts()[static_cast<std::size_t>(s.contact)].closed;
      });
  for (std::size_t j = 0; j < parameters_.size(); ++j) {
    const auto column = static_cast<Eigen::Index>(j);
    if (law_[j] >= 0) {
      law_rates(j, out);
      continue;
    }
    if (!inertial_[j].empty()) {
      inertial_loads(j);
      continue;
    }
    if (modal_[j] && !(touched && modal_[j]->shapes)) {
      if (strings) modal_rates(j, y, out);
      continue;
    }
    if (contacts_[j] && !any_closed(*contacts_[j])) continue;
    if (input_loads(j, t)) continue;
    const Node& node = nearest(parameters_[j]);
    if (!has_base) base_rates(y);
    has_base = true;
    remember(*node.system, memory);
    node.system->rhs(t, y, rate);
    out.col(column) = (three_.head(n) - two_.head(n)) / node.shift;
    ++evaluations_;
  }
  if (memory.empty()) return;
  if (!is_prescribed(input_.kind)) {
    memory_rates(memory_columns, out);
    return;
  }
  // The reaction of the prescribed motion takes part.
  moved_memory_.assign(memory.begin(), memory.end());
  constexpr double shift = 1e-9;  // m of remembered compression
  for (std::size_t c = 0; c < memory.size(); ++c) {
    const auto row = memory_columns.row(static_cast<Eigen::Index>(c));
    if (row.isZero(0.0)) continue;
    for (const double sign : {1.0, -1.0}) {
      moved_memory_[c] = memory[c] + sign * shift;
      remember(*probe_, moved_memory_);
      probe_->rhs(t, y, rate);
      out.noalias() += (sign * 0.5 / shift * three_.head(n)) * row;
      ++evaluations_;
    }
    moved_memory_[c] = memory[c];
  }
  remember(*probe_, memory);
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

bool ShiftedModels::any_closed(const std::vector<int>& contacts) const {
  return std::any_of(contacts.begin(), contacts.end(), [&](int c) {
    return base_->dynamics().contacts()[static_cast<std::size_t>(c)].closed;
  });
}

void ShiftedModels::memory_rates(const Eigen::MatrixXd& memory_columns, RowMatrix& out) {
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
    for (const double sign : {1.0, -1.0}) {
      LawMemory moved = dynamics.memory(c);
      moved.largest += sign * shift;
      LawStates states;
      const LawValue v =
          s.closed ? contact.law.evaluate(s.compression, s.rate, moved, &states)
                   : contact.law.evaluate(std::min(0.0, s.compression), 0.0, moved, &states);
      const double weight = sign * 0.5 / shift;
      if (s.closed) force += weight * v.force;
      for (std::size_t i = 0; i < contact.law.n_states(); ++i) rates[i] += weight * states.rate[i];
      ++evaluations_;
    }
    for (std::size_t i = 0; i < contact.law.n_states(); ++i) {
      out.row(2 * n + contact.first_state + static_cast<int>(i)) += rates[i] * row;
    }
    if (force == 0.0) continue;
    loads_.noalias() += (force * by_force(c)) * row;
    if (contact.string < 0 || out.rows() < static_cast<Eigen::Index>(base_->size())) continue;
    const auto phi = dynamics.phi(contact.string);
    const auto& string = mechanism_->strings[static_cast<std::size_t>(contact.string)];
    const int first = 2 * n + base_->law_states() + base_->modes() + string.offset;
    for (std::size_t k = 0; k < phi.size(); ++k) {
      out.row(first + static_cast<int>(k)) += (force * phi[k]) * row;
    }
  }
}

const Eigen::VectorXd& ShiftedModels::by_force(std::size_t contact) {
  const auto gradients = base_->dynamics().gradients();
  const auto own = std::find_if(gradients.begin(), gradients.end(), [&](const auto& g) {
    return g.contact == static_cast<int>(contact);
  });
  return own->by_force;
}

void ShiftedModels::base_rates(std::span<const double> y) {
  // What rhs() would give: the base was evaluated here to be linearized.
  const Dynamics& dynamics = base_->dynamics();
  const auto n = static_cast<std::size_t>(base_->coordinates());
  two_.setZero(static_cast<Eigen::Index>(y.size()));
  for (std::size_t k = 0; k < n; ++k) {
    two_[static_cast<Eigen::Index>(k)] = y[n + k];
    two_[static_cast<Eigen::Index>(n + k)] = dynamics.acceleration()[static_cast<Eigen::Index>(k)];
  }
  const auto& contacts = mechanism_->contacts;
  for (std::size_t i = 0; i < contacts.size(); ++i) {
    for (std::size_t j = 0; j < contacts[i].law.n_states(); ++j) {
      const std::size_t row = 2 * n + static_cast<std::size_t>(contacts[i].first_state) + j;
      two_[static_cast<Eigen::Index>(row)] = dynamics.law_states(i).rate[j];
    }
  }
  for (std::size_t s = 0; s < mechanism_->strings.size(); ++s) {
    const AttachedString& own = mechanism_->strings[s];
    const double force = dynamics.string_force(static_cast<int>(s));
    const auto phi = dynamics.phi(static_cast<int>(s));
    const std::size_t eta = first_mode() + static_cast<std::size_t>(own.offset);
    for (std::size_t i = 0; i < phi.size(); ++i) {
      const double speed = y[eta + modes() + i];
      two_[static_cast<Eigen::Index>(eta + i)] = speed;
      two_[static_cast<Eigen::Index>(eta + modes() + i)] =
          phi[i] * force - own.string.damping()[i] * speed - own.string.stiffness()[i] * y[eta + i];
    }
  }
}

void ShiftedModels::add_wrench(std::size_t link, Vec2 force, double moment) {
  const auto links = base_->dynamics().links();
  for (const int index : mechanism_->links[link].path) {
    const Motion& motion = mechanism_->motions[static_cast<std::size_t>(index)];
    const auto own = static_cast<std::size_t>(motion.link);
    const Link& moved = mechanism_->links[own];
    Vec2 t{};
    if (moved.kind != LinkKind::kRevolute) {
      Rotation frame = links[static_cast<std::size_t>(moved.parent)].rotation;
      if (moved.angle != 0.0) frame = frame * moved.base;
      t = frame * motion.translation;
    }
    const Vec2 column = t + motion.rho * perp(links[link].origin - links[own].origin);
    one_[motion.coordinate] += dot(column, force) + motion.rho * moment;
  }
}

void ShiftedModels::inertial_loads(std::size_t j) {
  // M a = Q is linear in mass, first moment and inertia: minus their inertial force and weight.
  const Dynamics& dynamics = base_->dynamics();
  one_.setZero(base_->coordinates());
  for (const InertialShift& shift : inertial_[j]) {
    const LinkState& s = dynamics.links()[shift.link];
    const Vec2 r = s.rotation * shift.first;
    const Vec2 a = s.acceleration - mechanism_->gravity;
    const Vec2 force = shift.mass * a + s.alpha * perp(r) - (s.omega * s.omega) * r;
    add_wrench(shift.link, -1.0 * force, -(cross(r, a) + shift.second * s.alpha));
  }
  for (const int k : condensed_) one_[k] = 0.0;
  loads_.col(static_cast<Eigen::Index>(j)) = one_;
}

void ShiftedModels::modal_rates(std::size_t j, std::span<const double> y, RowMatrix& out) {
  const ModalShift& shift = *modal_[j];
  const std::size_t eta = first_mode();
  for (std::size_t i = 0; i < modes(); ++i) {
    out(static_cast<Eigen::Index>(eta + modes() + i), static_cast<Eigen::Index>(j)) =
        -shift.stiffness[i] * y[eta + i] - shift.damping[i] * y[eta + modes() + i];
  }
}

/// Where a parameter changes the input alone and that is a force, its derivative is the force's.
/// False: it is something else.
bool ShiftedModels::input_loads(std::size_t j, double t) {
  for (const Node& node : parameters_[j]) {
    if (&node.system->mechanism() != mechanism_.get()) return false;
  }
  double force = 0.0;
  for (const Node& node : parameters_[j]) {
    const Drive drive = node.system->drive(t);
    if (is_motion(drive.kind)) return false;
    force += node.weight * drive.force;
  }
  if (force == 0.0) return true;
  const Dynamics& dynamics = base_->dynamics();
  one_.setZero(base_->coordinates());
  const int driven = base_->drive(t).coordinate;
  if (driven >= 0) {
    one_[driven] = force;
  } else {
    const LinkPoint point = mechanism_->finger_point;
    const auto link = static_cast<std::size_t>(point.link);
    const Vec2 f = force * mechanism_->finger_direction;
    const Vec2 arm = dynamics.position(point) - dynamics.links()[link].origin;
    add_wrench(link, f, cross(arm, f));
  }
  for (const int k : condensed_) one_[k] = 0.0;
  loads_.col(static_cast<Eigen::Index>(j)) = one_;
  return true;
}

void ShiftedModels::law_rates(std::size_t j, RowMatrix& out) {
  const Dynamics& dynamics = base_->dynamics();
  const auto c = static_cast<std::size_t>(law_[j]);
  const Contact& contact = mechanism_->contacts[c];
  const ContactState& s = dynamics.contacts()[c];
  const auto column = static_cast<Eigen::Index>(j);
  if (!s.closed && contact.law.n_states() == 0) return;
  double force = 0.0;
  std::array<double, kMaxLawStates> rates{};
  const Node& node = nearest(parameters_[j]);
  const ContactLaw& law = node.system->mechanism().contacts[c].law;
  LawStates states;
  const LawMemory own = dynamics.memory(c);
  const LawValue v = s.closed ? law.evaluate(s.compression, s.rate, own, &states)
                              : law.evaluate(std::min(0.0, s.compression), 0.0, own, &states);
  if (s.closed) force = (v.force - s.law.force) / node.shift;
  for (std::size_t i = 0; i < contact.law.n_states(); ++i) {
    rates[i] = (states.rate[i] - dynamics.law_states(c).rate[i]) / node.shift;
  }
  ++evaluations_;
  const int n = base_->coordinates();
  for (std::size_t i = 0; i < contact.law.n_states(); ++i) {
    out(2 * n + contact.first_state + static_cast<int>(i), column) += rates[i];
  }
  if (!s.closed || force == 0.0) return;
  loads_.col(column) += force * by_force(c);
  if (contact.string < 0 || out.rows() < static_cast<Eigen::Index>(base_->size())) return;
  const auto phi = dynamics.phi(contact.string);
  const auto& string = mechanism_->strings[static_cast<std::size_t>(contact.string)];
  const int first = 2 * n + base_->law_states() + base_->modes() + string.offset;
  for (std::size_t k = 0; k < phi.size(); ++k) {
    out(first + static_cast<int>(k), column) += force * phi[k];
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
