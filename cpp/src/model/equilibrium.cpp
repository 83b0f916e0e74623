#include "feltmb/model/equilibrium.hpp"

#include <algorithm>
#include <cmath>

#include "feltmb/core/error.hpp"

namespace feltmb {
namespace {

class Rest {
 public:
  Rest(const std::shared_ptr<const Mechanism>& mechanism, double finger_force)
      : m_(*mechanism),
        dynamics_(mechanism),
        zero_(m_.coordinates.size(), 0.0),
        law_(static_cast<std::size_t>(m_.total_law_states), 0.0),
        eta_(static_cast<std::size_t>(m_.total_modes), 0.0),
        eta_rate_(eta_) {
    dynamics_.use_static_laws();
    drive_.force = finger_force;
  }

  /// Potential energy [J]; also evaluates forces at q. Its rounding is that of its parts, which may
  /// be far larger than their sum: `parts` is the sum of their sizes.
  double energy(const Eigen::VectorXd& q) {
    const std::span<const double> position{q.data(), zero_.size()};
    dynamics_.evaluate({position, zero_, law_, eta_, eta_rate_}, drive_);
    double sum = 0.0;
    parts = 0.0;
    const auto add = [&](double part) {
      sum += part;
      parts += std::fabs(part);
    };
    add(dynamics_.gravity_energy());
    add(dynamics_.spring_energy(position));
    for (std::size_t i = 0; i < m_.straps.size(); ++i) {
      add(dynamics_.strap_energy(static_cast<int>(i)));
    }
    for (std::size_t i = 0; i < m_.beams.size(); ++i) {
      add(dynamics_.beam_energy(static_cast<int>(i), position));
    }
    for (std::size_t i = 0; i < m_.contacts.size(); ++i) {
      const ContactState& s = dynamics_.contacts()[i];
      if (s.closed) add(m_.contacts[i].law.static_energy(s.compression));
    }
    if (drive_.force != 0.0) {
      add(-drive_.force * dot(m_.finger_direction, dynamics_.position(m_.finger_point)));
    }
    return sum;
  }

  Eigen::MatrixXd hessian() {
    dynamics_.differentiate();
    Eigen::MatrixXd h = -dynamics_.stiffness();
    for (const auto& g : dynamics_.gradients()) {
      const double slope =
          dynamics_.contacts()[static_cast<std::size_t>(g.contact)].law.d_compression;
      h -= (slope * g.by_force + g.by_compression) * g.compression.transpose();
    }
    return 0.5 * (h + h.transpose());
  }

  const Eigen::VectorXd& force() const { return dynamics_.force(); }

  /// Static deflection under the present contact forces; returns its largest change [m kg^1/2].
  double deflect_strings() {
    double change = 0.0;
    for (std::size_t s = 0; s < m_.strings.size(); ++s) {
      const double force = dynamics_.string_force(static_cast<int>(s));
      const auto phi = dynamics_.phi(static_cast<int>(s));
      const auto& a = m_.strings[s];
      for (std::size_t j = 0; j < phi.size(); ++j) {
        double& eta = eta_[static_cast<std::size_t>(a.offset) + j];
        // Half steps: felt on a soft string would otherwise overshoot.
        const double target = phi[j] * force / a.string.stiffness()[j];
        const double next = 0.5 * (eta + target);
        change = std::max(change, std::fabs(next - eta));
        eta = next;
      }
    }
    return change;
  }

