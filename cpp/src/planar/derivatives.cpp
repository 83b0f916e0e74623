#include <cmath>

#include "feltmb/core/index.hpp"
#include "feltmb/planar/dynamics.hpp"

namespace feltmb {

void Dynamics::complete_links() {
  move_lumps();
  for (std::size_t i = 1; i < links_.size(); ++i) {
    if (!m_->links[i].lump) continue;
    applied_[i] = Wrench{};
    apply_inertia(i);
  }
  for (std::size_t i = 1; i < links_.size(); ++i) {
    const Link& link = m_->links[i];
    const LinkState& parent = links_[as_index(link.parent)];
    LinkState& state = links_[i];
    const Vec2 arm = state.origin - parent.origin;
    state.acceleration =
        parent.acceleration + parent.alpha * perp(arm) - (parent.omega * parent.omega) * arm;
    state.alpha = parent.alpha;
    for (const int index : link.motions) {
      const Motion& motion = m_->motions[as_index(index)];
      const double a_k = acceleration_[motion.coordinate];
      state.alpha += motion.rho * a_k;
      state.acceleration +=
          a_k * translation_[as_index(index)] +
          (2.0 * v_[as_index(motion.coordinate)]) * translation_rate_[as_index(index)];
    }
  }
}

void Dynamics::differentiate() {
  stiffness_.setZero();
  damping_.setZero();
  gradient_count_ = 0;

  complete_links();

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
      const Motion& mk = m_->motions[as_index(link.path[x])];
      const int k = mk.coordinate;
      // Turning an upstream frame j turns the column of k with it; within one beam only the arm.
      const double arm_turn =
          -mk.rho * (net_virial - dot(net_force, links_[as_index(mk.link)].origin));
      const double turn = dot(net_force, perp(translation_[as_index(link.path[x])])) + arm_turn;
      stiffness_(k, k) += mk.rho * arm_turn;
      for (std::size_t y = 0; y < x; ++y) {
        const Motion& mj = m_->motions[as_index(link.path[y])];
        if (mj.rho == 0.0) continue;
        const double value = mj.rho * (mj.group == mk.group ? arm_turn : turn);
        stiffness_(k, mj.coordinate) += value;
        stiffness_(mj.coordinate, k) += value;
      }
    }
    if (link.mass == 0.0) continue;
    const std::size_t depth = link.path.size();
    for (std::size_t x = 0; x < depth; ++x) {
      const int j = link.path[x];
      const Motion& mj = m_->motions[as_index(j)];
      const LinkState& base = links_[as_index(m_->links[as_index(mj.link)].parent)];
      const Vec2 t = translation_[as_index(j)];
      second_[x] =
          link.mass * (base.alpha * perp(t) - (base.omega * base.omega) * t +
                       mj.rho * perp(acceleration - links_[as_index(mj.link)].acceleration));
      first_[x] = (2.0 * link.mass) * column_rate(j, velocity);
      own_column_[x] = column(j, center);
    }
    for (std::size_t y = 0; y < depth; ++y) {
      const int to = twist_[as_index(link.path[y])].coordinate * n_;
      for (std::size_t x = 0; x < depth; ++x) {
        const int place = twist_[as_index(link.path[x])].coordinate + to;
        stiffness_.data()[place] -= dot(own_column_[x], second_[y]);
        damping_.data()[place] -= dot(own_column_[x], first_[y]);
      }
    }
  }

  differentiate_members();
  for (std::size_t i = 0; i < contacts_.size(); ++i) {
    if (contacts_[i].closed) differentiate_contact(i);
  }
  if (prescription_.active) differentiate_prescription();
  release_condensed();
}

void Dynamics::differentiate_stiff() {
  // Zero where the tree fills nothing, since the last differentiate() or before.
  stiffness_.setZero();
  damping_.setZero();
  gradient_count_ = 0;
  differentiate_members();
  for (std::size_t i = 0; i < contacts_.size(); ++i) {
    if (!contacts_[i].closed) continue;
    if (m_->contacts[i].string_contact >= 0) {
      differentiate_contact(i);
    } else {
      differentiate_stiff_contact(i);
    }
  }
  if (prescription_.active) {
    complete_links();
    differentiate_prescription();
  }
  release_condensed();
}

