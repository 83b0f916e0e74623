#include "feltmb/beam/hub_beam.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <numbers>
#include <string>

#include "feltmb/core/error.hpp"
#include "feltmb/numeric/eigenproblem.hpp"
#include "feltmb/numeric/quadrature.hpp"

namespace feltmb {
namespace {

using Row5 = Eigen::Matrix<double, 5, 1>;

/// Elements of each section: one each, the others where they are longest.
std::vector<int> share_out(const std::vector<ArmSection>& sections, int elements) {
  std::vector<int> count(sections.size(), 1);
  for (int left = elements - static_cast<int>(sections.size()); left > 0; --left) {
    std::size_t longest = 0;
    for (std::size_t i = 1; i < sections.size(); ++i) {
      if (sections[i].length / count[i] >
          sections[longest].length / count[longest] * (1.0 + 1e-9)) {
        longest = i;
      }
    }
    ++count[longest];
  }
  return count;
}

}  // namespace

HubBeam::HubBeam(const HubBeamDescription& description) : description_(description) {
  check();
  const int n = description_.elements;
  mass_.setZero(2 * n + 1, 2 * n + 1);
  stiffness_.setZero(2 * n + 1, 2 * n + 1);
  weight_.setZero(2 * n + 1);
  tip_.setZero(2 * n + 1);
  stations_.push_back(0.0);
  const std::vector<int> count = share_out(description_.sections, n);
  int node = 0;
  for (std::size_t i = 0; i < count.size(); ++i) {
    const ArmSection& section = description_.sections[i];
    const double length = section.length / count[i];
    for (int j = 0; j < count[i]; ++j) {
      add_element(node++, stations_.back(), length, section);
      stations_.push_back(stations_.back() + length);
    }
  }
  length_ = stations_.back();
  const double m = description_.tip_mass;
  const double r = description_.eccentricity;
  const int w = 2 * n - 1;
  const int slope = 2 * n;
  tip_[0] = reach();
  tip_[w] = 1.0;
  mass_(0, 0) += description_.hub_inertia;
  Eigen::VectorXd mover = tip_;
  if (description_.tip == TipPlacement::kAlong) {
    mover[0] += r;
    mover[slope] += r;
  } else {
    Eigen::VectorXd turn = Eigen::VectorXd::Zero(2 * n + 1);
    turn[0] = turn[slope] = r;
    mass_ += m * turn * turn.transpose();
  }
  mass_ += m * mover * mover.transpose();
  weight_ += m * tip_;
}

void HubBeam::check() const {
  std::string faults;
  const auto need = [&](bool ok, const std::string& text) {
    if (!ok) faults += "\n  " + text;
  };
  const auto& d = description_;
  const auto positive = [](double v) { return std::isfinite(v) && v > 0.0; };
  const auto not_negative = [](double v) { return std::isfinite(v) && v >= 0.0; };
  need(not_negative(d.hub_radius), format("hub_radius = %.6g m, must be >= 0", d.hub_radius));
  need(positive(d.hub_inertia), format("hub_inertia = %.6g kg m^2, must be > 0", d.hub_inertia));
  need(not_negative(d.tip_mass), format("tip_mass = %.6g kg, must be >= 0", d.tip_mass));
  need(not_negative(d.eccentricity), format("eccentricity = %.6g m, must be >= 0", d.eccentricity));
  need(!d.sections.empty(), "sections: the arm has none");
  const auto least = static_cast<int>(std::max<std::size_t>(1, d.sections.size()));
  need(d.elements >= least && d.elements <= 200,
       format("elements = %d, must be %d (one a section) to 200", d.elements, least));
  for (std::size_t i = 0; i < d.sections.size(); ++i) {
    const ArmSection& s = d.sections[i];
    const auto where = [&](const char* name, double v, const char* unit) {
      need(positive(v), format("section %zu: %s = %.6g %s, must be > 0", i + 1, name, v, unit));
    };
    where("length", s.length, "m");
    where("density", s.density, "kg/m^3");
    where("area", s.area, "m^2");
    where("young_modulus", s.young_modulus, "Pa");
    where("second_moment", s.second_moment, "m^4");
  }
  if (!faults.empty()) throw InvalidParameter("actuator arm:" + faults);
}

void HubBeam::add_element(int node, double x, double length, const ArmSection& section) {
  // q of the element: theta, w and slope of its two nodes; those of node 0 are held.
  std::array<int, 5> index{0, 2 * node - 1, 2 * node, 2 * node + 1, 2 * node + 2};
  if (node == 0) index[1] = index[2] = -1;
  Eigen::Matrix<double, 5, 5> m = Eigen::Matrix<double, 5, 5>::Zero();
  Eigen::Matrix<double, 5, 5> k = Eigen::Matrix<double, 5, 5>::Zero();
  Row5 g = Row5::Zero();
  const bool printed = description_.printed_shapes;
  // Degree 6 in s: four Gauss points are exact.
  static const QuadratureRule& rule = *new QuadratureRule(make_gauss_legendre(4));
  for (std::size_t i = 0; i < rule.nodes.size(); ++i) {
    const double s = 0.5 * (1.0 + rule.nodes[i]);
    const double dx = 0.5 * rule.weights[i] * length;
    const double s2 = s * s;
    const double s3 = s2 * s;
    const double first = 1.0 - 3.0 * s2 + 2.0 * s3;
    Row5 eta;
    eta << description_.hub_radius + x + s * length, first,
        printed ? length * first : length * (s - 2.0 * s2 + s3), 3.0 * s2 - 2.0 * s3,
        length * (s3 - s2);
    Row5 bend;
    bend << 0.0, -6.0 + 12.0 * s, length * (printed ? -6.0 + 12.0 * s : -4.0 + 6.0 * s),
        6.0 - 12.0 * s, length * (6.0 * s - 2.0);
    bend /= length * length;
    m += (section.density * section.area * dx) * eta * eta.transpose();
    k += (section.young_modulus * section.second_moment * dx) * bend * bend.transpose();
    g += (section.density * section.area * dx) * eta;
  }
  for (int i = 0; i < 5; ++i) {
    if (index[static_cast<std::size_t>(i)] < 0) continue;
    const int row = index[static_cast<std::size_t>(i)];
    weight_[row] += g[i];
    for (int j = 0; j < 5; ++j) {
      const int column = index[static_cast<std::size_t>(j)];
      if (column < 0) continue;
      mass_(row, column) += m(i, j);
      stiffness_(row, column) += k(i, j);
    }
  }
}

HubBeamModes HubBeam::modes(double tip_mass) const {
  if (!(std::isfinite(tip_mass) && tip_mass >= 0.0)) {
    throw InvalidParameter(format("actuator arm: tip_mass = %.6g kg, must be >= 0", tip_mass));
  }
  const Eigen::MatrixXd mass = mass_ + tip_mass * tip_ * tip_.transpose();
  const Eigenpairs solution = symmetric_eigenpairs(stiffness_, mass);
  if (!solution.found)
    throw Error("actuator arm: its modes were not found", ErrorCode::kNotConverged);
  HubBeamModes out;
  out.stiffness = solution.values.cwiseMax(0.0);
  out.shapes = solution.vectors;
  // Rounding of the largest frequency, 1e14 1/s^2, would give the rigid mode one of its own.
  out.stiffness[0] = 0.0;
  out.shapes.col(0).setZero();
  out.shapes(0, 0) = 1.0 / std::sqrt(mass(0, 0));
  return out;
}

Eigen::VectorXd HubBeam::frequencies(int count, bool clamped) const {
  const int free = size() - 1;
  if (count < 1 || count > free) {
    throw InvalidParameter(format("frequencies: count = %d, must be 1 to %d", count, free));
  }
  // The elastic coordinates alone: K_ee is regular; a free hub follows, M_ee - M_et M_tt^-1 M_te.
  Eigen::MatrixXd mass = mass_.bottomRightCorner(free, free);
  if (!clamped) {
    const Eigen::VectorXd coupling = mass_.col(0).tail(free);
    mass -= coupling * coupling.transpose() / mass_(0, 0);
  }
  const Eigenpairs solution = symmetric_eigenpairs(mass, stiffness_.bottomRightCorner(free, free));
  if (!solution.found)
    throw Error("actuator arm: its frequencies were not found", ErrorCode::kNotConverged);
  Eigen::VectorXd out(count);
  for (int i = 0; i < count; ++i) {
    out[i] = 1.0 / (2.0 * std::numbers::pi * std::sqrt(solution.values[free - 1 - i]));
  }
  return out;
}

}  // namespace feltmb