  const Mechanism& m_;
  double parts = 0.0;
  Dynamics dynamics_;
  std::vector<double> zero_;
  std::vector<double> law_;
  std::vector<double> eta_;
  std::vector<double> eta_rate_;
  Drive drive_;
};

double scaled_residual(const Mechanism& m, const Eigen::VectorXd& force) {
  double largest = 0.0;
  for (Eigen::Index k = 0; k < force.size(); ++k) {
    largest =
        std::max(largest, std::fabs(force[k]) * m.coordinate_scale[static_cast<std::size_t>(k)]);
  }
  return largest;
}

/// Steps of the coordinates [rad, m] by steps whose length is limited, in units of the scales: the
/// length counts the turn of each joint and that of each body against the ground. In the angles of
/// the joints alone the first joint of a long chain would be allowed a step that throws its end far
/// off, and the search would take ten thousands of short steps.
Eigen::MatrixXd from_turns(const Mechanism& m) {
  const auto n = static_cast<Eigen::Index>(m.coordinates.size());
  const auto turned_by = [&](const Link& link) {
    return m.motions[static_cast<std::size_t>(link.motions[0])].coordinate;
  };
  Eigen::MatrixXd turns = Eigen::MatrixXd::Identity(n, n);
  for (std::size_t i = 1; i < m.links.size(); ++i) {
    if (m.links[i].kind != LinkKind::kRevolute) continue;
    for (int a = m.links[i].parent; a > 0; a = m.links[static_cast<std::size_t>(a)].parent) {
      const Link& above = m.links[static_cast<std::size_t>(a)];
      if (above.kind == LinkKind::kRevolute) turns(turned_by(m.links[i]), turned_by(above)) = 1.0;
    }
  }
  const Eigen::VectorXd scale = Eigen::Map<const Eigen::VectorXd>(m.coordinate_scale.data(), n);
  const Eigen::MatrixXd both = 0.5 * (turns.transpose() * turns + Eigen::MatrixXd::Identity(n, n));
  const Eigen::MatrixXd inverse = both.llt().matrixU().solve(Eigen::MatrixXd::Identity(n, n));
  return scale.asDiagonal() * inverse;
}

}  // namespace

Equilibrium find_equilibrium(const std::shared_ptr<const Mechanism>& mechanism, double finger_force,
                             std::span<const double> near) {
  Rest rest(mechanism, finger_force);
  const Mechanism& m = *mechanism;
  const auto n = static_cast<Eigen::Index>(m.coordinates.size());
  if (!near.empty() && near.size() != m.start_pose.size()) {
    throw InvalidParameter(
        format("pose near rest: got %zu values, expected %zu", near.size(), m.start_pose.size()));
  }
  Eigen::VectorXd q =
      Eigen::Map<const Eigen::VectorXd>(near.empty() ? m.start_pose.data() : near.data(), n);
  const Eigen::VectorXd scale = Eigen::Map<const Eigen::VectorXd>(m.coordinate_scale.data(), n);
  const Eigen::MatrixXd way = from_turns(m);
  // 1e-13 J: a force of 0.1 nN on felt that moves by 1 mm.
  const double enough = near.empty() ? 1e-13 : 1e-18;
  constexpr int most = 20000;
  double radius = 5.0;  // in coordinate scales, about 5 mm of felt travel
  double energy = rest.energy(q);
  int iteration = 0;
  bool stable = false;
  bool moved = true;
  Eigen::SelfAdjointEigenSolver<Eigen::MatrixXd> eigen(n);
  for (; iteration < most; ++iteration) {
    const Eigen::VectorXd force = scale.cwiseProduct(rest.force());
    if (moved) eigen.compute(way.transpose() * rest.hessian() * way);
    const Eigen::VectorXd& values = eigen.eigenvalues();
    const Eigen::VectorXd along =
        eigen.eigenvectors().transpose() * (way.transpose() * rest.force());
    if (force.cwiseAbs().maxCoeff() <= enough) {
      stable = values.minCoeff() > 0.0;
      if (stable) break;
    }
    // Newton step with the eigenvalues made positive, cut to the trust region.
    const double floor = 1e-9 * std::max(1e-12, values.cwiseAbs().maxCoeff());
    Eigen::VectorXd step = along.cwiseQuotient(values.cwiseAbs().cwiseMax(floor));
    const double length = step.cwiseAbs().maxCoeff();
    // Each direction on its own: shortening all of them alike would let the softest one, which
    // wants to go far, hold up the others.
    step = step.cwiseMax(-radius).cwiseMin(radius);
    const Eigen::VectorXd dq = way * (eigen.eigenvectors() * step);
    const double predicted = along.dot(step);
    const double trial = rest.energy(q + dq);
    const double residual_before = force.cwiseAbs().maxCoeff();
    const double residual_after = scaled_residual(m, rest.force());
    // Where the energy changes by its rounding only, the force decides: by either of them the
    // search could go to and fro between two poses for ever.
    const bool flat = std::fabs(energy - trial) <= 1e-13 * rest.parts;
    if (flat ? residual_after < residual_before : energy - trial >= 1e-4 * predicted) {
      q += dq;
      energy = trial;
      radius = std::min(20.0, 2.0 * radius);
      moved = true;
      if (!m.strings.empty()) {
        rest.deflect_strings();
        energy = rest.energy(q);
      }
    } else {
      rest.energy(q);
      moved = false;
      radius = 0.25 * std::min(length, radius);
      if (radius < 1e-14) {
        stable = values.minCoeff() > 0.0 && residual_before < 1e-10;
        break;
      }
    }
  }
  if (!stable) {
    std::string text =
        "mechanism \"" + m.name + "\": no rest pose was reached from start_pose under gravity;";
    for (Eigen::Index k = 0; k < n; ++k) {
      const double force = rest.force()[k];
      if (std::fabs(force) * scale[k] > 1e-10) {
        text += format(" %s = %.6g still feels %.3g %s;",
                       m.coordinates[static_cast<std::size_t>(k)].c_str(), q[k], force,
                       m.coordinate_is_angle[static_cast<std::size_t>(k)] ? "N m" : "N");
      }
    }
    text += " is a body without support, or start_pose on the wrong side of a contact?";
    throw ModelError(text);
  }
  Equilibrium result;
  result.q.assign(q.data(), q.data() + n);
  result.eta = rest.eta_;
  result.law.assign(static_cast<std::size_t>(m.total_law_states), 0.0);
  result.largest_compression.assign(m.contacts.size(), 0.0);
  for (std::size_t i = 0; i < m.contacts.size(); ++i) {
    const ContactState& s = rest.dynamics_.contacts()[i];
    if (!s.closed) continue;
    const Contact& contact = m.contacts[i];
    double* states = result.law.data() + contact.first_state;
    contact.law.relax(s.compression, states);
    if (contact.law.has_memory()) {
      result.largest_compression[i] = contact.law.felt_compression(s.compression, {states, 0.0});
    }
  }
  result.iterations = iteration;
  result.residual = scaled_residual(m, rest.force());
  return result;
}

}  // namespace feltmb