/// Beams, springs, joints, dashpots and straps.
void Dynamics::differentiate_members() {
  for (const FlexibleBeam& beam : m_->beams) {
    const double* from = beam.stiffness.data();
    for (int l = beam.first; l < beam.first + beam.count; ++l) {
      double* stiffness = stiffness_.data() + l * n_;
      double* damping = damping_.data() + l * n_;
      for (int k = beam.first; k < beam.first + beam.count; ++k, ++from) {
        stiffness[k] -= *from;
        damping[k] -= beam.damping_time * *from;
      }
    }
  }
  for (const auto& spring : m_->springs) {
    const double x = q_[as_index(spring.coordinate)] - spring.rest_angle;
    stiffness_(spring.coordinate, spring.coordinate) -= spring.stiffness + spring.play.at(x).slope;
  }
  for (std::size_t i = 0; i < turning_.size(); ++i) {
    damping_(turning_[i], turning_[i]) -= resistance_[i].slope;
  }
  for (const Dashpot& d : m_->dashpots) {
    damping_(d.coordinate, d.coordinate) -= d.against(v_[as_index(d.coordinate)]).slope;
  }
  for (std::size_t i = 0; i < m_->straps.size(); ++i) {
    if (strap_pull_[i] > 0.0) differentiate_strap(i);
  }
}

/// Held coordinates have no equation; others still depend on where they are held.
void Dynamics::release_condensed() {
  for (const int k : condensed_) {
    stiffness_.row(k).setZero();
    damping_.row(k).setZero();
    for (int i = 0; i < gradient_count_; ++i) {
      gradients_[as_index(i)].by_force[k] = 0.0;
      gradients_[as_index(i)].by_compression[k] = 0.0;
      gradients_[as_index(i)].by_slope[k] = 0.0;
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
    column_b_[as_index(k)] = jk;
  }
  for (const int k : strap.coordinates) {
    for (const int j : strap.coordinates) {
      const Vec2 jk = column_b_[as_index(k)];
      const Vec2 jj = column_b_[as_index(j)];
      stiffness_(k, j) -=
          (strap_slope_[i] - geometric) * dot(u, jk) * dot(u, jj) + geometric * dot(jk, jj);
    }
  }
}

void Dynamics::differentiate_contact(std::size_t i) {
  const Contact& contact = m_->contacts[i];
  const ContactState& s = contacts_[i];
  const LinkState& a = links_[as_index(contact.a.link)];
  const LinkState& b = links_[as_index(contact.b.link)];
  ContactGradient& g = next_gradient(i, true);

  const double force = s.law.force;
  const double mu = s.friction.value;
  const Vec2 n = s.normal;
  const Vec2 tangent = perp(n);
  const Vec2 f = force * (n - mu * tangent);
  const Vec2 velocity_a = a.velocity + a.omega * perp(s.point - a.origin);
  const Vec2 velocity_b = b.velocity + b.omega * perp(s.point - b.origin);
  const Vec2 center_velocity = b.velocity + b.omega * perp(s.center - b.origin);
  const bool with_string = contact.string_contact >= 0;

  for (const int j : contact.coordinates) {
    const int motion_a = motion_of(j, contact.a.link);
    const int motion_b = motion_of(j, contact.b.link);
    const bool in_a = motion_a >= 0;
    const bool in_b = motion_b >= 0;
    const Vec2 ja = in_a ? column(motion_a, s.point) : Vec2{};
    const Vec2 jb = in_b ? column(motion_b, s.point) : Vec2{};
    const Vec2 center_column = in_b ? column(motion_b, s.center) : Vec2{};
    column_a_[as_index(j)] = ja;
    column_b_[as_index(j)] = jb;

    Vec2 dn{};
    if (s.turning_normal) {
      const Vec2 base_column = in_a ? column(motion_a, s.base) : Vec2{};
      const Vec2 shift = center_column - base_column;
      dn = s.curvature * (shift - dot(n, shift) * n);
    } else if (in_a) {
      dn = rho(motion_a) * tangent;
    }
    dn_[as_index(j)] = dn;

    double de = -dot(n, jb - ja);
    double strike = 0.0;
    if (with_string) {
      strike = dot(s.strike_gradient, center_column);
      de -= s.string.slope * strike;
    }
    g.compression[j] = de;
    g.strike[j] = strike;
    g.by_slope[j] = strike;

    // Point of application at fixed compression; its share through de is in by_compression.
    const Vec2 dp = center_column - (contact.radius_b - 0.5 * s.compression) * dn;
    dp_[as_index(j)] = dp;
    Vec2 du{};
    if (in_b)
      du += column_rate(motion_b, velocity_b) + b.omega * perp(dp - jb);
    else
      du += b.omega * perp(dp);
    if (in_a)
      du -= column_rate(motion_a, velocity_a) + a.omega * perp(dp - ja);
    else
      du -= a.omega * perp(dp);
    du_[as_index(j)] = du;

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
    const Vec2 jk = column_b_[as_index(k)] - column_a_[as_index(k)];
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
      const Vec2 dn = dn_[as_index(j)];
      const double dslip = dot(perp(dn), s.relative_velocity) + dot(tangent, du_[as_index(j)]);
      const Vec2 df = force * (dn - mu * perp(dn) - (s.friction.slope * dslip) * tangent);
      double value = dot(jk, df);
      // Where the point of application moves against the material of each link.
      value += rho_b * dot(perp(dp_[as_index(j)] - column_b_[as_index(j)]), f) -
               rho_a * dot(perp(dp_[as_index(j)] - column_a_[as_index(j)]), f);
      if (with_string) value += force * s.string.curvature * g.strike[k] * g.strike[j];
      stiffness_(k, j) += value;
      damping_(k, j) -= force * s.friction.slope * along *
                        dot(tangent, column_b_[as_index(j)] - column_a_[as_index(j)]);
    }
  }
}

