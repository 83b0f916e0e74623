#include "feltmb/model/equilibrium.hpp"

#include <algorithm>
#include <cmath>

#include "feltmb/core/error.hpp"
#include "feltmb/numeric/eigenproblem.hpp"

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
        eta_rate_(eta_),
        compliance_(Eigen::MatrixXd::Zero(static_cast<Eigen::Index>(m_.string_contacts.size()),
                                          static_cast<Eigen::Index>(m_.string_contacts.size()))) {
    dynamics_.use_static_laws();
    drive_.force = finger_force;
  }

  /// Potential energy [J]; also evaluates forces at q. Its rounding is that of its parts, which may
  /// be far larger than their sum: `parts` is the sum of their sizes.
  double energy(const Eigen::VectorXd& q) {
    const std::span<const double> position{q.data(), zero_.size()};
    deflect_strings(position);
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
    for (const AttachedString& s : m_.strings) add(s.string.elastic_energy(modes(s)));
    if (drive_.force != 0.0) {
      add(-drive_.force * dot(m_.finger_direction, dynamics_.position(m_.finger_point)));
    }
    return sum;
  }

  Eigen::MatrixXd hessian() {
    dynamics_.differentiate();
    Eigen::MatrixXd h = -dynamics_.stiffness();
    const auto gradients = dynamics_.gradients();
    std::vector<const ContactGradient*> on_string;
    for (const auto& g : gradients) {
      const auto contact = static_cast<std::size_t>(g.contact);
      if (m_.contacts[contact].string_contact >= 0) {
        on_string.push_back(&g);
        h -= g.by_compression * g.compression.transpose();
        continue;
      }
      const double slope = dynamics_.contacts()[contact].law.d_compression;
      h -= (slope * g.by_force + g.by_compression) * g.compression.transpose();
    }
    if (on_string.empty()) return 0.5 * (h + h.transpose());
    // Felts on strings are in series with them: dF = S (de - C dF).
    const auto count = static_cast<Eigen::Index>(on_string.size());
    Eigen::MatrixXd series = Eigen::MatrixXd::Identity(count, count);
    Eigen::MatrixXd slopes = Eigen::MatrixXd::Zero(count, count);
    const auto touch = [&](Eigen::Index i) {
      return m_.contacts[static_cast<std::size_t>(on_string[static_cast<std::size_t>(i)]->contact)]
          .string_contact;
    };
    for (Eigen::Index i = 0; i < count; ++i) {
      const auto contact =
          static_cast<std::size_t>(on_string[static_cast<std::size_t>(i)]->contact);
      slopes(i, i) = dynamics_.contacts()[contact].law.d_compression;
      for (Eigen::Index j = 0; j < count; ++j) {
        series(i, j) += slopes(i, i) * compliance_(touch(i), touch(j));
      }
    }
    slopes = series.partialPivLu().solve(slopes).eval();
    for (Eigen::Index i = 0; i < count; ++i) {
      for (Eigen::Index j = 0; j < count; ++j) {
        h -= (slopes(i, j) * on_string[static_cast<std::size_t>(i)]->by_force) *
             on_string[static_cast<std::size_t>(j)]->compression.transpose();
      }
    }
    return 0.5 * (h + h.transpose());
  }

  const Eigen::VectorXd& force() const { return dynamics_.force(); }

  /// Keeps the size of the mechanism and the energy of its springs and straps as they are drawn.
  void keep_start(std::span<const double> q) {
    start_energy = dynamics_.spring_energy(q);
    for (std::size_t i = 0; i < m_.straps.size(); ++i) {
      start_energy += dynamics_.strap_energy(static_cast<int>(i));
    }
    std::vector<Vec2> places;
    for (std::size_t i = 1; i < m_.links.size(); ++i) {
      if (m_.links[i].lump) continue;
      const int link = static_cast<int>(i);
      places.push_back(dynamics_.position({link, {}}));
      places.push_back(dynamics_.position({link, m_.links[i].center_of_mass}));
    }
    for (const Contact& c : m_.contacts) {
      places.push_back(dynamics_.position(c.a));
      places.push_back(dynamics_.position(c.b));
    }
    for (const Vec2 a : places) {
      for (const Vec2 b : places) start_size = std::max(start_size, norm(a - b));
    }
  }

  /// Modal coordinates of a string.
  std::span<double> modes(const AttachedString& s) {
    return std::span<double>(eta_).subspan(static_cast<std::size_t>(s.offset),
                                           static_cast<std::size_t>(s.string.modes()));
  }

  /// Static deflection of each string at a pose: it and the felts before it are springs in series,
  /// F(e) with e + C F(e) = the overlaps with the string at rest. Solved for each pose on its own,
  /// so that no force of a step that is not taken moves a string out of the way.
  void deflect_strings(std::span<const double> position) {
    if (m_.strings.empty()) return;
    std::fill(eta_.begin(), eta_.end(), 0.0);
    compliance_.setZero();
    // A felt that is open may be met by a string that another presses.
    const bool alone = m_.string_contacts.size() == m_.strings.size();
    dynamics_.locate({position, zero_, law_, eta_, eta_rate_}, drive_,
                     alone ? Detail::kClosedContacts : Detail::kAllContacts);
    for (const AttachedString& a : m_.strings) {
      std::vector<int> touching;
      bool any_closed = false;
      for (int c = a.first_contact; c < a.first_contact + a.contacts; ++c) {
        const auto contact = m_.string_contacts[static_cast<std::size_t>(c)].contact;
        if (m_.contacts[static_cast<std::size_t>(contact)].enabled) touching.push_back(c);
        any_closed = any_closed || state_of(c).closed;
      }
      if (!any_closed) continue;
      const auto stiffness = a.string.stiffness();
      for (const int c : touching) {
        for (const int d : touching) {
          const auto phi = dynamics_.phi(c);
          const auto other = dynamics_.phi(d);
          double compliance = 0.0;
          for (std::size_t j = 0; j < phi.size(); ++j) {
            compliance += phi[j] * other[j] / stiffness[j];
          }
          compliance_(c, d) = compliance;
        }
      }
      const Eigen::VectorXd force = forces_in_series(touching);
      const auto eta = modes(a);
      for (std::size_t i = 0; i < touching.size(); ++i) {
        const auto phi = dynamics_.phi(touching[i]);
        const double own = force[static_cast<Eigen::Index>(i)];
        for (std::size_t j = 0; j < phi.size(); ++j) eta[j] += phi[j] * own / stiffness[j];
      }
    }
  }

  const Mechanism& m_;
  double parts = 0.0;
  double start_energy = 0.0;  ///< of springs and straps in the start pose [J]
  double start_size = 0.0;    ///< largest distance of joints, centers of mass, surfaces there [m]
  Dynamics dynamics_;
  std::vector<double> zero_;
  std::vector<double> law_;
  std::vector<double> eta_;
  std::vector<double> eta_rate_;
  Eigen::MatrixXd compliance_;  ///< of strings between closed contacts with them [m/N], else 0
  Drive drive_;

 private:
  const ContactState& state_of(int string_contact) const {
    const StringContact& c = m_.string_contacts[static_cast<std::size_t>(string_contact)];
    return dynamics_.contacts()[static_cast<std::size_t>(c.contact)];
  }

  const ContactLaw& law_of(int string_contact) const {
    const StringContact& c = m_.string_contacts[static_cast<std::size_t>(string_contact)];
    return m_.contacts[static_cast<std::size_t>(c.contact)].law;
  }

  /// Static forces of felts on one string.
  Eigen::VectorXd forces_in_series(const std::vector<int>& touching) const {
    const auto count = static_cast<Eigen::Index>(touching.size());
    const auto own = [&](Eigen::Index i) { return touching[static_cast<std::size_t>(i)]; };
    Eigen::VectorXd overlap(count);
    Eigen::MatrixXd compliance(count, count);
    for (Eigen::Index i = 0; i < count; ++i) {
      overlap[i] = state_of(own(i)).compression;
      for (Eigen::Index j = 0; j < count; ++j) compliance(i, j) = compliance_(own(i), own(j));
    }
    Eigen::VectorXd force = Eigen::VectorXd::Zero(count);
    const auto alone = [&](Eigen::Index i) {
      const double others = compliance.row(i).dot(force) - compliance(i, i) * force[i];
      const double room = overlap[i] - others;
      return room > 0.0 ? force_in_series(law_of(own(i)), compliance(i, i), room) : 0.0;
    };
    if (count == 1) {
      force[0] = alone(0);
      return force;
    }
    // One contact takes the string away from another, or presses it against it: the energy of all
    // is convex in the forces. Newton's method on e = overlap - C F(e), and each contact after the
    // other, which always goes down, where that does not help.
    const auto miss = [&](const Eigen::VectorXd& f, Eigen::VectorXd& slope) -> Eigen::VectorXd {
      const Eigen::VectorXd e = overlap - compliance * f;
      Eigen::VectorXd out(count);
      for (Eigen::Index i = 0; i < count; ++i) {
        const CurveValue v = e[i] > 0.0 ? law_of(own(i)).static_force(e[i]) : CurveValue{0.0, 0.0};
        out[i] = v.force - f[i];
        slope[i] = v.slope;
      }
      return out;
    };
    Eigen::VectorXd slope(count);
    Eigen::VectorXd next_slope(count);
    Eigen::VectorXd left = miss(force, slope);
    constexpr int most = 1000;
    for (int k = 0; k < most; ++k) {
      const Eigen::MatrixXd matrix =
          Eigen::MatrixXd::Identity(count, count) + slope.asDiagonal() * compliance;
      const Eigen::VectorXd next = force + matrix.partialPivLu().solve(left);
      const Eigen::VectorXd next_left = miss(next, next_slope);
      if (next_left.norm() < left.norm()) {
        force = next;
        left = next_left;
        slope = next_slope;
        continue;
      }
      const Eigen::VectorXd before = force;
      for (Eigen::Index i = 0; i < count; ++i) force[i] = alone(i);
      left = miss(force, slope);
      if ((force - before).norm() <= 1e-15 * force.norm()) break;
    }
    return force;
  }

  /// Static force of a felt on a string of some compliance [m/N] that overlap [m].
  static double force_in_series(const ContactLaw& law, double compliance, double overlap) {
    // Force and overlap grow with the compression: halved until the numbers end.
    double low = 0.0;
    double high = overlap;
    for (double e = 0.5 * overlap; low < e && e < high; e = low + 0.5 * (high - low)) {
      (e + compliance * law.static_force(e).force > overlap ? high : low) = e;
    }
    return law.static_force(low).force;
  }
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

