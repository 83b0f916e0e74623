// Orders of the BDF and lightly damped modes: growth against the roots of the formulas, modes
// against those of a cantilever.
#include <doctest/doctest.h>

#include <Eigen/Dense>
#include <cmath>
#include <complex>
#include <vector>

#include "feltmb/model/bdf_order.hpp"

namespace {

using namespace feltmb;
using doctest::Approx;

/// Largest root of the BDF's polynomial for y' = i y, or another rate, and the step h, from its
/// coefficients.
double largest_root(const std::vector<double>& alpha, double beta, double h,
                    std::complex<double> rate = {0.0, 1.0}) {
  const auto k = static_cast<Eigen::Index>(alpha.size()) - 1;
  Eigen::MatrixXcd companion = Eigen::MatrixXcd::Zero(k, k);
  const std::complex<double> lead = alpha[0] - beta * h * rate;
  for (Eigen::Index i = 0; i < k; ++i) {
    companion(0, i) = -alpha[static_cast<std::size_t>(i) + 1] / lead;
    if (i > 0) companion(i, i - 1) = 1.0;
  }
  return companion.eigenvalues().cwiseAbs().maxCoeff();
}

// E. Hairer, S. P. Norsett, G. Wanner, Solving Ordinary Differential Equations I, section III.1.
const std::vector<std::vector<double>> kFormulas = {
    {1.0, -1.0},
    {3.0 / 2, -2.0, 1.0 / 2},
    {11.0 / 6, -3.0, 3.0 / 2, -1.0 / 3},
    {25.0 / 12, -4.0, 3.0, -4.0 / 3, 1.0 / 4},
    {137.0 / 60, -5.0, 5.0, -10.0 / 3, 5.0 / 4, -1.0 / 5}};

TEST_CASE("growth of an undamped mode is that of the formulas' largest root") {
  for (int order = 1; order <= 5; ++order) {
    for (double h : {0.1, 0.3, 0.6}) {
      const double root = largest_root(kFormulas[static_cast<std::size_t>(order) - 1], 1.0, h);
      CHECK(growth_per_radian(order, h) == Approx(std::log(root) / h).epsilon(1e-6));
    }
    // However short the step: 3 and 4 let it grow, the others damp it.
    for (double h : {0.05, 0.1, 0.3}) {
      CHECK((growth_per_radian(order, h) > 0.0) == (order == 3 || order == 4));
    }
  }
  CHECK(growth_per_radian(3, 0.05) == Approx(std::pow(0.05, 3) / 4).epsilon(0.01));
  CHECK(growth_per_radian(4, 0.1) == Approx(std::pow(0.1, 5) / 3).epsilon(0.02));
}

TEST_CASE("order 5 is stable up to its border and not beyond") {
  for (const double damping : {0.0, 0.01, 0.07, 0.3}) {
    const std::complex<double> rate{-damping, std::sqrt(1.0 - damping * damping)};
    const double border = border_of_stability(damping);
    for (double h = 0.05; h < 0.99 * border; h += 0.05) {
      CHECK(largest_root(kFormulas[4], 1.0, h, rate) < 1.0);
    }
    CHECK(largest_root(kFormulas[4], 1.0, 1.01 * border, rate) > 1.0);
  }
  CHECK(std::isinf(border_of_stability(0.7)));
}

TEST_CASE("orders 3 and 4 only where no mode grows") {
  const std::vector<FreeMode> fast{{1e5, 0.0}};
  const std::vector<FreeMode> slow{{5.0, 0.0}};
  const std::vector<FreeMode> damped{{1e5, 0.05}};
  for (const int order : {1, 2, 5}) CHECK(order_without_growth(order, fast, 1e-5, 1.0) == order);
  for (const int order : {3, 4}) {
    CHECK(order_without_growth(order, fast, 1e-5, 1.0) == 2);
    CHECK(order_without_growth(order, slow, 1e-5, 1.0) == order);
    CHECK(order_without_growth(order, damped, 1e-5, 1.0) == order);
    CHECK(order_without_growth(order, {}, 1e-5, 1.0) == order);
  }
  // Short runs, tight tolerances: there is no time to grow.
  CHECK(order_without_growth(4, fast, 1e-5, 1e-3) == 4);
  CHECK(order_without_growth(4, fast, 1e-12, 1.0) == 4);
}

MechanismDescription cantilever(double damping_time) {
  MechanismDescription d;
  d.name = "cantilever";
  BodyDescription base;
  base.name = "base";
  base.parent = "ground";
  base.joint = JointKind::kPrismatic;
  base.coordinate = "base.x";
  base.axis = {1.0, 0.0};
  base.mass = 1e6;
  d.bodies.push_back(base);
  BodyDescription rod;
  rod.name = "rod";
  rod.parent = "base";
  rod.joint = JointKind::kWeld;
  BeamDescription beam;
  beam.length = 0.2;
  beam.linear_density = 0.05;
  beam.axial_stiffness = 1e6;
  beam.bending_stiffness = 0.4;
  beam.damping_time = damping_time;
  beam.shapes = ShapeSet::kClampedFree;
  beam.axial_shapes = 1;
  beam.lateral_shapes = 3;
  rod.beam = beam;
  d.bodies.push_back(rod);
  d.gravity = {0.0, 0.0};
  return d;
}

TEST_CASE("modes of a cantilever") {
  constexpr double damping_time = 1e-5;
  const auto mechanism = assemble(cantilever(damping_time));
  const std::vector<double> pose(static_cast<std::size_t>(mechanism->size()), 0.0);
  const std::vector<FreeMode> modes = free_modes(mechanism, pose);
  const double unit = std::sqrt(0.4 / 0.05) / (0.2 * 0.2);
  REQUIRE(modes.size() >= 3);
  const std::size_t first = modes.size() - 3;
  const double roots[] = {1.8751040687, 4.6940911330, 7.8547574382};
  for (std::size_t k = 0; k < 3; ++k) {
    const double exact = roots[k] * roots[k] * unit;
    CHECK(modes[first + k].rate == Approx(exact).epsilon(1e-6));
    CHECK(modes[first + k].damping == Approx(0.5 * damping_time * exact).epsilon(1e-6));
  }
  // The base drifts and the axial coordinate is condensed: neither swings.
  for (std::size_t k = 0; k < first; ++k) CHECK(modes[k].rate < 1.0);
}

}  // namespace
