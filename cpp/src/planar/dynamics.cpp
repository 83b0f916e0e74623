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
  moves_.assign(m_->links.size() * n, 0);
  for (std::size_t i = 0; i < m_->links.size(); ++i) {
    for (const int k : m_->links[i].path) moves_[i * n + at(k)] = 1;
  }
  translation_.assign(n, {});
  translation_rate_.assign(n, {});
  rho_.assign(n, 0.0);
  pivot_.assign(n, {});
  pivot_velocity_.assign(n, {});
  phi_.assign(at(m_->total_modes), 0.0);
  dphi_.assign(at(m_->total_modes), 0.0);
  shaped_at_.assign(m_->strings.size(), std::numeric_limits<double>::quiet_NaN());
  strap_pull_.assign(m_->straps.size(), 0.0);
  strap_slope_.assign(m_->straps.size(), 0.0);
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
  for (std::size_t k = 0; k < n; ++k) {
    rho_[k] = m_->coordinate_kind[k] == JointKind::kRevolute ? 1.0 : 0.0;
  }
}

void Dynamics::move_links(std::span<const double> q, std::span<const double> v) {
  std::copy(v.begin(), v.end(), v_.begin());
  for (std::size_t i = 1; i < links_.size(); ++i) {
    const Link& link = m_->links[i];
    const LinkState& parent = links_[at(link.parent)];
    LinkState& state = links_[i];
    const std::size_t k = at(link.coordinate);
    Vec2 arm = parent.rotation * link.position;
    double angle = link.angle;
    if (link.kind == JointKind::kRevolute) {
      angle += q[k];
      state.omega = parent.omega + v[k];
      state.velocity = parent.velocity + parent.omega * perp(arm);
      state.bias = parent.bias - (parent.omega * parent.omega) * arm;
      translation_rate_[k] = {};
    } else {
      const Vec2 axis = parent.rotation * link.axis;
      arm += q[k] * axis;
      state.omega = parent.omega;
      state.velocity = parent.velocity + parent.omega * perp(arm) + v[k] * axis;
      state.bias = parent.bias - (parent.omega * parent.omega) * arm +
                   (2.0 * parent.omega * v[k]) * perp(axis);
      translation_[k] = axis;
      translation_rate_[k] = parent.omega * perp(axis);
    }
    state.origin = parent.origin + arm;
    if (angle != 0.0) {
      const Rotation turn = Rotation::of(angle);
      state.rotation = {parent.rotation.c * turn.c - parent.rotation.s * turn.s,
                        parent.rotation.s * turn.c + parent.rotation.c * turn.s};
    } else {
      state.rotation = parent.rotation;
    }
    pivot_[k] = state.origin;
    pivot_velocity_[k] = state.velocity;
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

Vec2 Dynamics::column(int k, Vec2 point) const {
  return translation_[at(k)] + rho_[at(k)] * perp(point - pivot_[at(k)]);
}

Vec2 Dynamics::column_rate(int k, Vec2 point_velocity) const {
  return translation_rate_[at(k)] + rho_[at(k)] * perp(point_velocity - pivot_velocity_[at(k)]);
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
    for (const int k : link.path) {
      force_[k] += dot(translation_[at(k)], w.force) +
                   rho_[at(k)] * (w.moment - cross(pivot_[at(k)], w.force));
    }
  }
  for (const auto& spring : m_->springs) {
    force_[spring.coordinate] -= spring.stiffness * (q[at(spring.coordinate)] - spring.rest_angle);
  }

  compute_mass();
  factor_mass();
  acceleration_ = force_;
  solve_mass(acceleration_);
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
      const Vec2 jk = column(k, center);
      for (std::size_t y = 0; y <= x; ++y) {
        const int j = link.path[y];
        mass_(k, j) += link.mass * dot(jk, column(j, center)) +
                       link.inertia * rho_[at(k)] * rho_[at(j)];
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
    const double a_k = acceleration_[link.coordinate];
    state.acceleration = parent.acceleration + parent.alpha * perp(arm) -
                         (parent.omega * parent.omega) * arm;
    state.alpha = parent.alpha;
    if (link.kind == JointKind::kRevolute) {
      state.alpha += a_k;
    } else {
      const std::size_t k = at(link.coordinate);
      state.acceleration += a_k * translation_[k] +
                            (2.0 * v_[k]) * (parent.omega * perp(translation_[k]));
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
      const int k = link.path[x];
      // Turning an upstream frame j turns the column of k with it.
      const double turn = dot(net_force, perp(translation_[at(k)])) -
                          rho_[at(k)] * (net_virial - dot(net_force, pivot_[at(k)]));
      if (rho_[at(k)] != 0.0) stiffness_(k, k) += turn;
      for (std::size_t y = 0; y < x; ++y) {
        const int j = link.path[y];
        if (rho_[at(j)] == 0.0) continue;
        stiffness_(k, j) += turn;
        stiffness_(j, k) += turn;
      }
    }
    if (link.mass == 0.0) continue;
    for (const int j : link.path) {
      const int joint_link = m_->coordinate_link[at(j)];
      const LinkState& moved = links_[at(joint_link)];
      const LinkState& base = links_[at(m_->links[at(joint_link)].parent)];
      Vec2 second;
      if (rho_[at(j)] != 0.0) {
        second = perp(acceleration - moved.acceleration);
      } else {
        second = base.alpha * perp(translation_[at(j)]) -
                 (base.omega * base.omega) * translation_[at(j)];
      }
      const Vec2 first = column_rate(j, velocity);
      for (const int k : link.path) {
        const Vec2 jk = column(k, center);
        stiffness_(k, j) -= link.mass * dot(jk, second);
        damping_(k, j) -= 2.0 * link.mass * dot(jk, first);
      }
    }
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
    if (moves(k, strap.b.link)) jk += column(k, pb);
    if (moves(k, strap.a.link)) jk -= column(k, pa);
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
    const bool in_a = moves(j, contact.a.link);
    const bool in_b = moves(j, contact.b.link);
    const Vec2 ja = in_a ? column(j, s.point) : Vec2{};
    const Vec2 jb = in_b ? column(j, s.point) : Vec2{};
    const Vec2 center_column = in_b ? column(j, s.center) : Vec2{};
    column_a_[at(j)] = ja;
    column_b_[at(j)] = jb;

    Vec2 dn{};
    if (s.turning_normal) {
      const Vec2 base_column = in_a ? column(j, base) : Vec2{};
      const Vec2 shift = center_column - base_column;
      const double sign = contact.kind == PairKind::kConcaveCircle ? -1.0 : 1.0;
      dn = (sign * s.curvature) * (shift - dot(n, shift) * n);
    } else if (in_a) {
      dn = rho_[at(j)] * tangent;
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
    if (in_b) du += column_rate(j, velocity_b) + b.omega * perp(dp - jb);
    else du += b.omega * perp(dp);
    if (in_a) du -= column_rate(j, velocity_a) + a.omega * perp(dp - ja);
    else du -= a.omega * perp(dp);
    du_[at(j)] = du;

    double de_rate = -dot(dn, s.relative_velocity) - dot(n, du);
    if (with_string) {
      const Vec2 center_rate = in_b ? column_rate(j, center_velocity) : Vec2{};
      de_rate -= s.string.slope_rate * strike + s.string.curvature * strike * s.strike_speed +
                 s.string.slope * dot(s.strike_gradient, center_rate);
    }
    g.rate[j] = de_rate;
  }

  const double slip_by_compression = 0.5 * (b.omega - a.omega);
  for (const int k : contact.coordinates) {
    const Vec2 jk = column_b_[at(k)] - column_a_[at(k)];
    const double turn = rho_[at(k)] * ((moves(k, contact.b.link) ? 1.0 : 0.0) -
                                       (moves(k, contact.a.link) ? 1.0 : 0.0));
    const double along = dot(jk, tangent);
    g.by_force[k] = dot(jk, n) - mu * along;
    if (with_string) g.by_force[k] += s.string.slope * g.strike[k];
    g.by_compression[k] = turn * dot(perp(0.5 * n), f) -
                          force * s.friction.slope * slip_by_compression * along;

    for (const int j : contact.coordinates) {
      const Vec2 dn = dn_[at(j)];
      const double dslip = dot(perp(dn), s.relative_velocity) + dot(tangent, du_[at(j)]);
      const Vec2 df = force * (dn - mu * perp(dn) - (s.friction.slope * dslip) * tangent);
      double value = dot(jk, df);
      // Where the point of application moves against the material of each link.
      if (moves(k, contact.b.link)) {
        value += rho_[at(k)] * dot(perp(dp_[at(j)] - column_b_[at(j)]), f);
      }
      if (moves(k, contact.a.link)) {
        value -= rho_[at(k)] * dot(perp(dp_[at(j)] - column_a_[at(j)]), f);
      }
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