ContactGradient& Dynamics::next_gradient(std::size_t contact, bool exact) {
  ContactGradient& g = gradients_[as_index(gradient_count_++)];
  // Of a contact as before, what is not zero is about to be overwritten.
  if (!exact && !g.exact && g.contact == static_cast<int>(contact)) return g;
  g.contact = static_cast<int>(contact);
  g.exact = exact;
  for (auto* vector :
       {&g.by_force, &g.by_compression, &g.compression, &g.rate, &g.strike, &g.by_slope}) {
    vector->setZero();
  }
  return g;
}

void Dynamics::differentiate_stiff_contact(std::size_t i) {
  const ContactState& s = contacts_[i];
  ContactGradient& g = next_gradient(i, false);
  const Vec2 tangent = perp(s.normal);
  const double mu = s.friction.value;
  const double resistance = s.law.force * s.friction.slope;
  const std::vector<int>& coordinates = m_->contacts[i].coordinates;
  const std::size_t count = coordinates.size();
  for (std::size_t x = 0; x < count; ++x) {
    const int k = coordinates[x];
    const int motion_a = motion_of(k, m_->contacts[i].a.link);
    const int motion_b = motion_of(k, m_->contacts[i].b.link);
    Vec2 relative{};
    if (motion_b >= 0) relative = column(motion_b, s.point);
    if (motion_a >= 0) relative -= column(motion_a, s.point);
    const double along = dot(relative, tangent);
    const double apart = dot(relative, s.normal);
    along_[x] = along;
    g.compression[k] = -apart;
    g.by_force[k] = apart - mu * along;
    const double own = resistance * along;
    for (std::size_t y = 0; y < x; ++y) {
      const double value = own * along_[y];
      damping_(k, coordinates[y]) -= value;
      damping_(coordinates[y], k) -= value;
    }
    damping_(k, k) -= own * along;
  }
}

}  // namespace feltmb