/// A state of equilibrium in which the bodies cannot be. Descent from a start pose in which they
/// overlap deeply ends in such states, jammed behind each other: they hold energy that nothing in
/// the mechanism could have stored. Throws ModelError.
void refuse_nonsense(Rest& rest, const Eigen::VectorXd& q) {
  const Mechanism& m = rest.m_;
  Dynamics& dynamics = rest.dynamics_;
  const std::string who = "mechanism \"" + m.name + "\": the rest pose makes no sense: ";
  const std::string hint =
      "; do bodies overlap in start_pose, or is one on the wrong side of another?";
  for (const FlexibleBeam& beam : m.beams) {
    const double bent =
        beam.deflection({q.data() + beam.first, static_cast<std::size_t>(beam.count)});
    if (bent > beam.length) {
      throw ModelError(
          who +
              format("member \"%s\" of %.4g m is deflected by %.4g m, expected less than its "
                     "length",
                     beam.name.c_str(), beam.length, bent) +
              hint,
          ErrorCode::kNoEquilibrium);
    }
  }
  if (const std::string beyond = dynamics.beyond_string(); !beyond.empty()) {
    throw ModelError("mechanism \"" + m.name + "\": in the rest pose " + beyond,
                     ErrorCode::kBeyondString);
  }
  double stored = 0.0;
  double largest = 0.0;
  std::string where;
  const auto count = [&](double energy, const auto& describe) {
    stored += energy;
    if (energy <= largest) return;
    largest = energy;
    where = describe();
  };
  for (std::size_t i = 0; i < m.contacts.size(); ++i) {
    const ContactState& s = dynamics.contacts()[i];
    const Contact& c = m.contacts[i];
    if (!s.closed) continue;
    count(c.law.static_energy(s.compression), [&] {
      return format("%s%s%s, pressed by %.4g N through %.4g m", c.name.c_str(),
                    c.label.empty() ? "" : " ", c.label.c_str(), s.law.force, s.compression);
    });
  }
  for (std::size_t i = 0; i < m.straps.size(); ++i) {
    const int strap = static_cast<int>(i);
    count(dynamics.strap_energy(strap), [&] {
      return format("strap %s, pulled by %.4g N", m.straps[i].name.c_str(),
                    dynamics.strap_force(strap));
    });
  }
  for (std::size_t i = 0; i < m.beams.size(); ++i) {
    count(dynamics.beam_energy(static_cast<int>(i), {q.data(), m.coordinates.size()}),
          [&] { return "member " + m.beams[i].name; });
  }
  // Generously: every body falls by twice the size of the mechanism, and all springs unwind.
  double mass = 0.0;
  for (const Link& link : m.links) mass += link.mass;
  const double weight = mass * norm(m.gravity) + std::fabs(rest.drive_.force);
  const double supplied = rest.start_energy + 2.0 * weight * rest.start_size;
  if (supplied > 0.0 && stored > supplied) {
    throw ModelError(
        who +
            format("it stores %.4g J in contacts, straps and members, expected at most the "
                   "%.4g J that weights and springs can supply; most in %s",
                   stored, supplied, where.c_str()) +
            hint,
        ErrorCode::kNoEquilibrium);
  }
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
  rest.keep_start({q.data(), m.coordinates.size()});
  int iteration = 0;
  bool stable = false;
  bool moved = true;
  Eigenpairs eigen;
  for (; iteration < most; ++iteration) {
    const Eigen::VectorXd force = scale.cwiseProduct(rest.force());
    if (moved) eigen = symmetric_eigenpairs(way.transpose() * rest.hessian() * way);
    const Eigen::VectorXd& values = eigen.values;
    const Eigen::VectorXd along = eigen.vectors.transpose() * (way.transpose() * rest.force());
    if (force.cwiseAbs().maxCoeff() <= enough) {
      // A body that no force moves in either direction rests where it is.
      stable = values.minCoeff() >= -1e-14 * values.cwiseAbs().maxCoeff();
      if (stable) break;
    }
    // Newton step with the eigenvalues made positive, cut to the trust region.
    const double floor = 1e-9 * std::max(1e-12, values.cwiseAbs().maxCoeff());
    Eigen::VectorXd step = along.cwiseQuotient(values.cwiseAbs().cwiseMax(floor));
    const double length = step.cwiseAbs().maxCoeff();
    // Each direction on its own: shortening all of them alike would let the softest one, which
    // wants to go far, hold up the others.
    step = step.cwiseMax(-radius).cwiseMin(radius);
    const Eigen::VectorXd dq = way * (eigen.vectors * step);
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
    text +=
        " is a body without support, or start_pose on the wrong side of a contact? (A body that is "
        "to fall or fly needs a support to rest on, or no gravity, and an initial speed.)";
    throw ModelError(text, ErrorCode::kNoEquilibrium);
  }
  refuse_nonsense(rest, q);
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
