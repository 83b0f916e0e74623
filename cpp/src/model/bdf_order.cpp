#include "feltmb/model/bdf_order.hpp"

#include <algorithm>
#include <cmath>
#include <complex>
#include <limits>
#include <numbers>

#include "feltmb/core/index.hpp"
#include "feltmb/numeric/eigenproblem.hpp"
#include "feltmb/planar/dynamics.hpp"

namespace feltmb {
namespace {

/// Coordinates that a simulation integrates.
std::vector<int> moving_coordinates(const Mechanism& m) {
  std::vector<bool> held(as_index(m.size()), false);
  for (const FlexibleBeam& beam : m.beams) {
    for (int k = 0; beam.condense_axial && k < beam.shapes.axial(); ++k) {
      held[as_index(beam.first + k)] = true;
    }
  }
  std::vector<int> out;
  for (int k = 0; k < m.size(); ++k) {
    if (!held[as_index(k)]) out.push_back(k);
  }
  return out;
}

/// h omega at which one step of an undamped mode has the relative error rtol: the local error of
/// the BDF of order k is (h omega)^(k + 1) / ((k + 1) (1 + 1/2 + ... + 1/k)).
double step_of_error(int order, double rtol) {
  double sum = 0.0;
  for (int j = 1; j <= order; ++j) sum += 1.0 / j;
  return std::pow(rtol * (order + 1) * sum, 1.0 / (order + 1));
}

}  // namespace

double border_of_stability(double damping) {
  // The boundary of the region, z = sum over j <= 5 of (1 - exp(-i theta))^j / j, crosses the ray
  // of the mode.
  constexpr double step = 1e-3;
  for (double theta = 0.05; theta < std::numbers::pi; theta += step) {
    const std::complex<double> w = 1.0 - std::exp(std::complex<double>{0.0, -theta});
    std::complex<double> power = 1.0;
    std::complex<double> z = 0.0;
    for (int j = 1; j <= 5; ++j) {
      power *= w;
      z += power / static_cast<double>(j);
    }
    if (-z.real() > damping * std::abs(z)) return std::abs(z);
  }
  return std::numeric_limits<double>::infinity();
}

double stable_step(const Mechanism& mechanism, const std::vector<FreeMode>& modes) {
  double out = std::numeric_limits<double>::infinity();
  const auto hold = [&](const FreeMode& mode) {
    out = std::min(out, border_of_stability(mode.damping) / mode.rate);
  };
  std::for_each(modes.begin(), modes.end(), hold);
  for (const AttachedString& s : mechanism.strings) {
    const std::span<const double> rates = s.string.angular_frequency();
    if (!rates.empty()) hold({rates.back(), s.string.parameters().damping_ratio});
  }
  return out;
}

std::vector<FreeMode> free_modes(const std::shared_ptr<const Mechanism>& mechanism,
                                 std::span<const double> pose) {
  const Mechanism& m = *mechanism;
  Dynamics dynamics(mechanism);
  const std::vector<double> zero(as_index(m.size()), 0.0);
  const std::vector<double> law(as_index(m.total_law_states), 0.0);
  const std::vector<double> eta(as_index(m.total_modes), 0.0);
  dynamics.evaluate({pose.first(zero.size()), zero, law, eta, eta}, Drive{});
  dynamics.differentiate();
  Eigen::MatrixXd damping = Eigen::MatrixXd::Zero(m.size(), m.size());
  for (const FlexibleBeam& beam : m.beams) {
    damping.block(beam.first, beam.first, beam.count, beam.count) =
        beam.damping_time * beam.stiffness;
  }
  const std::vector<int> moving = moving_coordinates(m);
  if (moving.empty()) return {};
  const Eigen::MatrixXd stiffness =
      -0.5 * (dynamics.stiffness() + dynamics.stiffness().transpose())(moving, moving);
  const Eigen::MatrixXd mass = dynamics.mass_matrix()(moving, moving);
  const Eigenpairs eigen = symmetric_eigenpairs(stiffness, mass);
  std::vector<FreeMode> out;
  for (Eigen::Index i = 0; i < eigen.values.size(); ++i) {
    const double square = eigen.values[i];
    if (!(square > 0.0)) continue;  // falls or drifts, does not swing
    const Eigen::VectorXd shape = eigen.vectors.col(i);
    const double rate = std::sqrt(square);
    out.push_back({rate, 0.5 * shape.dot(damping(moving, moving) * shape) / rate});
  }
  return out;
}

int order_of_strings(const Mechanism& mechanism) {
  double smallest = 1.0;
  for (const AttachedString& s : mechanism.strings) {
    smallest = std::min(smallest, s.string.parameters().damping_ratio);
  }
  if (smallest >= 0.618) return 5;
  if (smallest >= 0.287) return 4;
  return smallest >= 0.0692 ? 3 : 2;
}

double growth_per_radian(int order, double step) {
  // The root x of sum over j <= k of (1 - 1/x)^j / j = i h omega that begins at exp(i h omega).
  const std::complex<double> target{0.0, step};
  std::complex<double> x = std::exp(target);
  for (int iteration = 0; iteration < 20; ++iteration) {
    const std::complex<double> w = 1.0 - 1.0 / x;
    std::complex<double> power = 1.0;
    std::complex<double> slope = 0.0;
    std::complex<double> value = -target;
    for (int j = 1; j <= order; ++j) {
      slope += power;
      power *= w;
      value += power / static_cast<double>(j);
    }
    const std::complex<double> change = value * x * x / slope;
    x -= change;
    if (std::abs(change) < 1e-15) break;
  }
  return std::log(std::abs(x)) / step;
}

int order_without_growth(int order, const std::vector<FreeMode>& modes, double rtol,
                         double duration) {
  constexpr double most = 1.0;  // e-folds; more would be seen in the ledger
  for (; order == 3 || order == 4; --order) {
    const double growth = growth_per_radian(order, step_of_error(order, rtol));
    if (std::all_of(modes.begin(), modes.end(), [&](const FreeMode& mode) {
          return (growth - mode.damping) * mode.rate * duration <= most;
        })) {
      break;
    }
  }
  return order;
}

}  // namespace feltmb
