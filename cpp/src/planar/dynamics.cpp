#include "feltmb/planar/dynamics.hpp"

#include <algorithm>
#include <cmath>
#include <limits>

#include "feltmb/core/index.hpp"

namespace feltmb {
namespace {

/// x^T A x / 2 with the lower triangle of a symmetric A.
double half_quadratic(const Eigen::MatrixXd& a, const double* x) {
  double sum = 0.0;
  for (Eigen::Index k = 0; k < a.cols(); ++k) {
    double product = 0.5 * a(k, k) * x[k];
    for (Eigen::Index i = k + 1; i < a.rows(); ++i) product += a(i, k) * x[i];
    sum += product * x[k];
  }
  return sum;
}

}  // namespace

Dynamics::Dynamics(std::shared_ptr<const Mechanism> mechanism)
    : m_(std::move(mechanism)), n_(m_->size()) {
  const std::size_t n = as_index(n_);
  links_.resize(m_->links.size());
  applied_.resize(m_->links.size());
  load_.resize(m_->links.size());
  carried_.resize(m_->links.size());
  held_.assign(n, char{0});
  for (std::size_t i = 1; i < m_->links.size(); ++i) {
    if (!m_->links[i].lump) moving_.push_back(i);
  }
  contacts_.resize(m_->contacts.size());
  for (const Contact& contact : m_->contacts) {
    auto& chain = carriers_.emplace_back();
    for (const int side : {contact.a.link, contact.b.link}) {
      for (int i = side; i > 0; i = m_->links[as_index(i)].parent) chain.push_back(i);
    }
    std::sort(chain.begin(), chain.end());
    chain.erase(std::unique(chain.begin(), chain.end()), chain.end());
  }
  motion_of_.assign(m_->links.size() * n, -1);
  for (std::size_t i = 0; i < m_->links.size(); ++i) {
    for (const int motion : m_->links[i].path) {
      motion_of_[i * n + as_index(m_->motions[as_index(motion)].coordinate)] = motion;
    }
  }
  translation_.assign(m_->motions.size(), {});
  translation_rate_.assign(m_->motions.size(), {});
  for (const Motion& motion : m_->motions) {
    twist_.push_back({{}, motion.rho, motion.coordinate, 0});
  }
  largest_.assign(m_->contacts.size(), 0.0);
  turns_.resize(m_->contacts.size());
  law_.assign(as_index(m_->total_law_states), 0.0);
  law_rate_ = law_;
  law_states_.resize(m_->contacts.size());
  loaded_.assign(m_->contacts.size(), char{0});
  cycles_.resize(m_->contacts.size());
  for (int k = 0; k < n_; ++k) {
    if (m_->joint_friction[as_index(k)].acts()) turning_.push_back(k);
  }
  resistance_.resize(turning_.size());
  for (const Contact& contact : m_->contacts) {
    idle_.push_back(contact.law.still_when_open() || !contact.enabled ? 1 : 0);
  }
  phi_.assign(as_index(m_->total_shapes), 0.0);
  dphi_.assign(as_index(m_->total_shapes), 0.0);
  shaped_at_.assign(m_->string_contacts.size(), std::numeric_limits<double>::quiet_NaN());
  strap_pull_.assign(m_->straps.size(), 0.0);
  strap_slope_.assign(m_->straps.size(), 0.0);
  q_.assign(n, 0.0);
  v_.assign(n, 0.0);
  force_.setZero(n_);
  joint_friction_.setZero(n_);
  acceleration_.setZero(n_);
  mass_.setZero(n_, n_);
  factor_.setZero(n_, n_);
  stiffness_.setZero(n_, n_);
  damping_.setZero(n_, n_);
  gradients_.resize(m_->contacts.size());
  for (auto& g : gradients_) {
    for (auto* vector :
         {&g.by_force, &g.by_compression, &g.compression, &g.rate, &g.strike, &g.by_slope}) {
      vector->setZero(n_);
    }
  }
  for (auto* vector : {&prescription_.row, &prescription_.by_position, &prescription_.by_speed}) {
    vector->setZero(n_);
  }
  for (auto* vector : {&column_a_, &column_b_, &dn_, &dp_, &du_}) vector->assign(n, {});
  for (auto* vector : {&own_column_, &first_, &second_}) vector->assign(n, {});
  along_.assign(n, 0.0);
  for (int k = 0; k < n_; ++k) {
    for (int i = k; i >= 0; i = m_->coordinate_parent[as_index(i)]) filled_.push_back(k + i * n_);
  }
  inverse_.assign(n, 1.0);
  for (const FlexibleBeam& beam : m_->beams) {
    beam_turn_.push_back(Rotation::of(beam.base.angle));
    auto& pairs = shape_pairs_.emplace_back();
    for (int k = 0; k < beam.count; ++k) {
      for (int l = 0; l < beam.count; ++l) {
        pairs.push_back({beam.shape_product(k, l), beam.shape_cross(l, k), beam.stiffness(k, l)});
      }
    }
  }
}

void Dynamics::keep_law_rates(std::size_t contact) {
  const Contact& of = m_->contacts[contact];
  std::copy_n(law_states_[contact].rate.begin(), of.law.n_states(),
              law_rate_.begin() + of.first_state);
}

/// Law and friction of a contact that was located.
void Dynamics::load_contact(std::size_t i) {
  ContactState& state = contacts_[i];
  const Contact& contact = m_->contacts[i];
  if (!state.closed) {
    state.friction = {0.0, 0.0};
    if (idle_[i] != 0) {
      state.law = {};
      if (loaded_[i] != 0) {
        law_states_[i] = {};
        loaded_[i] = 0;
        keep_law_rates(i);
      }
    } else {
      // The states of the law go on; an open contact gives no rate.
      state.law =
          contact.law.evaluate(std::min(0.0, state.compression), 0.0, memory(i), &law_states_[i]);
      keep_law_rates(i);
    }
    return;
  }
  if (static_laws_) {
    const CurveValue v = contact.law.static_force(state.compression);
    state.law = {};
    state.law.force = v.force;
    state.law.d_compression = v.slope;
  } else {
    if (contact.law.has_memory()) contact.law.keep_cycle(largest_[i], cycles_[i]);
    state.law = contact.law.evaluate(state.compression, state.rate, memory(i), &law_states_[i]);
    loaded_[i] = 1;
    keep_law_rates(i);
  }
  state.friction = feltmb::evaluate(contact.friction, state.slip);
}

std::vector<double> Dynamics::memories() const {
  std::vector<double> out = largest_;
  for (std::size_t i = 0; i < turns_.size(); ++i) {
    for (const TurningPoint& turn : turns_[i]) {
      out.push_back(static_cast<double>(i));
      out.push_back(turn.compression);
    }
  }
  return out;
}

void Dynamics::set_memories(std::span<const double> memories) {
  const std::size_t n = largest_.size();
  std::copy_n(memories.begin(), n, largest_.begin());
  for (TurningPoints& turns : turns_) turns.clear();
  for (std::size_t k = n; k + 1 < memories.size(); k += 2) {
    const auto i = static_cast<std::size_t>(memories[k]);
    m_->contacts[i].law.turn(memories[k + 1], largest_[i], turns_[i]);
  }
}

void Dynamics::apply_contacts() {
  for (std::size_t i = 0; i < contacts_.size(); ++i) {
    load_contact(i);
    const ContactState& state = contacts_[i];
    if (!state.closed) continue;
    const Contact& contact = m_->contacts[i];
    const Vec2 f = state.law.force * (state.normal - state.friction.value * perp(state.normal));
    apply(contact.b.link, state.point, f);
    if (contact.a.link != 0) apply(contact.a.link, state.point, -f);
    if (contact.string_contact >= 0) {
      apply(contact.b.link, state.center,
            (state.law.force * state.string.slope) * state.strike_gradient);
    }
  }
}

const ContactState& Dynamics::press(std::size_t i, const Dynamics& at_place,
                                    const MechanicalState& state, const Drive& drive) {
  const Contact& contact = m_->contacts[i];
  for (const int link : {contact.a.link, contact.b.link}) {
    links_[as_index(link)] = at_place.links_[as_index(link)];
  }
  std::copy_n(at_place.law_.begin() + contact.first_state, contact.law.n_states(),
              law_.begin() + contact.first_state);
  largest_[i] = at_place.largest_[i];
  turns_[i] = at_place.turns_[i];
  locate_contact(i, state, drive, Detail::kAllContacts);
  load_contact(i);
  return contacts_[i];
}

void Dynamics::add_wrench(int link, Vec2 force, double moment, Eigen::VectorXd& out) const {
  for (const int motion : m_->links[as_index(link)].path) {
    const Twist& w = twist_[as_index(motion)];
    out[w.coordinate] += dot(w.base, force) + w.rho * moment;
  }
}

std::string Dynamics::beyond_string() const {
  for (const StringContact& touch : m_->string_contacts) {
    const ContactState& state = contacts_[as_index(touch.contact)];
    const AttachedString& s = m_->string_of(touch);
    const double length = s.string.parameters().length;
    const double y = state.strike_position;
    if (!state.closed || (y >= 0.0 && y <= length)) continue;
    const Contact& contact = m_->contacts[as_index(touch.contact)];
    return format(
        "%s%s%s touches string \"%s\" at y = %.6g m, expected between its ends, 0 to %.6g m; look "
        "at "
        "anchor, length and direction of the string",
        contact.name.c_str(), contact.label.empty() ? "" : " ", contact.label.c_str(),
        s.name.c_str(), y, length);
  }
  return "";
}

void Dynamics::apply_straps() {
  for (std::size_t i = 0; i < m_->straps.size(); ++i) {
    const Strap& strap = m_->straps[i];
    const Vec2 pa = position(strap.a);
    const Vec2 pb = position(strap.b);
    const Vec2 d = pb - pa;
    strap_pull_[i] = 0.0;
    strap_slope_[i] = 0.0;
    const double taut = strap.free_length + std::max(0.0, strap.slack);
    if (dot(d, d) <= taut * taut) continue;
    const double distance = norm(d);
    const double e = distance - strap.free_length;
    const auto [k1, k2, k3] = strap.coefficients;
    strap_pull_[i] = e * (k1 + e * (k2 + e * k3));
    strap_slope_[i] = k1 + e * (2.0 * k2 + 3.0 * e * k3);
    const Vec2 f = (strap_pull_[i] / distance) * d;
    apply(strap.a.link, pa, f);
    apply(strap.b.link, pb, -f);
  }
}

/// Gravity and the inertial force of the bias acceleration of one link.
void Dynamics::apply_inertia(std::size_t i) {
  const Link& link = m_->links[i];
  const LinkState& state = links_[i];
  const Vec2 arm = state.rotation * link.center_of_mass;
  const Vec2 bias = state.bias - (state.omega * state.omega) * arm;
  apply(static_cast<int>(i), state.origin + arm, link.mass * (m_->gravity - bias));
}

/// Generalized forces and inertia of the motions of link i, which carries load_ and carried_.
void Dynamics::project(std::size_t i) {
  const Link& link = m_->links[i];
  const Wrench& w = load_[i];
  const Inertia& c = carried_[i];
  const int* path = link.path.data();
  const std::size_t size = link.path.size();
  double* mass = mass_.data();
  const bool weightless = c.mass == 0.0 && c.second == 0.0;
  for (std::size_t x = size - link.motions.size(); x < size; ++x) {
    const Twist& own = twist_[as_index(path[x])];
    if (own.held != 0) continue;
    force_[own.coordinate] += dot(own.base, w.force) + own.rho * w.moment;
    if (weightless) continue;
    // Momentum and angular momentum about the ground's origin for a unit rate.
    const Vec2 p = c.mass * own.base + own.rho * perp(c.first);
    const double l = cross(c.first, own.base) + own.rho * c.second;
    double* row = mass + own.coordinate;
    for (std::size_t y = 0; y <= x; ++y) {
      const Twist& other = twist_[as_index(path[y])];
      if (other.held == 0) row[other.coordinate * n_] += dot(other.base, p) + other.rho * l;
    }
  }
  load_[as_index(link.parent)].force += w.force;
  load_[as_index(link.parent)].moment += w.moment;
  Inertia& up = carried_[as_index(link.parent)];
  up.mass += c.mass;
  up.first += c.first;
  up.second += c.second;
}

void Dynamics::add_beam(std::size_t index) {
  const FlexibleBeam& beam = m_->beams[index];
  const ShapePair* pair = shape_pairs_[index].data();
  const LinkState& base = links_[as_index(beam.base.link)];
  const auto& path = m_->links[as_index(beam.base.link)].path;
  const Rotation frame = beam.base.angle != 0.0 ? base.rotation * beam_turn_[index] : base.rotation;
  const Vec2 arm = base.rotation * beam.base.offset;
  const Vec2 origin = base.origin + arm;
  const double omega = base.omega;
  const double omega2 = omega * omega;
  const Vec2 bias = base.bias - omega2 * arm;
  const double* e = q_.data() + beam.first;
  const double* rate = v_.data() + beam.first;

  Vec2 first{beam.first_moment, 0.0};
  Vec2 first_rate{};
  double second = beam.second_moment;
  double stretch = 0.0;  // integral of d . dd/dt
  for (int k = 0; k < beam.count; ++k) {
    first += e[k] * beam.shape_moment[as_index(k)];
    first_rate += rate[k] * beam.shape_moment[as_index(k)];
    double product = beam.radial[as_index(k)];
    double turned = beam.transverse[as_index(k)];
    double turned_rate = 0.0;
    double elastic = 0.0;
    for (int l = 0; l < beam.count; ++l, ++pair) {
      product += pair->product * e[l];
      turned += pair->cross * e[l];
      turned_rate += pair->cross * rate[l];
      elastic += pair->stiffness * (e[l] + beam.damping_time * rate[l]);
    }
    second += e[k] * (product + beam.radial[as_index(k)]);
    stretch += product * rate[k];
    if (held_[as_index(beam.first + k)] != 0) continue;
    const Vec2 moment = frame * beam.shape_moment[as_index(k)];
    const int row = beam.first + k;
    force_[row] +=
        dot(moment, m_->gravity - bias) + omega2 * product - 2.0 * omega * turned_rate - elastic;
    double* mass = mass_.data() + row;
    for (const int motion : path) {
      const Twist& w = twist_[as_index(motion)];
      if (w.held != 0) continue;
      mass[w.coordinate * n_] += dot(moment, w.base + w.rho * perp(origin)) + w.rho * turned;
    }
    const ShapePair* own = pair - beam.count;
    for (int l = 0; l <= k; ++l) {
      if (held_[as_index(beam.first + l)] == 0) mass[(beam.first + l) * n_] += own[l].product;
    }
  }
  const Vec2 first_world = frame * first;
  Wrench& w = load_[as_index(beam.base.link)];
  const Vec2 force = beam.mass * (m_->gravity - bias) + omega2 * first_world -
                     (2.0 * omega) * perp(frame * first_rate);
  w.force += force;
  w.moment += cross(origin, force) + cross(first_world, m_->gravity - bias) - 2.0 * omega * stretch;
  Inertia& carried = carried_[as_index(beam.base.link)];
  carried.mass += beam.mass;
  carried.first += first_world + beam.mass * origin;
  carried.second += second + 2.0 * dot(first_world, origin) + beam.mass * dot(origin, origin);
}

/// Starts the generalized forces with the resistance of the joints, as joint_friction has it.
void Dynamics::resist_joints() {
  joint_friction_.setZero();
  for (std::size_t i = 0; i < turning_.size(); ++i) {
    const int k = turning_[i];
    resistance_[i] = feltmb::evaluate(m_->joint_friction[as_index(k)], v_[as_index(k)]);
    joint_friction_[k] = resistance_[i].value;
  }
  for (const Dashpot& d : m_->dashpots) {
    joint_friction_[d.coordinate] += d.against(v_[as_index(d.coordinate)]).value;
  }
  force_.setZero();
  force_ -= joint_friction_;
}

void Dynamics::evaluate(const MechanicalState& state, const Drive& drive, Detail detail) {
  locate(state, drive, detail);
  applied_[0] = {};
  for (const std::size_t i : moving_) applied_[i] = {};
  apply_contacts();
  apply_straps();
  if (drive.kind == InputKind::kForce && drive.force != 0.0) {
    apply(m_->finger_point.link, position(m_->finger_point), drive.force * m_->finger_direction);
  }

  const bool condensed_too = detail == Detail::kAllContacts && !condensed_.empty();
  if (condensed_too) hold_condensed(false);
  for (const int place : filled_) mass_.data()[place] = 0.0;
  resist_joints();
  load_[0] = applied_[0];
  carried_[0] = {};
  for (const std::size_t i : moving_) {
    load_[i] = applied_[i];
    carried_[i] = {};
  }
  for (std::size_t b = 0; b < m_->beams.size(); ++b) add_beam(b);
  // Children come after their parents: what a link carries is complete when it is reached.
  for (std::size_t place = moving_.size(); place-- > 0;) {
    const std::size_t i = moving_[place];
    const Link& link = m_->links[i];
    if (link.mass != 0.0) {
      const LinkState& moving = links_[i];
      const Vec2 arm = moving.rotation * link.center_of_mass;
      const Vec2 center = moving.origin + arm;
      const Vec2 bias = moving.bias - (moving.omega * moving.omega) * arm;
      const Vec2 force = link.mass * (m_->gravity - bias);
      load_[i].force += force;
      load_[i].moment += cross(center, force);
      apply(static_cast<int>(i), center, force);
      Inertia& own = carried_[i];
      own.mass += link.mass;
      own.first += link.mass * center;
      own.second += link.mass * dot(center, center);
    }
    carried_[i].second += link.inertia;
    project(i);
  }
  for (const auto& spring : m_->springs) {
    const double x = q_[as_index(spring.coordinate)] - spring.rest_angle;
    force_[spring.coordinate] -= spring.stiffness * x + spring.play.at(x).force;
  }
  for (int k = 0; k < n_; ++k) {
    for (int j = m_->coordinate_parent[as_index(k)]; j >= 0;
         j = m_->coordinate_parent[as_index(j)]) {
      mass_(j, k) = mass_(k, j);
    }
  }
  if (drive.kind == InputKind::kTorque) force_[drive.coordinate] += drive.force;
  if (condensed_too) take_out_condensed();
  for (const int k : condensed_) {
    mass_(k, k) = 1.0;
    force_[k] = 0.0;
  }
  factor_mass();
  acceleration_ = force_;
  solve_mass(acceleration_);
  prescription_.active = is_prescribed(drive.kind);
  if (prescription_.active) prescribe(drive);
}

void Dynamics::condense_axial() {
  condensed_.clear();
  axial_stiffness_.clear();
  for (const FlexibleBeam& beam : m_->beams) {
    const int axial = beam.condense_axial ? beam.shapes.axial() : 0;
    for (int k = 0; k < axial; ++k) condensed_.push_back(beam.first + k);
    axial_stiffness_.emplace_back(beam.stiffness.topLeftCorner(axial, axial));
  }
  condensed_mass_.setZero(static_cast<Eigen::Index>(condensed_.size()), n_);
  condensed_force_.setZero(condensed_mass_.rows());
  hold_condensed(true);
}

/// Whether the condensed coordinates are left out of the equations.
void Dynamics::hold_condensed(bool hold) {
  for (const int k : condensed_) held_[as_index(k)] = hold ? 1 : 0;
  for (Twist& twist : twist_) twist.held = held_[as_index(twist.coordinate)] != 0;
}

/// Their equations, which were assembled with the others, are kept apart.
void Dynamics::take_out_condensed() {
  hold_condensed(true);
  for (std::size_t i = 0; i < condensed_.size(); ++i) {
    const int k = condensed_[i];
    const auto row = static_cast<Eigen::Index>(i);
    condensed_mass_.row(row) = mass_.row(k);
    condensed_force_[row] = force_[k];
  }
  for (const int k : condensed_) {
    mass_.row(k).setZero();
    mass_.col(k).setZero();
  }
}

void Dynamics::add_condensed_deflection(std::span<double> q) const {
  Eigen::Index row = 0;
  for (std::size_t b = 0; b < axial_stiffness_.size(); ++b) {
    const Eigen::Index axial = axial_stiffness_[b].rows();
    if (axial == 0) continue;
    const Eigen::VectorXd u =
        axial_stiffness_[b].solve(condensed_force_.segment(row, axial) -
                                  condensed_mass_.middleRows(row, axial) * acceleration_);
    for (Eigen::Index k = 0; k < axial; ++k)
      q[as_index(m_->beams[b].first + static_cast<int>(k))] += u[k];
    row += axial;
  }
}

double Dynamics::strap_force(int strap) const { return strap_pull_[as_index(strap)]; }

void Dynamics::factor_mass() {
  // L^T D L with the sparsity of the tree (R. Featherstone, Rigid Body Dynamics Algorithms, ch. 6).
  const int* parent = m_->coordinate_parent.data();
  double* factor = factor_.data();
  for (const int place : filled_) factor[place] = mass_.data()[place];
  for (int k = n_ - 1; k >= 0; --k) {
    const double inverse = 1.0 / factor[k + k * n_];
    inverse_[as_index(k)] = inverse;
    for (int i = parent[k]; i >= 0; i = parent[i]) {
      const double a = factor[k + i * n_] * inverse;
      for (int j = i; j >= 0; j = parent[j]) factor[i + j * n_] -= a * factor[k + j * n_];
      factor[k + i * n_] = a;
    }
  }
}

void Dynamics::solve_mass(Eigen::VectorXd& b) const {
  const int* parent = m_->coordinate_parent.data();
  const double* factor = factor_.data();
  double* x = b.data();
  for (int k = n_ - 1; k >= 0; --k) {
    const double own = x[k];
    for (int i = parent[k]; i >= 0; i = parent[i]) x[i] -= factor[k + i * n_] * own;
  }
  for (int k = 0; k < n_; ++k) {
    double own = x[k] * inverse_[as_index(k)];
    for (int i = parent[k]; i >= 0; i = parent[i]) own -= factor[k + i * n_] * x[i];
    x[k] = own;
  }
}

double Dynamics::string_force(int string_contact) const {
  const ContactState& state =
      contacts_[as_index(m_->string_contacts[as_index(string_contact)].contact)];
  return state.closed ? state.law.force : 0.0;
}

std::span<const double> Dynamics::phi(int string_contact) const {
  const StringContact& c = m_->string_contacts[as_index(string_contact)];
  return {phi_.data() + c.shape, as_index(m_->string_of(c).string.modes())};
}

std::span<const double> Dynamics::dphi(int string_contact) const {
  const StringContact& c = m_->string_contacts[as_index(string_contact)];
  return {dphi_.data() + c.shape, as_index(m_->string_of(c).string.modes())};
}

double Dynamics::kinetic_energy(std::span<const double> v) const {
  double energy = 0.0;
  for (int k = 0; k < n_; ++k) {
    double momentum = 0.5 * mass_(k, k) * v[as_index(k)];
    for (int i = m_->coordinate_parent[as_index(k)]; i >= 0;
         i = m_->coordinate_parent[as_index(i)]) {
      momentum += mass_(k, i) * v[as_index(i)];
    }
    energy += momentum * v[as_index(k)];
  }
  return energy;
}

double Dynamics::gravity_energy() const {
  double energy = 0.0;
  for (const FlexibleBeam& beam : m_->beams) {
    const LinkState& base = links_[as_index(beam.base.link)];
    Vec2 first{beam.first_moment, 0.0};
    for (int k = 0; k < beam.count; ++k) {
      first += q_[as_index(beam.first + k)] * beam.shape_moment[as_index(k)];
    }
    const Vec2 offset = Rotation::of(beam.base.angle) * first;
    energy -= dot(m_->gravity, beam.mass * (base.origin + base.rotation * beam.base.offset) +
                                   base.rotation * offset);
  }
  for (std::size_t i = 1; i < links_.size(); ++i) {
    if (m_->links[i].lump) continue;
    const Vec2 center = links_[i].origin + links_[i].rotation * m_->links[i].center_of_mass;
    energy -= m_->links[i].mass * dot(m_->gravity, center);
  }
  return energy;
}

double Dynamics::spring_energy(std::span<const double> q) const {
  double energy = 0.0;
  for (const auto& s : m_->springs) {
    const double angle = q[as_index(s.coordinate)] - s.rest_angle;
    energy += 0.5 * s.stiffness * angle * angle + s.play.at(angle).energy;
  }
  return energy;
}

double Dynamics::beam_energy(int index, std::span<const double> q) const {
  const FlexibleBeam& beam = m_->beams[as_index(index)];
  return half_quadratic(beam.stiffness, q.data() + beam.first);
}

double Dynamics::beam_damping_power(int index) const {
  const FlexibleBeam& beam = m_->beams[as_index(index)];
  return 2.0 * beam.damping_time * half_quadratic(beam.stiffness, v_.data() + beam.first);
}

double Dynamics::strap_energy(int index) const {
  const Strap& strap = m_->straps[as_index(index)];
  const double e = norm(position(strap.b) - position(strap.a)) - strap.free_length;
  if (e <= strap.slack || e <= 0.0) return 0.0;
  const auto primitive = [&k = strap.coefficients](double x) {
    return x * x * (k[0] / 2.0 + x * (k[1] / 3.0 + x * k[2] / 4.0));
  };
  return primitive(e) - primitive(std::max(0.0, strap.slack));
}

}  // namespace feltmb
