#include "feltmb/planar/dynamics.hpp"

#include <algorithm>
#include <cmath>
#include <limits>

namespace feltmb {
namespace {

std::size_t at(int i) { return static_cast<std::size_t>(i); }

}  // namespace

Dynamics::Dynamics(std::shared_ptr<const Mechanism> mechanism)
    : m_(std::move(mechanism)), n_(m_->size()) {
  const std::size_t n = at(n_);
  links_.resize(m_->links.size());
  applied_.resize(m_->links.size());
  contacts_.resize(m_->contacts.size());
  motion_of_.assign(m_->links.size() * n, -1);
  for (std::size_t i = 0; i < m_->links.size(); ++i) {
    for (const int motion : m_->links[i].path) {
      motion_of_[i * n + at(m_->motions[at(motion)].coordinate)] = motion;
    }
  }
  translation_.assign(m_->motions.size(), {});
  translation_rate_.assign(m_->motions.size(), {});
  phi_.assign(at(m_->total_modes), 0.0);
  dphi_.assign(at(m_->total_modes), 0.0);
  shaped_at_.assign(m_->strings.size(), std::numeric_limits<double>::quiet_NaN());
  strap_pull_.assign(m_->straps.size(), 0.0);
  strap_slope_.assign(m_->straps.size(), 0.0);
  q_.assign(n, 0.0);
  v_.assign(n, 0.0);
  force_.setZero(n_);
  acceleration_.setZero(n_);
  mass_.setZero(n_, n_);
  factor_.setZero(n_, n_);
  stiffness_.setZero(n_, n_);
  damping_.setZero(n_, n_);
  gradients_.resize(m_->contacts.size());
  for (auto& g : gradients_) {
    for (auto* vector : {&g.by_force, &g.by_compression, &g.compression, &g.rate, &g.strike}) {
      vector->setZero(n_);
    }
  }
  for (auto* vector : {&column_a_, &column_b_, &dn_, &dp_, &du_}) vector->assign(n, {});
}

void Dynamics::move_links(std::span<const double> q, std::span<const double> v) {
  std::copy(q.begin(), q.end(), q_.begin());
  std::copy(v.begin(), v.end(), v_.begin());
  for (std::size_t i = 1; i < links_.size(); ++i) {
    const Link& link = m_->links[i];
    const LinkState& parent = links_[at(link.parent)];
    LinkState& state = links_[i];
    Vec2 arm = parent.rotation * link.position;
    Rotation frame = parent.rotation;
    if (link.angle != 0.0) frame = frame * link.base;
    if (link.kind == LinkKind::kStation) arm += frame * Vec2{link.station, 0.0};
    double turn = 0.0;
    double turn_rate = 0.0;
    Vec2 relative_velocity{};
    for (const int index : link.motions) {
      const Motion& motion = m_->motions[at(index)];
      const std::size_t k = at(motion.coordinate);
      turn += motion.rho * q[k];
      turn_rate += motion.rho * v[k];
      if (link.kind == LinkKind::kRevolute) continue;
      const Vec2 t = frame * motion.translation;
      translation_[at(index)] = t;
      translation_rate_[at(index)] = parent.omega * perp(t);
      arm += q[k] * t;
      relative_velocity += v[k] * t;
    }
    state.origin = parent.origin + arm;
    state.rotation = turn != 0.0 ? frame * Rotation::of(turn) : frame;
    state.omega = parent.omega + turn_rate;
    state.velocity = parent.velocity + parent.omega * perp(arm) + relative_velocity;
    state.bias = parent.bias - (parent.omega * parent.omega) * arm +
                 (2.0 * parent.omega) * perp(relative_velocity);
  }
}

Vec2 Dynamics::position(LinkPoint p) const {
  const LinkState& link = links_[at(p.link)];
  return link.origin + link.rotation * p.local;
}

Vec2 Dynamics::velocity(LinkPoint p) const {
  const LinkState& link = links_[at(p.link)];
  return link.velocity + link.omega * perp(link.rotation * p.local);
}

Vec2 Dynamics::column(int motion, Vec2 point) const {
  const Motion& m = m_->motions[at(motion)];
  return translation_[at(motion)] + m.rho * perp(point - links_[at(m.link)].origin);
}

Vec2 Dynamics::column_rate(int motion, Vec2 point_velocity) const {
  const Motion& m = m_->motions[at(motion)];
  return translation_rate_[at(motion)] +
         m.rho * perp(point_velocity - links_[at(m.link)].velocity);
}

void Dynamics::locate_contact(std::size_t i, std::span<const double> eta,
                              std::span<const double> eta_rate, const Drive& drive) {
  const Contact& contact = m_->contacts[i];
  ContactState& state = contacts_[i];
  const LinkState& a = links_[at(contact.a.link)];
  const LinkState& b = links_[at(contact.b.link)];
  const Vec2 center = b.origin + b.rotation * contact.b.local;
  const Vec2 base = a.origin + a.rotation * contact.a.local;
  const Vec2 d = center - base;
  state.center = center;
  state.turning_normal = false;
  state.curvature = 0.0;
  double compression = 0.0;

  const auto on_line = [&](Vec2 local_normal, double radius_a) {
    state.normal = a.rotation * local_normal;
    compression = radius_a + contact.radius_b - dot(state.normal, d);
  };
  const auto on_circle = [&](double sign) {
    const double distance = norm(d);
    state.turning_normal = true;
    state.curvature = distance > 1e-12 ? 1.0 / distance : 0.0;
    state.normal = distance > 1e-12 ? (sign / distance) * d : Vec2{1.0, 0.0};
    compression = sign > 0.0 ? contact.radius_a + contact.radius_b - distance
                             : distance + contact.radius_b - contact.radius_a;
  };

  switch (contact.kind) {
    case PairKind::kLineCircle: on_line(contact.normal_a, 0.0); break;
    case PairKind::kCircleCircle: on_circle(1.0); break;
    case PairKind::kConcaveCircle: on_circle(-1.0); break;
    case PairKind::kHybridCircle: {
      const Vec2 local = a.rotation.inverse(d);
      const bool first = dot(local, contact.arc_tangent[0]) > 0.0;
      const bool second = dot(local, contact.arc_tangent[1]) > 0.0;
      if (!first && !second) {
        on_circle(1.0);
      } else {
        // Where both half-planes claim the center, the nearer boundary is the surface.
        const bool use_second =
            second && (!first || dot(local, contact.arc_normal[1]) >
                                     dot(local, contact.arc_normal[0]));
        on_line(contact.arc_normal[use_second ? 1 : 0], contact.radius_a);
      }
      break;
    }
  }

  double extra_rate = 0.0;
  if (contact.string >= 0) {
    const AttachedString& attached = m_->strings[at(contact.string)];
    const Vec2 along = attached.sense * perp(state.normal);
    const std::size_t offset = at(attached.offset);
    const std::size_t modes = at(attached.string.modes());
    state.strike_gradient = attached.moving_strike_point ? along : Vec2{};
    state.strike_position = attached.moving_strike_point ? attached.anchor + dot(along, d)
                                                         : attached.strike_position;
    const std::span<double> phi{phi_.data() + offset, modes};
    const std::span<double> dphi{dphi_.data() + offset, modes};
    double& shaped = shaped_at_[at(contact.string)];
    if (state.strike_position != shaped) {
      attached.string.shapes(state.strike_position, phi, dphi);
      shaped = state.strike_position;
    }
    state.string = attached.string.point(phi, dphi, eta.subspan(offset, modes),
                                         eta_rate.subspan(offset, modes));
    const Vec2 center_velocity = b.velocity + b.omega * perp(center - b.origin);
    state.strike_speed = dot(state.strike_gradient, center_velocity);
    compression -= state.string.displacement;
    extra_rate = -state.string.velocity - state.string.slope * state.strike_speed;
  }
  if (contact.finger) {
    compression += drive.displacement;
    extra_rate = drive.speed;
  }

  state.compression = compression;
  state.point = center - (contact.radius_b - 0.5 * compression) * state.normal;
  const Vec2 velocity_a = a.velocity + a.omega * perp(state.point - a.origin);
  const Vec2 velocity_b = b.velocity + b.omega * perp(state.point - b.origin);
  state.relative_velocity = velocity_b - velocity_a;
  state.rate = extra_rate - dot(state.normal, state.relative_velocity);
  state.slip = dot(perp(state.normal), state.relative_velocity);
  const bool active = contact.finger ? drive.motion : contact.enabled;
  state.closed = active && compression > 0.0;
}

void Dynamics::locate(std::span<const double> q, std::span<const double> v,
                      std::span<const double> eta, std::span<const double> eta_rate,
                      const Drive& drive) {
  move_links(q, v);
  for (std::size_t i = 0; i < contacts_.size(); ++i) {
    if (m_->contacts[i].finger && !drive.motion) {
      contacts_[i].closed = false;
      continue;
    }
    locate_contact(i, eta, eta_rate, drive);
  }
}

void Dynamics::apply(int link, Vec2 point, Vec2 force) {
  Wrench& w = applied_[at(link)];
  w.force += force;
  w.moment += cross(point, force);
  w.virial += dot(point, force);
}

void Dynamics::evaluate(std::span<const double> q, std::span<const double> v,
                        std::span<const double> eta, std::span<const double> eta_rate,
                        const Drive& drive) {
  locate(q, v, eta, eta_rate, drive);
  std::fill(applied_.begin(), applied_.end(), Wrench{});

  for (std::size_t i = 0; i < contacts_.size(); ++i) {
    ContactState& state = contacts_[i];
    const Contact& contact = m_->contacts[i];
    if (!state.closed) {
      state.law = {};
      state.friction = {0.0, 0.0};
      continue;
    }
    state.law = contact.law.evaluate(state.compression, state.rate);
    state.friction = feltmb::evaluate(contact.friction, state.slip);
    const Vec2 f = state.law.force * (state.normal - state.friction.value * perp(state.normal));
    apply(contact.b.link, state.point, f);
    if (contact.a.link != 0) apply(contact.a.link, state.point, -f);
    if (contact.string >= 0) {
      apply(contact.b.link, state.center,
            (state.law.force * state.string.slope) * state.strike_gradient);
    }
  }

  for (std::size_t i = 0; i < m_->straps.size(); ++i) {
    const Strap& strap = m_->straps[i];
    const Vec2 pa = position(strap.a);
    const Vec2 pb = position(strap.b);
    const Vec2 d = pb - pa;
    const double distance = norm(d);
    const double e = distance - strap.free_length;
    strap_pull_[i] = 0.0;
    strap_slope_[i] = 0.0;
    if (e <= strap.slack || e <= 0.0) continue;
    const auto [k1, k2, k3] = strap.coefficients;
    strap_pull_[i] = e * (k1 + e * (k2 + e * k3));
    strap_slope_[i] = k1 + e * (2.0 * k2 + 3.0 * e * k3);
    const Vec2 f = (strap_pull_[i] / distance) * d;
    apply(strap.a.link, pa, f);
    apply(strap.b.link, pb, -f);
  }

  if (!drive.motion && drive.force != 0.0) {
    apply(m_->finger_point.link, position(m_->finger_point),
          drive.force * m_->finger_direction);
  }

  // Gravity and the inertial force of the bias acceleration, then projection on the coordinates.
  for (int k = 0; k < n_; ++k) force_[k] = -joint_friction(k);
  for (std::size_t i = 1; i < links_.size(); ++i) {
    const Link& link = m_->links[i];
    const LinkState& state = links_[i];
    const Vec2 arm = state.rotation * link.center_of_mass;
    const Vec2 bias = state.bias - (state.omega * state.omega) * arm;
    apply(static_cast<int>(i), state.origin + arm, link.mass * (m_->gravity - bias));
    const Wrench& w = applied_[i];
    for (const int index : link.path) {
      const Motion& motion = m_->motions[at(index)];
      force_[motion.coordinate] +=
          dot(translation_[at(index)], w.force) +
          motion.rho * (w.moment - cross(links_[at(motion.link)].origin, w.force));
    }
  }
  for (const FlexibleBeam& beam : m_->beams) {
    for (int k = 0; k < beam.count; ++k) {
      double f = 0.0;
      for (int j = 0; j < beam.count; ++j) {
        f += beam.stiffness(k, j) * (q_[at(beam.first + j)] +
                                     beam.damping_time * v_[at(beam.first + j)]);
      }
      force_[beam.first + k] -= f;
    }
  }
  for (const auto& spring : m_->springs) {
    force_[spring.coordinate] -= spring.stiffness * (q[at(spring.coordinate)] - spring.rest_angle);
  }

  compute_mass();
  if (!condensed_.empty()) hold_condensed();
  factor_mass();
  acceleration_ = force_;
  solve_mass(acceleration_);
  for (std::size_t i = 0; i < condensed_.size(); ++i) {
    condensed_force_[static_cast<Eigen::Index>(i)] -=
        condensed_rows_.row(static_cast<Eigen::Index>(i)).dot(acceleration_);
  }
}

void Dynamics::condense_axial() {
  condensed_.clear();
  for (const FlexibleBeam& beam : m_->beams) {
    if (!beam.condense_axial) continue;
    for (int k = 0; k < beam.shapes.axial(); ++k) condensed_.push_back(beam.first + k);
  }
  const auto count = static_cast<Eigen::Index>(condensed_.size());
  condensed_force_.setZero(count);
  condensed_rows_.setZero(count, n_);
}

void Dynamics::hold_condensed() {
  for (std::size_t i = 0; i < condensed_.size(); ++i) {
    const int k = condensed_[i];
    const auto row = static_cast<Eigen::Index>(i);
    condensed_rows_.row(row) = mass_.row(k);
    condensed_force_[row] = force_[k];
  }
  for (const int k : condensed_) {
    mass_.row(k).setZero();
    mass_.col(k).setZero();
    mass_(k, k) = 1.0;
    force_[k] = 0.0;
  }
}

double Dynamics::condensed_deflection(int k) const {
  for (const FlexibleBeam& beam : m_->beams) {
    const int axial = beam.shapes.axial();
    if (!beam.condense_axial || k < beam.first || k >= beam.first + axial) continue;
    for (std::size_t i = 0; i < condensed_.size(); ++i) {
      if (condensed_[i] != beam.first) continue;
      const Eigen::VectorXd f = condensed_force_.segment(static_cast<Eigen::Index>(i), axial);
      const Eigen::VectorXd u = beam.stiffness.topLeftCorner(axial, axial).ldlt().solve(f);
      return u[k - beam.first];
    }
  }
  return 0.0;
}

double Dynamics::joint_friction(int k) const {
  return feltmb::evaluate(m_->joint_friction[at(k)], v_[at(k)]).value;
}

double Dynamics::strap_force(int strap) const { return strap_pull_[at(strap)]; }

void Dynamics::compute_mass() {
  mass_.setZero();
  for (std::size_t i = 1; i < links_.size(); ++i) {
    const Link& link = m_->links[i];
    if (link.mass == 0.0 && link.inertia == 0.0) continue;
    const LinkState& state = links_[i];
    const Vec2 center = state.origin + state.rotation * link.center_of_mass;
    for (std::size_t x = 0; x < link.path.size(); ++x) {
      const int k = link.path[x];
      const int row = m_->motions[at(k)].coordinate;
      const Vec2 jk = column(k, center);
      for (std::size_t y = 0; y <= x; ++y) {
        const int j = link.path[y];
        mass_(row, m_->motions[at(j)].coordinate) +=
            link.mass * dot(jk, column(j, center)) + link.inertia * rho(k) * rho(j);
      }
    }
  }
  for (int k = 0; k < n_; ++k) {
    for (int j = m_->coordinate_parent[at(k)]; j >= 0; j = m_->coordinate_parent[at(j)]) {
      mass_(j, k) = mass_(k, j);
    }
  }
}

void Dynamics::factor_mass() {
  // L^T D L with the sparsity of the tree (R. Featherstone, Rigid Body Dynamics Algorithms, ch. 6).
  factor_ = mass_;
  for (int k = n_ - 1; k >= 0; --k) {
    for (int i = m_->coordinate_parent[at(k)]; i >= 0; i = m_->coordinate_parent[at(i)]) {
      const double a = factor_(k, i) / factor_(k, k);
      for (int j = i; j >= 0; j = m_->coordinate_parent[at(j)]) {
        factor_(i, j) -= a * factor_(k, j);
      }
      factor_(k, i) = a;
    }
  }
}

void Dynamics::solve_mass(Eigen::VectorXd& b) const {
  for (int k = n_ - 1; k >= 0; --k) {
    for (int i = m_->coordinate_parent[at(k)]; i >= 0; i = m_->coordinate_parent[at(i)]) {
      b[i] -= factor_(k, i) * b[k];
    }
  }
  for (int k = 0; k < n_; ++k) {
    b[k] /= factor_(k, k);
    for (int i = m_->coordinate_parent[at(k)]; i >= 0; i = m_->coordinate_parent[at(i)]) {
      b[k] -= factor_(k, i) * b[i];
    }
  }
}

double Dynamics::string_force(int string) const {
  const ContactState& state = contacts_[at(m_->strings[at(string)].contact)];
  return state.closed ? state.law.force : 0.0;
}

std::span<const double> Dynamics::phi(int string) const {
  const auto& s = m_->strings[at(string)];
  return {phi_.data() + s.offset, at(s.string.modes())};
}

std::span<const double> Dynamics::dphi(int string) const {
  const auto& s = m_->strings[at(string)];
  return {dphi_.data() + s.offset, at(s.string.modes())};
}

void Dynamics::differentiate() {
  stiffness_.setZero();
  damping_.setZero();
  gradient_count_ = 0;

  // Accelerations of the links, needed for the second time derivatives of the columns.
  for (std::size_t i = 1; i < links_.size(); ++i) {
    const Link& link = m_->links[i];
    const LinkState& parent = links_[at(link.parent)];
    LinkState& state = links_[i];
    const Vec2 arm = state.origin - parent.origin;
    state.acceleration = parent.acceleration + parent.alpha * perp(arm) -
                         (parent.omega * parent.omega) * arm;
    state.alpha = parent.alpha;
    for (const int index : link.motions) {
      const Motion& motion = m_->motions[at(index)];
      const double a_k = acceleration_[motion.coordinate];
      state.alpha += motion.rho * a_k;
      state.acceleration += a_k * translation_[at(index)] +
                            (2.0 * v_[at(motion.coordinate)]) * translation_rate_[at(index)];
    }
  }

  // Net force of each link on its own: applied minus inertial. applied_ holds -m bias already.
  for (std::size_t i = 1; i < links_.size(); ++i) {
    const Link& link = m_->links[i];
    const LinkState& state = links_[i];
    const Vec2 arm = state.rotation * link.center_of_mass;
    const Vec2 center = state.origin + arm;
    const Vec2 velocity = state.velocity + state.omega * perp(arm);
    const double w2 = state.omega * state.omega;
    const Vec2 acceleration = state.acceleration + state.alpha * perp(arm) - w2 * arm;
    const Vec2 bias = state.bias - w2 * arm;
    const Vec2 remaining = -link.mass * (acceleration - bias);
    const Wrench& w = applied_[i];
    const Vec2 net_force = w.force + remaining;
    const double net_virial = w.virial + dot(center, remaining);

    for (std::size_t x = 0; x < link.path.size(); ++x) {
      const Motion& mk = m_->motions[at(link.path[x])];
      const int k = mk.coordinate;
      // Turning an upstream frame j turns the column of k with it; within one beam only the arm.
      const double arm_turn =
          -mk.rho * (net_virial - dot(net_force, links_[at(mk.link)].origin));
      const double turn = dot(net_force, perp(translation_[at(link.path[x])])) + arm_turn;
      stiffness_(k, k) += mk.rho * arm_turn;
      for (std::size_t y = 0; y < x; ++y) {
        const Motion& mj = m_->motions[at(link.path[y])];
        if (mj.rho == 0.0) continue;
        const double value = mj.rho * (mj.group == mk.group ? arm_turn : turn);
        stiffness_(k, mj.coordinate) += value;
        stiffness_(mj.coordinate, k) += value;
      }
    }
    if (link.mass == 0.0) continue;
    for (const int j : link.path) {
      const Motion& mj = m_->motions[at(j)];
      const LinkState& base = links_[at(m_->links[at(mj.link)].parent)];
      const Vec2 t = translation_[at(j)];
      const Vec2 second = base.alpha * perp(t) - (base.omega * base.omega) * t +
                          mj.rho * perp(acceleration - links_[at(mj.link)].acceleration);
      const Vec2 first = column_rate(j, velocity);
      for (const int k : link.path) {
        const Vec2 jk = column(k, center);
        const int row = m_->motions[at(k)].coordinate;
        stiffness_(row, mj.coordinate) -= link.mass * dot(jk, second);
        damping_(row, mj.coordinate) -= 2.0 * link.mass * dot(jk, first);
      }
    }
  }

  for (const FlexibleBeam& beam : m_->beams) {
    stiffness_.block(beam.first, beam.first, beam.count, beam.count) -= beam.stiffness;
    damping_.block(beam.first, beam.first, beam.count, beam.count) -=
        beam.damping_time * beam.stiffness;
  }
  for (const auto& spring : m_->springs) {
    stiffness_(spring.coordinate, spring.coordinate) -= spring.stiffness;
  }
  for (int k = 0; k < n_; ++k) {
    damping_(k, k) -= feltmb::evaluate(m_->joint_friction[at(k)], v_[at(k)]).slope;
  }
  for (std::size_t i = 0; i < m_->straps.size(); ++i) {
    if (strap_pull_[i] > 0.0) differentiate_strap(i);
  }
  for (std::size_t i = 0; i < contacts_.size(); ++i) {
    if (contacts_[i].closed) differentiate_contact(i);
  }
  for (const int k : condensed_) {
    stiffness_.row(k).setZero();
    stiffness_.col(k).setZero();
    damping_.row(k).setZero();
    damping_.col(k).setZero();
    for (int i = 0; i < gradient_count_; ++i) {
      ContactGradient& g = gradients_[at(i)];
      for (auto* vector :
           {&g.by_force, &g.by_compression, &g.compression, &g.rate, &g.strike}) {
        (*vector)[k] = 0.0;
      }
    }
  }
}

void Dynamics::differentiate_strap(std::size_t i) {
  const Strap& strap = m_->straps[i];
  const Vec2 pa = position(strap.a);
  const Vec2 pb = position(strap.b);
  const double distance = norm(pb - pa);
  const Vec2 u = (1.0 / distance) * (pb - pa);
  const double geometric = strap_pull_[i] / distance;
  for (const int k : strap.coordinates) {
    Vec2 jk{};
    if (const int motion = motion_of(k, strap.b.link); motion >= 0) jk += column(motion, pb);
    if (const int motion = motion_of(k, strap.a.link); motion >= 0) jk -= column(motion, pa);
    column_b_[at(k)] = jk;
  }
  for (const int k : strap.coordinates) {
    for (const int j : strap.coordinates) {
      const Vec2 jk = column_b_[at(k)];
      const Vec2 jj = column_b_[at(j)];
      stiffness_(k, j) -= (strap_slope_[i] - geometric) * dot(u, jk) * dot(u, jj) +
                          geometric * dot(jk, jj);
    }
  }
}

void Dynamics::differentiate_contact(std::size_t i) {
  const Contact& contact = m_->contacts[i];
  const ContactState& s = contacts_[i];
  const LinkState& a = links_[at(contact.a.link)];
  const LinkState& b = links_[at(contact.b.link)];
  ContactGradient& g = gradients_[at(gradient_count_++)];
  g.contact = static_cast<int>(i);
  for (auto* vector : {&g.by_force, &g.by_compression, &g.compression, &g.rate, &g.strike}) {
    vector->setZero();
  }

  const double force = s.law.force;
  const double mu = s.friction.value;
  const Vec2 n = s.normal;
  const Vec2 tangent = perp(n);
  const Vec2 f = force * (n - mu * tangent);
  const Vec2 velocity_a = a.velocity + a.omega * perp(s.point - a.origin);
  const Vec2 velocity_b = b.velocity + b.omega * perp(s.point - b.origin);
  const Vec2 center_velocity = b.velocity + b.omega * perp(s.center - b.origin);
  const Vec2 base = a.origin + a.rotation * contact.a.local;
  const bool with_string = contact.string >= 0;

  for (const int j : contact.coordinates) {
    const int motion_a = motion_of(j, contact.a.link);
    const int motion_b = motion_of(j, contact.b.link);
    const bool in_a = motion_a >= 0;
    const bool in_b = motion_b >= 0;
    const Vec2 ja = in_a ? column(motion_a, s.point) : Vec2{};
    const Vec2 jb = in_b ? column(motion_b, s.point) : Vec2{};
    const Vec2 center_column = in_b ? column(motion_b, s.center) : Vec2{};
    column_a_[at(j)] = ja;
    column_b_[at(j)] = jb;

    Vec2 dn{};
    if (s.turning_normal) {
      const Vec2 base_column = in_a ? column(motion_a, base) : Vec2{};
      const Vec2 shift = center_column - base_column;
      const double sign = contact.kind == PairKind::kConcaveCircle ? -1.0 : 1.0;
      dn = (sign * s.curvature) * (shift - dot(n, shift) * n);
    } else if (in_a) {
      dn = rho(motion_a) * tangent;
    }
    dn_[at(j)] = dn;

    double de = -dot(n, jb - ja);
    double strike = 0.0;
    if (with_string) {
      strike = dot(s.strike_gradient, center_column);
      de -= s.string.slope * strike;
    }
    g.compression[j] = de;
    g.strike[j] = strike;

    // Point of application at fixed compression; its share through de is in by_compression.
    const Vec2 dp = center_column - (contact.radius_b - 0.5 * s.compression) * dn;
    dp_[at(j)] = dp;
    Vec2 du{};
    if (in_b) du += column_rate(motion_b, velocity_b) + b.omega * perp(dp - jb);
    else du += b.omega * perp(dp);
    if (in_a) du -= column_rate(motion_a, velocity_a) + a.omega * perp(dp - ja);
    else du -= a.omega * perp(dp);
    du_[at(j)] = du;

    double de_rate = -dot(dn, s.relative_velocity) - dot(n, du);
    if (with_string) {
      const Vec2 center_rate = in_b ? column_rate(motion_b, center_velocity) : Vec2{};
      de_rate -= s.string.slope_rate * strike + s.string.curvature * strike * s.strike_speed +
                 s.string.slope * dot(s.strike_gradient, center_rate);
    }
    g.rate[j] = de_rate;
  }

  const double slip_by_compression = 0.5 * (b.omega - a.omega);
  for (const int k : contact.coordinates) {
    const Vec2 jk = column_b_[at(k)] - column_a_[at(k)];
    const int motion_a = motion_of(k, contact.a.link);
    const int motion_b = motion_of(k, contact.b.link);
    const double rho_a = motion_a >= 0 ? rho(motion_a) : 0.0;
    const double rho_b = motion_b >= 0 ? rho(motion_b) : 0.0;
    const double along = dot(jk, tangent);
    g.by_force[k] = dot(jk, n) - mu * along;
    if (with_string) g.by_force[k] += s.string.slope * g.strike[k];
    g.by_compression[k] = (rho_b - rho_a) * dot(perp(0.5 * n), f) -
                          force * s.friction.slope * slip_by_compression * along;

    for (const int j : contact.coordinates) {
      const Vec2 dn = dn_[at(j)];
      const double dslip = dot(perp(dn), s.relative_velocity) + dot(tangent, du_[at(j)]);
      const Vec2 df = force * (dn - mu * perp(dn) - (s.friction.slope * dslip) * tangent);
      double value = dot(jk, df);
      // Where the point of application moves against the material of each link.
      value += rho_b * dot(perp(dp_[at(j)] - column_b_[at(j)]), f) -
               rho_a * dot(perp(dp_[at(j)] - column_a_[at(j)]), f);
      if (with_string) value += force * s.string.curvature * g.strike[k] * g.strike[j];
      stiffness_(k, j) += value;
      damping_(k, j) -= force * s.friction.slope * along *
                        dot(tangent, column_b_[at(j)] - column_a_[at(j)]);
    }
  }
}

double Dynamics::kinetic_energy(std::span<const double> v) const {
  const Eigen::Map<const Eigen::VectorXd> velocity(v.data(), n_);
  return 0.5 * velocity.dot(mass_ * velocity);
}

double Dynamics::gravity_energy() const {
  double energy = 0.0;
  for (std::size_t i = 1; i < links_.size(); ++i) {
    const Vec2 center =
        links_[i].origin + links_[i].rotation * m_->links[i].center_of_mass;
    energy -= m_->links[i].mass * dot(m_->gravity, center);
  }
  return energy;
}

double Dynamics::spring_energy(std::span<const double> q) const {
  double energy = 0.0;
  for (const auto& s : m_->springs) {
    const double angle = q[at(s.coordinate)] - s.rest_angle;
    energy += 0.5 * s.stiffness * angle * angle;
  }
  return energy;
}

double Dynamics::beam_energy(int index, std::span<const double> q) const {
  const FlexibleBeam& beam = m_->beams[at(index)];
  const Eigen::Map<const Eigen::VectorXd> e(q.data() + beam.first, beam.count);
  return 0.5 * e.dot(beam.stiffness * e);
}

double Dynamics::beam_damping_power(int index) const {
  const FlexibleBeam& beam = m_->beams[at(index)];
  const Eigen::Map<const Eigen::VectorXd> rate(v_.data() + beam.first, beam.count);
  return beam.damping_time * rate.dot(beam.stiffness * rate);
}

double Dynamics::strap_energy(int index) const {
  const Strap& strap = m_->straps[at(index)];
  const double e = norm(position(strap.b) - position(strap.a)) - strap.free_length;
  if (e <= strap.slack || e <= 0.0) return 0.0;
  const auto [k1, k2, k3] = strap.coefficients;
  const auto primitive = [&](double x) {
    return x * x * (k1 / 2.0 + x * (k2 / 3.0 + x * k3 / 4.0));
  };
  return primitive(e) - primitive(std::max(0.0, strap.slack));
}

}  // namespace feltmb
