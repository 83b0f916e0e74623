#include "feltmb/model/mechanism_system.hpp"

#include <algorithm>
#include <cmath>

#include "feltmb/core/error.hpp"
#include "feltmb/core/index.hpp"
#include "feltmb/modal/kernels.hpp"

namespace feltmb {
namespace {

/// Between matrices of one size.
void copy(const Eigen::MatrixXd& from, Eigen::MatrixXd& to) {
  std::copy_n(from.data(), from.size(), to.data());
}

}  // namespace

Drive InputSignal::at(double t) const {
  Drive drive;
  drive.kind = kind;
  if (is_motion(kind)) {
    drive.displacement = profile.value(origin + t);
    drive.speed = profile.rate(origin + t);
    if (is_prescribed(kind)) drive.acceleration = profile.acceleration(origin + t);
  } else {
    drive.force = profile.value(origin + t);
  }
  return drive;
}

MechanismSystem::MechanismSystem(std::shared_ptr<const Mechanism> mechanism, InputSignal input,
                                 bool ledger, std::vector<Monitor> monitors, bool events)
    : dynamics_(std::move(mechanism)), input_(std::move(input)), monitors_(std::move(monitors)) {
  const Mechanism& m = dynamics_.mechanism();
  n_ = m.size();
  modes_ = m.total_modes;
  law_states_ = m.total_law_states;
  dynamics_.condense_axial();
  if (input_.kind == InputKind::kMotion && m.finger_contact < 0) {
    throw InvalidParameter("finger motion was given but mechanism \"" + m.name +
                           "\" describes no finger");
  }
  check_input(m);
  for (const auto& s : m.strings) {
    modal_stiffness_.insert(modal_stiffness_.end(), s.string.stiffness().begin(),
                            s.string.stiffness().end());
    modal_damping_.insert(modal_damping_.end(), s.string.damping().begin(),
                          s.string.damping().end());
  }
  modal_rate_factor_.resize(as_index(modes_));
  phi_.resize(as_index(m.total_shapes));
  dphi_.resize(as_index(m.total_shapes));
  if (ledger) {
    ledger_names_ = {"work_in", "work_throughput"};
    for (const auto& c : m.contacts) {
      ledger_names_.push_back("dissipated." + c.name + ".normal");
      ledger_names_.push_back("dissipated." + c.name + ".friction");
    }
    for (const auto& k : m.coordinates) ledger_names_.push_back("dissipated.joint." + k);
    for (const auto& s : m.strings) ledger_names_.push_back("dissipated." + s.name);
    for (const auto& b : m.beams) ledger_names_.push_back("dissipated." + b.name);
  }
  if (events) {
    for (std::size_t i = 0; i < m.contacts.size(); ++i) {
      const bool active =
          m.contacts[i].finger ? input_.kind == InputKind::kMotion : m.contacts[i].enabled;
      if (active) event_contacts_.push_back(static_cast<int>(i));
    }
  } else {
    monitors_.clear();
  }
  couplings_.resize(m.string_contacts.size());
  for (auto& c : couplings_) {
    c.to.resize(couplings_.size());
    for (auto* vector : {&c.force_column, &c.displacement_column, &c.gradient, &c.rate_gradient,
                         &c.strike, &c.slope_force, &c.compression_column, &c.rate_column,
                         &c.slope_column, &c.by_force, &c.by_strike}) {
      vector->setZero(n_);
    }
  }
  for (const Contact& contact : m.contacts) {
    if (contact.law.n_states() > 0) stateful_.emplace_back();
  }
  single_.by_force.assign(stateful_.size() * DenseLu::padded(as_index(n_)), 0.0);
  single_.by_q.assign(as_index(n_) * DenseLu::padded(stateful_.size()), 0.0);
  single_.by_v = single_.by_q;
  single_.change.assign(DenseLu::padded(stateful_.size()), 0.0);
  single_.residual = single_.change;
  rhs_state_.resize(size());
  finger_load_.setZero(n_);
  rhs_largest_.resize(m.contacts.size());
  residual_.assign(2 * as_index(n_) * DenseLu::padded(as_index(n_)), 0.0);
  right_.setZero(static_cast<Eigen::Index>(DenseLu::padded(as_index(n_) + couplings_.size() + 1)));
  kept_slope_.assign(m.contacts.size(), 0.0);
  for (auto* matrix : {&mass_, &stiffness_, &damping_, &base_stiffness_, &base_damping_}) {
    matrix->setZero(n_, n_);
  }
}

void MechanismSystem::check_input(const Mechanism& m) const {
  if (is_of_motor(input_.kind) && m.motor_coordinate < 0) {
    throw InvalidParameter("a motor input was given but mechanism \"" + m.name +
                           "\" describes no motor");
  }
  if (!is_prescribed(input_.kind)) return;
  if (!is_of_motor(input_.kind) && m.finger_contact < 0) {
    throw InvalidParameter("a key motion was given but mechanism \"" + m.name +
                           "\" describes no finger");
  }
  if (!input_.profile.smooth()) {
    throw InvalidParameter(
        "a prescribed motion with linear interpolation would need infinite forces at its knots: "
        "use spline or monotone");
  }
}

std::pair<double, double> MechanismSystem::driven_place(double t, std::span<const double> y) {
  locate(t, y);
  const Mechanism& m = mechanism();
  if (is_of_motor(input_.kind)) {
    return {y[as_index(m.motor_coordinate)], y[as_index(n_ + m.motor_coordinate)]};
  }
  if (m.finger_contact < 0) return {0.0, 0.0};
  return {dot(m.finger_direction, dynamics_.position(m.finger_point)),
          dot(m.finger_direction, dynamics_.velocity(m.finger_point))};
}

void MechanismSystem::set_input(const InputSignal& input) {
  input_ = input;
  check_input(mechanism());
  fresh_ = false;
  rhs_time_ = std::numeric_limits<double>::quiet_NaN();
}

void MechanismSystem::set_prescribed_reference(double t, std::span<const double> y) {
  if (!is_prescribed(input_.kind)) return;
  const auto [place, speed] = driven_place(t, y);
  const bool motor = is_of_motor(input_.kind);
  double slow = 1e-3;  // m/s at the key
  if (motor)
    slow *= mechanism().coordinate_scale[as_index(mechanism().motor_coordinate)] / kFeltTravel;
  const double on_profile = input_.origin + t;
  prescribed_reference_ = place - input_.profile.value(on_profile);
  if (std::fabs(input_.profile.rate(on_profile) - speed) > slow) {
    throw InvalidParameter(
        format("prescribed motion: starts with %.4g %s, the mechanism with %.4g; let both agree, "
               "such as by a record that begins at rest",
               input_.profile.rate(on_profile), motor ? "rad/s" : "m/s", speed));
  }
}

MechanicalState MechanismSystem::parts(std::span<const double> y) const {
  const std::size_t n = as_index(n_);
  const std::size_t laws = as_index(law_states_);
  const std::size_t modes = as_index(modes_);
  if (apart_) {
    return {y.subspan(0, n), y.subspan(n, n), y.subspan(2 * n, laws), free_->eta(), free_->rate()};
  }
  return {y.subspan(0, n), y.subspan(n, n), y.subspan(2 * n, laws), y.subspan(2 * n + laws, modes),
          y.subspan(2 * n + laws + modes, modes)};
}

Drive MechanismSystem::drive(double t) const {
  Drive drive = input_.at(t);
  if (drive.kind == InputKind::kMotion) drive.displacement += finger_reference_;
  if (is_prescribed(drive.kind)) drive.displacement += prescribed_reference_;
  if (is_of_motor(drive.kind)) drive.coordinate = mechanism().motor_coordinate;
  return drive;
}

std::string MechanismSystem::state_name(std::size_t i) const {
  const Mechanism& m = mechanism();
  const std::size_t n = as_index(n_);
  if (i < n) return m.coordinates[i];
  if (i < 2 * n) return m.coordinates[i - n] + ".rate";
  if (i < 2 * n + as_index(law_states_)) {
    const int index = static_cast<int>(i - 2 * n);
    for (const auto& c : m.contacts) {
      const int own = index - c.first_state;
      if (own >= 0 && as_index(own) < c.law.n_states())
        return c.name + "." + c.law.state_name(as_index(own));
    }
  }
  std::size_t j = i - 2 * n - as_index(law_states_);
  const bool rate = j >= as_index(modes_);
  if (rate) j -= as_index(modes_);
  for (const auto& s : m.strings) {
    if (j < as_index(s.offset + s.string.modes())) {
      return s.name + ".mode" + std::to_string(j - as_index(s.offset) + 1) + (rate ? ".rate" : "");
    }
  }
  return "state" + std::to_string(i);
}

void MechanismSystem::evaluate(double t, std::span<const double> y, Detail detail) {
  rhs_time_ = std::numeric_limits<double>::quiet_NaN();
  if (apart_) free_->move(t);
  dynamics_.evaluate(parts(y), drive(t), detail);
}

void MechanismSystem::evaluate_apart(double t, std::span<const double> y) {
  dynamics_.set_strings_apart(apart_);
  rhs_time_ = std::numeric_limits<double>::quiet_NaN();
  dynamics_.evaluate(parts(y), drive(t));
  dynamics_.set_strings_apart(false);
}

void MechanismSystem::locate(double t, std::span<const double> y, Detail detail) {
  rhs_time_ = std::numeric_limits<double>::quiet_NaN();
  if (apart_) {
    // The strings are not moved for a look at contacts that cannot touch them.
    if (detail == Detail::kClosedContacts) {
      dynamics_.set_strings_apart(true);
      dynamics_.locate(parts(y), drive(t), detail);
      dynamics_.set_strings_apart(false);
      if (!within_reach()) return;
    }
    free_->move(t);
  }
  dynamics_.locate(parts(y), drive(t), detail);
}

void MechanismSystem::place(std::span<const double> y) {
  fresh_ = false;
  rhs_time_ = std::numeric_limits<double>::quiet_NaN();
  dynamics_.place(parts(y));
}

void MechanismSystem::locate_only(double t, std::span<const double> y,
                                  std::span<const std::size_t> contacts) {
  fresh_ = false;
  if (!(t == rhs_time_)) rhs_time_ = std::numeric_limits<double>::quiet_NaN();
  dynamics_.set_strings_apart(apart_);
  dynamics_.locate_only(parts(y), drive(t), contacts);
  dynamics_.set_strings_apart(false);
}

void MechanismSystem::rhs(double t, std::span<const double> y, std::span<double> rate) {
  evaluate_apart(t, y);
  rhs_time_ = t;
  std::copy(y.begin(), y.end(), rhs_state_.begin());
  const auto& largest = dynamics_.largest_compression();
  std::copy(largest.begin(), largest.end(), rhs_largest_.begin());
  fresh_ = true;
  read_rates(y, rate);
}

void MechanismSystem::read_rates(std::span<const double> y, std::span<double> rate) const {
  const MechanicalState p = parts(y);
  const std::size_t n = as_index(n_);
  const std::size_t modes = as_index(active_modes());
  const auto& a = dynamics_.acceleration();
  for (std::size_t k = 0; k < n; ++k) {
    rate[k] = p.v[k];
    rate[n + k] = a[static_cast<Eigen::Index>(k)];
  }
  const auto law_rates = dynamics_.law_rates();
  std::copy(law_rates.begin(), law_rates.end(), rate.begin() + 2 * n_);
  if (modes == 0) return;
  double* eta_rate = rate.data() + 2 * n + as_index(law_states_);
  double* eta_acceleration = eta_rate + modes;
  std::copy(p.eta_rate.begin(), p.eta_rate.end(), eta_rate);
  const auto& strings = mechanism().strings;
  for (std::size_t s = 0; s < strings.size(); ++s) {
    const std::size_t first = as_index(strings[s].offset);
    const int contact = strings[s].first_contact;
    const auto phi = dynamics_.phi(contact);
    modal::accelerate(phi.size(), modal_stiffness_.data() + first, modal_damping_.data() + first,
                      p.eta.data() + first, p.eta_rate.data() + first, phi.data(),
                      dynamics_.string_force(contact), eta_acceleration + first);
    for (int other = contact + 1; other < contact + strings[s].contacts; ++other) {
      const double force = dynamics_.string_force(other);
      if (force == 0.0) continue;
      modal::add_load(phi.size(), dynamics_.phi(other).data(), force, eta_acceleration + first);
    }
  }
}

void MechanismSystem::add_contact_slopes(Eigen::MatrixXd& stiffness, Eigen::MatrixXd& damping,
                                         const ContactGradient& gradient, double slope,
                                         double rate_slope) {
  // K += (b s + c) g^T + b r h^T and D += b r g^T: force column b, compression column c, gradient g
  // and rate gradient h, zero but for the coordinates of the contact, slopes s and r.
  slope_column_ = slope * gradient.by_force + gradient.by_compression;
  rate_column_ = rate_slope * gradient.by_force;
  for (const int k : mechanism().contacts[as_index(gradient.contact)].coordinates) {
    stiffness.col(k) += slope_column_ * gradient.compression[k] + rate_column_ * gradient.rate[k];
    damping.col(k) += rate_column_ * gradient.compression[k];
  }
}

void MechanismSystem::add_stateful(const ContactGradient* gradient, int contact, int coupling) {
  StatefulContact& c = stateful_[as_index(stateful_count_++)];
  c.contact = contact;
  c.coupling = coupling;
  c.closed = gradient != nullptr;
  c.gradient = gradient;
  c.first_state = mechanism().contacts[as_index(contact)].first_state;
  c.law = dynamics_.contacts()[as_index(contact)].law;
  c.states = dynamics_.law_states(as_index(contact));
}

/// Newton's method linearises where it has just evaluated.
bool MechanismSystem::evaluated_at(double t, std::span<const double> y) const {
  const auto& largest = dynamics_.largest_compression();
  return fresh_ && t == rhs_time_ && std::equal(y.begin(), y.end(), rhs_state_.begin()) &&
         std::equal(largest.begin(), largest.end(), rhs_largest_.begin());
}

void MechanismSystem::linearize(double t, std::span<const double> y) {
  if (!evaluated_at(t, y)) evaluate_apart(t, y);
  fresh_ = false;
  dynamics_.differentiate();
  keep_slopes();
}

void MechanismSystem::linearize_stiff(double t, std::span<const double> y) {
  if (!evaluated_at(t, y)) evaluate_apart(t, y);
  dynamics_.differentiate_stiff();
  keep_slopes();
}

/// Keeps what dynamics_ has differentiated.
void MechanismSystem::keep_slopes() {
  const Mechanism& m = mechanism();
  constraint_ = dynamics_.prescription().active ? 1 : 0;
  copy(dynamics_.mass_matrix(), mass_);
  copy(dynamics_.stiffness(), base_stiffness_);
  copy(dynamics_.damping(), base_damping_);
  coupling_count_ = 0;
  stateful_count_ = 0;
  std::size_t kept = 0;
  for (const ContactGradient& g : dynamics_.gradients()) {
    const Contact& contact = m.contacts[as_index(g.contact)];
    const ContactState& state = dynamics_.contacts()[as_index(g.contact)];
    kept_slope_[kept++] = state.law.d_compression;
    const bool stateful = contact.law.n_states() > 0;
    if (stateful) {
      add_stateful(&g, g.contact, contact.string_contact >= 0 ? coupling_count_ : -1);
    } else {
      add_contact_slopes(base_stiffness_, base_damping_, g, state.law.d_compression,
                         state.law.d_rate);
    }
    if (contact.string_contact < 0) continue;
    const StringContact& touch = m.string_contacts[as_index(contact.string_contact)];
    StringCoupling& c = couplings_[as_index(coupling_count_++)];
    c.string = touch.string;
    c.offset = m.string_of(touch).offset;
    c.count = m.string_of(touch).string.modes();
    c.shape = touch.shape;
    c.force = state.law.force;
    c.by_compression = state.law.d_compression;
    c.by_rate = state.law.d_rate;
    c.strike_speed = state.strike_speed;
    c.force_column = g.by_force;
    c.compression_column = g.by_compression;
    c.gradient = g.compression;
    c.rate_gradient = g.rate;
    c.strike = g.strike;
    c.slope_force = g.by_slope;
    const auto phi = dynamics_.phi(contact.string_contact);
    const auto dphi = dynamics_.dphi(contact.string_contact);
    std::copy(phi.begin(), phi.end(), phi_.begin() + c.shape);
    std::copy(dphi.begin(), dphi.end(), dphi_.begin() + c.shape);
  }
  if (law_states_ == 0) return;
  for (std::size_t i = 0; i < m.contacts.size(); ++i) {
    if (!m.contacts[i].law.still_when_open() && !dynamics_.contacts()[i].closed) {
      add_stateful(nullptr, static_cast<int>(i), -1);
    }
  }
  gather_single();
}

void MechanismSystem::gather_single() {
  single_.contacts.clear();
  for (int i = 0; i < stateful_count_; ++i) {
    StatefulContact& c = stateful_[as_index(i)];
    const bool single =
        c.closed && c.coupling < 0 && mechanism().contacts[as_index(c.contact)].law.n_states() == 1;
    c.single = single ? static_cast<int>(single_.contacts.size()) : -1;
    if (single) single_.contacts.push_back(i);
  }
  // A contact fills the rows of its own coordinates only; the others stay zero.
  const std::size_t count = single_.contacts.size();
  const auto clear = [](std::vector<double>& values, std::size_t used) {
    std::fill_n(values.begin(), used, 0.0);
  };
  clear(single_.by_force, count * DenseLu::padded(as_index(n_)));
  clear(single_.by_q, as_index(n_) * DenseLu::padded(count));
  clear(single_.by_v, as_index(n_) * DenseLu::padded(count));
}

void MechanismSystem::reduce_one_state(StatefulContact& c, double gamma,
                                       const std::vector<int>& coordinates) {
  const double inverse = 1.0 / (1.0 - gamma * c.states.rate_by_state[0][0]);
  const double by_compression = inverse * gamma * c.states.rate_by_compression[0];
  const double by_rate = inverse * gamma * c.states.rate_by_rate[0];
  c.inverse(0, 0) = inverse;
  c.by_compression[0] = by_compression;
  c.by_rate[0] = by_rate;
  c.slope = c.law.d_compression + c.states.force[0] * by_compression;
  c.rate_slope = c.law.d_rate + c.states.force[0] * by_rate;
  if (c.single < 0) return;
  const std::size_t rows = DenseLu::padded(single_.contacts.size());
  double* by_force = single_.by_force.data() + as_index(c.single) * DenseLu::padded(as_index(n_));
  const double force = gamma * c.states.force[0];
  const double* force_column = c.gradient->by_force.data();
  const double* by_place = c.gradient->compression.data();
  const double* by_speed = c.gradient->rate.data();
  double* by_q = single_.by_q.data() + as_index(c.single);
  double* by_v = single_.by_v.data() + as_index(c.single);
  for (const int k : coordinates) {
    const std::size_t place = as_index(k) * rows;
    by_force[k] = force * force_column[k];
    by_q[place] = by_compression * by_place[k] + by_rate * by_speed[k];
    by_v[place] = by_rate * by_place[k];
  }
}

void MechanismSystem::reduce_states(StatefulContact& c, double gamma, Eigen::Index count) {
  Eigen::Matrix3d matrix = Eigen::Matrix3d::Identity();
  Eigen::Vector3d by_compression = Eigen::Vector3d::Zero();
  Eigen::Vector3d by_rate = Eigen::Vector3d::Zero();
  Eigen::Vector3d force = Eigen::Vector3d::Zero();
  for (Eigen::Index a = 0; a < count; ++a) {
    const auto row = static_cast<std::size_t>(a);
    by_compression[a] = gamma * c.states.rate_by_compression[row];
    by_rate[a] = gamma * c.states.rate_by_rate[row];
    force[a] = c.states.force[row];
    for (Eigen::Index b = 0; b < count; ++b) {
      matrix(a, b) -= gamma * c.states.rate_by_state[row][static_cast<std::size_t>(b)];
    }
  }
  c.inverse = matrix.inverse();
  c.by_compression = c.inverse * by_compression;
  c.by_rate = c.inverse * by_rate;
  c.slope = c.law.d_compression + force.dot(c.by_compression);
  c.rate_slope = c.law.d_rate + force.dot(c.by_rate);
}

void MechanismSystem::reduce_law_states(double gamma) {
  for (int i = 0; i < stateful_count_; ++i) {
    StatefulContact& c = stateful_[as_index(i)];
    const Contact& contact = mechanism().contacts[as_index(c.contact)];
    const auto count = static_cast<Eigen::Index>(contact.law.n_states());
    if (count == 1) {
      reduce_one_state(c, gamma, contact.coordinates);
    } else {
      reduce_states(c, gamma, count);
    }
    if (!c.closed) continue;
    add_contact_slopes(stiffness_, damping_, *c.gradient, c.slope, c.rate_slope);
    if (c.coupling >= 0) {
      couplings_[as_index(c.coupling)].by_compression = c.slope;
      couplings_[as_index(c.coupling)].by_rate = c.rate_slope;
    }
  }
}

/// How contacts with one string feel each other through its modes, by the factors of the modes.
void MechanismSystem::add_string_answers() {
  for (int i = 0; i < coupling_count_; ++i) {
    StringCoupling& c = couplings_[as_index(i)];
    const auto count = as_index(c.count);
    const double* phi = phi_.data() + c.shape;
    const double* dphi = dphi_.data() + c.shape;
    const double* factor = modal_rate_factor_.data() + c.offset;
    c.to[as_index(i)] = modal::gram_sums(count, phi, dphi, factor);
    for (int j = 0; j < i; ++j) {
      StringCoupling& other = couplings_[as_index(j)];
      if (other.string != c.string) continue;
      const modal::GramSums a = modal::cross_sums(count, phi, dphi, phi_.data() + other.shape,
                                                  dphi_.data() + other.shape, factor);
      c.to[as_index(j)] = a;
      other.to[as_index(i)] = {a.phi_phi, a.dphi_phi, a.phi_dphi, a.dphi_dphi};
    }
  }
}

template <class Visit>
void MechanismSystem::visit_slopes(Visit&& visit) {
  const auto whole = [&](auto& matrix) {
    visit(matrix.data(), static_cast<std::size_t>(matrix.size()));
  };
  for (auto* matrix : {&mass_, &base_stiffness_, &base_damping_}) whole(*matrix);
  for (int i = 0; i < coupling_count_; ++i) {
    StringCoupling& c = couplings_[as_index(i)];
    for (double* number : {&c.force, &c.by_compression, &c.by_rate, &c.strike_speed}) {
      visit(number, 1);
    }
    for (auto* vector : {&c.force_column, &c.compression_column, &c.gradient, &c.rate_gradient,
                         &c.strike, &c.slope_force}) {
      whole(*vector);
    }
    visit(phi_.data() + c.shape, as_index(c.count));
    visit(dphi_.data() + c.shape, as_index(c.count));
  }
}

void MechanismSystem::slopes(std::vector<double>& out) {
  out.clear();
  visit_slopes([&](const double* from, std::size_t n) { out.insert(out.end(), from, from + n); });
}

void MechanismSystem::set_slopes(std::span<const double> slopes) {
  visit_slopes([&](double* to, std::size_t n) {
    std::copy_n(slopes.begin(), n, to);
    slopes = slopes.subspan(n);
  });
}

bool MechanismSystem::factorize(double gamma) {
  gamma_ = gamma;
  modal::newton_factors(as_index(active_modes()), gamma, modal_stiffness_.data(),
                        modal_damping_.data(), modal_rate_factor_.data());
  if (stateful_count_ > 0) {
    copy(base_stiffness_, stiffness_);
    copy(base_damping_, damping_);
    reduce_law_states(gamma);
  }
  const int total = n_ + coupling_count_ + constraint_;
  lu_.resize(as_index(total));
  Eigen::Map<Eigen::MatrixXd, 0, Eigen::OuterStride<>> newton(
      lu_.column(0), total, total, Eigen::OuterStride<>(static_cast<Eigen::Index>(lu_.stride())));
  const auto padded = static_cast<Eigen::Index>(DenseLu::padded(as_index(n_)));
  Eigen::Map<Eigen::MatrixXd> residual(residual_.data(), padded, 2 * n_);
  residual.topLeftCorner(n_, n_) = mass_;
  residual.topRightCorner(n_, n_) = gamma * (stateful_count_ > 0 ? stiffness_ : base_stiffness_);
  newton.topLeftCorner(n_, n_) = mass_ - gamma * ((stateful_count_ > 0 ? damping_ : base_damping_) +
                                                  residual.topRightCorner(n_, n_));
  for (int i = 0; i < coupling_count_; ++i) {
    StringCoupling& c = couplings_[as_index(i)];
    c.displacement_column = -(c.force_column * c.by_compression + c.compression_column);
    c.rate_column = -c.by_rate * c.force_column;
    c.slope_column = c.force * c.slope_force + c.strike_speed * c.rate_column;
    newton.col(n_ + i).setZero();
    newton.row(n_ + i).setZero();
    newton.row(n_ + i).head(n_) = (-(gamma * c.by_compression + c.by_rate) * c.gradient -
                                   (gamma * c.by_rate) * c.rate_gradient)
                                      .transpose();
    newton(n_ + i, n_ + i) = 1.0;
  }
  add_string_answers();
  for (int i = 0; i < coupling_count_; ++i) {
    StringCoupling& c = couplings_[as_index(i)];
    for (int j = 0; j < coupling_count_; ++j) {
      const StringCoupling& other = couplings_[as_index(j)];
      if (other.string != c.string) continue;
      // String at the point of contact against the unknown force and the shift of the point of each
      // contact with it: d velocity = g (a00 dF + a01 F dy), d displacement = g d velocity, d slope
      // = g^2 (a10 dF + a11 F dy), with dy = strike . dq and dq = r_q + g dv.
      const double g = gamma;
      const modal::GramSums& a = c.to[as_index(j)];
      const double velocity_f = g * a.phi_phi;
      const double slope_f = g * g * a.dphi_phi;
      const double velocity_y = g * a.phi_dphi * other.force;
      const double slope_y = g * g * a.dphi_dphi * other.force;
      c.by_force = (g * velocity_f) * c.displacement_column + velocity_f * c.rate_column +
                   slope_f * c.slope_column;
      c.by_strike = (g * velocity_y) * c.displacement_column + velocity_y * c.rate_column +
                    slope_y * c.slope_column;
      newton.topLeftCorner(n_, n_) -= (g * g) * c.by_strike * other.strike.transpose();
      newton.col(n_ + j).head(n_) -= g * c.by_force;
      const double own_f =
          c.by_compression * g * velocity_f + c.by_rate * (velocity_f + c.strike_speed * slope_f);
      const double own_y =
          c.by_compression * g * velocity_y + c.by_rate * (velocity_y + c.strike_speed * slope_y);
      newton.row(n_ + i).head(n_) += ((g * own_y) * other.strike).transpose();
      newton(n_ + i, n_ + j) += own_f;
    }
  }
  if (constraint_ > 0) {
    // Unknown reaction dR: M dv - gamma (... + J^T dR) = M r_v, and the motion's own equation
    // J da + by_speed dv + by_position dq = 0 with gamma da = dv - r_v.
    const Prescription& p = dynamics_.prescription();
    newton.row(total - 1).setZero();
    newton.col(total - 1).setZero();
    newton.col(total - 1).head(n_) = -gamma * p.row;
    newton.row(total - 1).head(n_) =
        (p.row + gamma * p.by_speed + (gamma * gamma) * p.by_position).transpose();
  }
  return lu_.factorize();
}

void MechanismSystem::solve(std::span<double> b) {
  const std::size_t n = as_index(n_);
  const std::size_t modes = as_index(active_modes());
  const double g = gamma_;
  const Eigen::Map<Eigen::VectorXd> r_q(b.data(), n_);
  const Eigen::Map<Eigen::VectorXd> r_v(b.data() + n, n_);
  double* r_law = b.data() + 2 * n;
  double* r_eta = r_law + as_index(law_states_);
  double* r_rate = r_eta + modes;

  // Modes without the contact force: their part of the right-hand side.
  modal::reduce_residual(modes, g, modal_stiffness_.data(), modal_rate_factor_.data(), r_eta,
                         r_rate);
  const std::size_t stride = DenseLu::padded(n);
  add_products(n, stride, residual_.data(), r_v.data(), residual_.data() + n * stride, r_q.data(),
               right_.data());
  if (constraint_ > 0) {
    const Prescription& p = dynamics_.prescription();
    right_[n_ + coupling_count_] = p.row.dot(r_v) - g * p.by_position.dot(r_q);
  }
  for (int i = 0; i < coupling_count_; ++i) {
    const StringCoupling& c = couplings_[as_index(i)];
    const std::size_t first = as_index(c.offset);
    auto [velocity, displacement, slope] =
        modal::residual_sums(as_index(c.count), g, phi_.data() + c.shape, dphi_.data() + c.shape,
                             r_eta + first, r_rate + first);
    for (int j = 0; j < coupling_count_; ++j) {
      const StringCoupling& other = couplings_[as_index(j)];
      if (other.string != c.string) continue;
      const modal::GramSums& a = c.to[as_index(j)];
      const double shift = other.strike.dot(r_q) * other.force;
      velocity += g * a.phi_dphi * shift;
      displacement += g * g * a.phi_dphi * shift;
      slope += g * g * a.dphi_dphi * shift;
    }
    right_.head(n_) += g * (displacement * c.displacement_column -
                            (c.by_rate * (velocity + c.strike_speed * slope)) * c.force_column +
                            (slope * c.force) * c.slope_force);
    right_[n_ + i] = c.by_compression * (c.gradient.dot(r_q) - displacement) +
                     c.by_rate * (c.rate_gradient.dot(r_q) - velocity - c.strike_speed * slope);
  }
  // Law states alone: their residual acts through the force. Beyond n the columns hold zeros.
  for (std::size_t i = 0; i < single_.contacts.size(); ++i) {
    const StatefulContact& c = stateful_[as_index(single_.contacts[i])];
    single_.residual[i] = r_law[c.first_state] * c.inverse(0, 0);
  }
  add_columns(single_.contacts.size(), stride, single_.by_force.data(), single_.residual.data(),
              right_.data());
  for (int i = 0; i < stateful_count_; ++i) {
    const StatefulContact& c = stateful_[as_index(i)];
    if (c.single >= 0) continue;
    double* own = r_law + c.first_state;
    const Contact& contact = mechanism().contacts[as_index(c.contact)];
    const std::size_t count = contact.law.n_states();
    double force = 0.0;
    if (count == 1) {
      own[0] *= c.inverse(0, 0);
      force = c.states.force[0] * own[0];
    } else {
      Eigen::Vector3d r = Eigen::Vector3d::Zero();
      for (std::size_t j = 0; j < count; ++j) r[static_cast<Eigen::Index>(j)] = own[j];
      r = c.inverse * r;
      for (std::size_t j = 0; j < count; ++j) {
        own[j] = r[static_cast<Eigen::Index>(j)];
        force += c.states.force[j] * own[j];
      }
    }
    if (!c.closed) continue;
    for (const int k : contact.coordinates) right_[k] += g * force * c.gradient->by_force[k];
    if (c.coupling >= 0) right_[n_ + c.coupling] += force;
  }
  lu_.solve(right_.data());
  for (std::size_t k = 0; k < n; ++k) {
    const double dv = right_[static_cast<Eigen::Index>(k)];
    b[k] += g * dv;
    b[n + k] = dv;
  }
  for (int i = 0; i < coupling_count_; ++i) {
    const StringCoupling& c = couplings_[as_index(i)];
    const std::size_t first = as_index(c.offset);
    const double dforce = right_[n_ + i];
    const double shift = c.strike.dot(r_q) * c.force;  // r_q now holds dq
    modal::add_force(as_index(c.count), g, dforce, shift, phi_.data() + c.shape,
                     dphi_.data() + c.shape, modal_rate_factor_.data() + first, r_rate + first);
  }
  modal::advance(modes, g, r_rate, r_eta);

  if (!single_.contacts.empty()) {
    add_products(n, DenseLu::padded(single_.contacts.size()), single_.by_q.data(), r_q.data(),
                 single_.by_v.data(), r_v.data(), single_.change.data());
    for (std::size_t i = 0; i < single_.contacts.size(); ++i) {
      const int state = stateful_[as_index(single_.contacts[i])].first_state;
      r_law[state] = single_.residual[i] + single_.change[i];
    }
  }
  for (int i = 0; i < stateful_count_; ++i) {
    const StatefulContact& c = stateful_[as_index(i)];
    if (c.single >= 0 || !c.closed) continue;
    double* own = r_law + c.first_state;
    const Contact& contact = mechanism().contacts[as_index(c.contact)];
    double compression = c.gradient->compression.dot(r_q);
    double rate = c.gradient->rate.dot(r_q) + c.gradient->compression.dot(r_v);
    if (c.coupling >= 0) {
      const StringCoupling& string = couplings_[as_index(c.coupling)];
      const std::size_t first = as_index(string.offset);
      const auto [velocity, displacement, slope] =
          modal::residual_sums(as_index(string.count), 0.0, phi_.data() + string.shape,
                               dphi_.data() + string.shape, r_eta + first, r_rate + first);
      compression -= displacement;
      rate -= velocity + string.strike_speed * slope;
    }
    for (std::size_t j = 0; j < contact.law.n_states(); ++j) {
      const auto row = static_cast<Eigen::Index>(j);
      own[j] += c.by_compression[row] * compression + c.by_rate[row] * rate;
    }
  }
}

std::size_t MechanismSystem::n_events() const { return event_contacts_.size() + monitors_.size(); }

void MechanismSystem::events(double t, std::span<const double> y, std::span<double> g) {
  locate(t, y);
  read_events(g);
}

bool MechanismSystem::events_nearby(double t, std::span<double> g) {
  if (!(t == rhs_time_)) return false;
  if (apart_ && within_reach()) return false;
  read_events(g);
  return true;
}

bool MechanismSystem::surely_open(double t, int contact) const {
  if (!(t == rhs_time_)) return false;
  const int touch = mechanism().contacts[as_index(contact)].string_contact;
  const double reach =
      apart_ && touch >= 0
          ? free_->reach(as_index(mechanism().string_contacts[as_index(touch)].string))
          : 0.0;
  return dynamics_.contacts()[as_index(contact)].compression + reach < -margin_;
}

void MechanismSystem::allow_free_strings() {
  if (!free_) free_ = std::make_unique<FreeStrings>(mechanism());
}

void MechanismSystem::part_strings(double t, std::span<const double> y) {
  const MechanicalState p = parts(y);
  free_->start(t, p.eta, p.eta_rate);
  apart_ = true;
  fresh_ = false;
}

void MechanismSystem::fill_strings(double t, std::span<double> y) {
  free_->move(t);
  const std::size_t first = as_index(2 * n_ + law_states_);
  std::copy(free_->eta().begin(), free_->eta().end(), y.subspan(first).begin());
  std::copy(free_->rate().begin(), free_->rate().end(),
            y.subspan(first + as_index(modes_)).begin());
}

void MechanismSystem::join_strings(double t, std::span<double> y) {
  fill_strings(t, y);
  apart_ = false;
  fresh_ = false;
}

bool MechanismSystem::strings_clear(double t, double gap) const {
  if (!(t == rhs_time_)) return false;
  for (const auto& touch : mechanism().string_contacts) {
    if (!mechanism().contacts[as_index(touch.contact)].enabled) continue;
    const ContactState& c = dynamics_.contacts()[as_index(touch.contact)];
    if (c.closed || !(c.compression < -gap)) return false;
  }
  return true;
}

/// At the compressions against strings at rest that were located last.
bool MechanismSystem::within_reach() const {
  for (const auto& touch : mechanism().string_contacts) {
    if (!mechanism().contacts[as_index(touch.contact)].enabled) continue;
    const ContactState& c = dynamics_.contacts()[as_index(touch.contact)];
    if (!(c.compression + free_->reach(as_index(touch.string)) < -margin_)) return true;
  }
  return false;
}

double MechanismSystem::string_approach(double t, std::span<const double> y) {
  constexpr double never = -std::numeric_limits<double>::infinity();
  if (t == rhs_time_ && !within_reach()) return never;
  locate(t, y);
  double largest = never;
  for (const auto& touch : mechanism().string_contacts) {
    if (!mechanism().contacts[as_index(touch.contact)].enabled) continue;
    largest = std::max(largest, dynamics_.contacts()[as_index(touch.contact)].compression);
  }
  return largest;
}

void MechanismSystem::read_events(std::span<double> g) const {
  std::size_t i = 0;
  for (const int contact : event_contacts_)
    g[i++] = dynamics_.contacts()[as_index(contact)].compression;
  for (const Monitor& monitor : monitors_) {
    const auto& point = mechanism().points[as_index(monitor.point)].point;
    g[i++] = dot(monitor.direction, dynamics_.position(point)) - monitor.level;
  }
}

void MechanismSystem::powers(double t, std::span<const double> y, std::span<double> out) {
  if (!(t == rhs_time_)) {
    evaluate_apart(t, y);
    // The contacts are where a right-hand side would leave them, but at another state than the
    // last.
    rhs_time_ = t;
    fresh_ = false;
  }
  const Mechanism& m = mechanism();
  const MechanicalState p = parts(y);
  const Drive now = drive(t);
  double power = 0.0;
  if (is_prescribed(now.kind)) {
    power = dynamics_.prescription().reaction *
            dynamics_.prescription().row.dot(Eigen::Map<const Eigen::VectorXd>(p.v.data(), n_));
  } else if (now.kind == InputKind::kTorque) {
    power = now.force * p.v[as_index(now.coordinate)];
  } else if (now.kind == InputKind::kMotion) {
    power = dynamics_.contacts()[as_index(m.finger_contact)].law.force * now.speed;
  } else if (now.force != 0.0) {
    // With the accepted speeds: those of the last right-hand side may be off by all of Newton's
    // correction, which is many tolerances where one iteration was enough.
    const Vec2 force = now.force * m.finger_direction;
    finger_load_.setZero();
    dynamics_.add_wrench(m.finger_point.link, force,
                         cross(dynamics_.position(m.finger_point), force), finger_load_);
    power = finger_load_.dot(Eigen::Map<const Eigen::VectorXd>(p.v.data(), n_));
  }
  std::size_t i = 0;
  out[i++] = power;
  out[i++] = std::fabs(power);
  for (std::size_t c = 0; c < m.contacts.size(); ++c) {
    const ContactState& s = dynamics_.contacts()[c];
    if (!s.closed && m.contacts[c].law.n_states() == 0) {
      out[i++] = 0.0;
      out[i++] = 0.0;
      continue;
    }
    out[i++] = m.contacts[c].law.dissipated_power(s.closed ? s.compression : 0.0,
                                                  s.closed ? s.rate : 0.0, dynamics_.memory(c));
    out[i++] = s.friction.value * s.law.force * s.slip;
  }
  for (int k = 0; k < n_; ++k) out[i++] = dynamics_.joint_friction(k) * p.v[as_index(k)];
  for (const auto& s : m.strings) {
    // What a free string loses is counted from its energy.
    out[i++] = apart_ ? 0.0
                      : s.string.dissipated_power(
                            p.eta_rate.subspan(as_index(s.offset), as_index(s.string.modes())));
  }
  for (std::size_t b = 0; b < m.beams.size(); ++b) {
    out[i++] = dynamics_.beam_damping_power(static_cast<int>(b));
  }
}

std::vector<double> MechanismSystem::absolute_tolerances(double rtol) const {
  const Mechanism& m = mechanism();
  constexpr double felt = 2e-4;  // m
  constexpr double speed = 0.2;  // m/s
  std::vector<double> atol(size());
  const std::size_t n = as_index(n_);
  for (std::size_t k = 0; k < n; ++k) {
    const double scale = m.coordinate_scale[k] / kFeltTravel;  // coordinate a meter of travel
    atol[k] = rtol * felt * scale;
    atol[n + k] = rtol * speed * scale;
  }
  // Members bend by millimeters, and elastic speeds matter through the deflection that they make
  // at the lateral modes.
  constexpr double bending = 3.0;           // times the scale of a felt compression
  constexpr double lateral_modes = 1000.0;  // rad/s
  for (const auto& b : m.beams) {
    for (int k = b.first; k < b.first + b.count; ++k) {
      atol[as_index(k)] *= bending;
      atol[n + as_index(k)] = atol[as_index(k)] * lateral_modes;
    }
  }
  for (const auto& c : m.contacts) {
    for (std::size_t j = 0; j < c.law.n_states(); ++j) {
      atol[2 * n + as_index(c.first_state) + j] = rtol * c.law.state(j, felt).scale;
    }
  }
  const std::size_t modal = 2 * n + as_index(law_states_);
  if (apart_) return atol;
  for (const auto& s : m.strings) {
    const double shape = s.string.shape_scale();
    for (int j = s.offset; j < s.offset + s.string.modes(); ++j) {
      atol[modal + as_index(j)] = rtol * felt / shape;
      atol[modal + as_index(modes_ + j)] = rtol * speed / shape;
    }
  }
  return atol;
}

int MechanismSystem::stiffest_contact(std::size_t state) const {
  const std::size_t n = as_index(n_);
  const Mechanism& m = mechanism();
  if (state < 2 * n) {
    const auto k = static_cast<Eigen::Index>(state % n);
    int stiffest = -1;
    double most = 0.0;
    std::size_t kept = 0;
    for (const ContactGradient& g : dynamics_.gradients()) {
      const double slope = kept_slope_[kept++];
      const double tie =
          std::fabs((g.by_force[k] * slope + g.by_compression[k]) * g.compression[k]);
      if (tie <= most) continue;
      most = tie;
      stiffest = g.contact;
    }
    return stiffest;
  }
  if (state < 2 * n + as_index(law_states_)) {
    for (std::size_t i = 0; i < m.contacts.size(); ++i) {
      const int own = static_cast<int>(state - 2 * n) - m.contacts[i].first_state;
      if (own >= 0 && as_index(own) < m.contacts[i].law.n_states()) return static_cast<int>(i);
    }
  }
  const std::size_t mode =
      (state - 2 * n - as_index(law_states_)) % std::max<std::size_t>(1, as_index(modes_));
  for (const auto& s : m.strings) {
    if (!(mode < as_index(s.offset + s.string.modes()))) continue;
    const auto touching = m.contacts_of(s);
    int stiffest = touching[0].contact;
    double most = 0.0;
    std::size_t kept = 0;
    for (const ContactGradient& g : dynamics_.gradients()) {
      const double slope = kept_slope_[kept++];
      const bool own = std::any_of(touching.begin(), touching.end(),
                                   [&](const StringContact& c) { return c.contact == g.contact; });
      if (!own || slope <= most) continue;
      most = slope;
      stiffest = g.contact;
    }
    return stiffest;
  }
  return -1;
}

}  // namespace feltmb
