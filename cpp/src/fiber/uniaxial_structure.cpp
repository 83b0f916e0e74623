#include <algorithm>
#include <cmath>
#include <vector>

#include "feltmb/fiber/faults.hpp"
#include "feltmb/fiber/orientation.hpp"
#include "feltmb/numeric/constants.hpp"
#include "feltmb/numeric/elliptic.hpp"
#include "feltmb/numeric/quadrature.hpp"

namespace feltmb {
namespace {

/// In-plane moments int_0^{pi/2} q(p) (1 + m cos^2 p)^(-3/2) dp for q = cos^2, sin^2, cos^4, cos^6.
struct CircleMoments {
  double c2, s2, c4, c6;
};

CircleMoments circle_moments(double m) {
  CircleMoments result{};
  result.c2 = carlson_rd(0.0, 1.0, 1.0 + m) / 3.0;
  result.s2 = carlson_rd(0.0, 1.0 + m, 1.0) / 3.0;
  if (m > 3.0) {
    const double p = m / (1.0 + m);
    const double first = carlson_rf(0.0, 1.0, 1.0 + m);
    const double second = std::sqrt(1.0 + m) *
                          (carlson_rf(0.0, 1.0 - p, 1.0) - p / 3.0 * carlson_rd(0.0, 1.0 - p, 1.0));
    const double d2 = (second - first) / m;
    const double d4 = (first + 2.0 * (m - 1.0) * d2) / (3.0 * m);
    result.c4 = (d2 - result.c2) / m;
    result.c6 = (d4 - result.c4) / m;
    return result;
  }
  // The periodic midpoint rule converges geometrically; the rate depends on how near 1 + m is to 0.
  const std::size_t n =
      m > -0.75
          ? 48
          : 48 * static_cast<std::size_t>(std::ceil(1.0 / std::sqrt(std::max(1.0 + m, 1e-8))));
  const double step = 0.5 * kPi / static_cast<double>(n);
  for (std::size_t i = 0; i < n; ++i) {
    const double c = std::cos(step * (static_cast<double>(i) + 0.5));
    const double square = c * c;
    const double root = 1.0 + m * square;
    const double value = step * square * square / (root * std::sqrt(root));
    result.c4 += value;
    result.c6 += square * value;
  }
  return result;
}

/// Fiber averages of cos^2 and cos^4 for the affine density (elementary integrals).
struct CosineMoments {
  double c2, c4;
};

CosineMoments cosine_moments(double ratio) {
  const double k = (ratio - 1.0) * (ratio + 1.0);
  if (std::abs(k) < 0.05) {
    // Binomial series of (1 + k c^2)^(-3/2), integrated term by term.
    double coefficient = 1.0;
    double c2 = 0.0;
    double c4 = 0.0;
    for (int j = 0; j < 24; ++j) {
      c2 += coefficient / (2.0 * j + 3.0);
      c4 += coefficient / (2.0 * j + 5.0);
      coefficient *= -k * (1.5 + j) / (j + 1.0);
    }
    return {ratio * c2, ratio * c4};
  }
  const double root = std::sqrt(std::abs(k));
  const double h0 = k > 0.0 ? std::asinh(root) / root : std::asin(root) / root;
  const double i2 = (h0 - 1.0 / ratio) / k;
  const double h2 = (ratio - h0) / (2.0 * k);
  return {ratio * i2, ratio * (h2 - i2) / k};
}

/// J and Theta at polar angle theta: one integral over the planes through the fiber.
struct PlaneMeans {
  double sine, inverse_sine;
};

PlaneMeans plane_means(double ratio, double cos_theta) {
  const double k = (ratio - 1.0) * (ratio + 1.0);
  const double c_square = cos_theta * cos_theta;
  const double s_square = (1.0 - std::abs(cos_theta)) * (1.0 + std::abs(cos_theta));
  PlaneMeans means{0.0, 0.0};
  const auto integrand = [&](double x, double weight) {
    const double sine = std::sin(x);
    const double a_square = c_square + s_square * sine * sine;
    const double m = k * a_square;
    const double c2 = ratio / kPi * carlson_rd(0.0, 1.0, 1.0 + m) / 3.0;
    const double s2 = ratio / kPi * carlson_rd(0.0, 1.0 + m, 1.0) / 3.0;
    const double share = a_square > 0.0 ? c_square / a_square : 0.0;
    means.sine += weight * (share * s2 + (1.0 - share) * c2);
    means.inverse_sine += weight * (c2 + s2);
  };
  const auto graded = [&](double scale, double length, bool from_end) {
    const double range = std::asinh(length / scale);
    const auto panels = static_cast<std::size_t>(std::ceil(1.5 * range)) + 1;
    const QuadratureRule& rule = gauss16();
    for (std::size_t panel = 0; panel < panels; ++panel) {
      const double width = range / static_cast<double>(panels);
      const double center = width * (static_cast<double>(panel) + 0.5);
      for (std::size_t i = 0; i < rule.nodes.size(); ++i) {
        const double t = center + 0.5 * width * rule.nodes[i];
        const double x = scale * std::sinh(t);
        // Both halves of the full turn are alike, hence the factor 2.
        integrand(from_end ? 0.5 * kPi - x : x,
                  2.0 * 0.5 * width * rule.weights[i] * scale * std::cosh(t));
      }
    }
  };
  const double near = std::abs(cos_theta) + 1.0 / ratio;
  const double scale = std::clamp(near, 1e-8, 1.0);
  const double far_scale = std::clamp(std::sqrt(s_square) + ratio, 1e-8, 1.0);
  graded(scale, 0.25 * kPi, false);
  graded(far_scale, 0.25 * kPi, true);
  return means;
}

/// Density psi in the variable g = |cos| before deformation: cos = g / sqrt(R^2 (1 - g^2) + g^2).
double deformed_cosine(double ratio, double g) {
  return g / std::sqrt(ratio * ratio * (1.0 - g) * (1.0 + g) + g * g);
}

class StructureTable {
 public:
  StructureTable() {
    for (int panel = 0; panel < kPanels; ++panel) {
      const double left = std::log(kLow) + panel * width();
      std::array<std::array<double, kFields>, kNodes> values{};
      for (int node = 0; node < kNodes; ++node) {
        const double x = std::cos(kPi * (node + 0.5) / kNodes);
        const UniaxialStructure s =
            compute_uniaxial_structure(std::exp(left + 0.5 * width() * (x + 1.0)));
        values[static_cast<std::size_t>(node)] = {s.f, s.n3, std::log(s.e3), s.sine};
      }
      for (int field = 0; field < kFields; ++field) {
        for (int j = 0; j < kNodes; ++j) {
          double sum = 0.0;
          for (int node = 0; node < kNodes; ++node) {
            sum += values[static_cast<std::size_t>(node)][static_cast<std::size_t>(field)] *
                   std::cos(kPi * j * (node + 0.5) / kNodes);
          }
          coefficient(panel, field, j) = sum * (j == 0 ? 1.0 : 2.0) / kNodes;
        }
      }
    }
  }

  [[nodiscard]] UniaxialStructure evaluate(double ratio) const {
    const double position = (std::log(ratio) - std::log(kLow)) / width();
    const int panel = std::clamp(static_cast<int>(position), 0, kPanels - 1);
    const double x = 2.0 * (position - panel) - 1.0;
    std::array<double, kFields> value{};
    for (int field = 0; field < kFields; ++field) {
      double b1 = 0.0;
      double b2 = 0.0;
      for (int j = kNodes - 1; j > 0; --j) {
        const double b0 = 2.0 * x * b1 - b2 + coefficient(panel, field, j);
        b2 = b1;
        b1 = b0;
      }
      value[static_cast<std::size_t>(field)] = x * b1 - b2 + coefficient(panel, field, 0);
    }
    const CosineMoments moments = cosine_moments(ratio);
    return {
        ratio,      value[0], value[1], std::exp(value[2]), 1.0 / (1.0 + ratio), 1.0 - moments.c2,
        moments.c4, value[3]};
  }

  static constexpr double kLow = 1e-2;
  static constexpr double kHigh = 1e4;

 private:
  static constexpr int kPanels = 14;
  static constexpr int kNodes = 20;
  static constexpr int kFields = 4;
  static double width() { return (std::log(kHigh) - std::log(kLow)) / kPanels; }
  double& coefficient(int panel, int field, int j) {
    return data_[static_cast<std::size_t>((panel * kFields + field) * kNodes + j)];
  }
  [[nodiscard]] double coefficient(int panel, int field, int j) const {
    return data_[static_cast<std::size_t>((panel * kFields + field) * kNodes + j)];
  }
  std::array<double, static_cast<std::size_t>(kPanels * kFields * kNodes)> data_{};
};

void check_ratio(double ratio) {
  Faults faults("structure");
  faults.within("ratio", ratio, 1e-3, 1e6, "", "R = v_f / v_random; 1 is isotropic");
  faults.raise_if_any();
}

}  // namespace

UniaxialStructure compute_uniaxial_structure(double ratio) {
  check_ratio(ratio);
  const double k = (ratio - 1.0) * (ratio + 1.0);
  double f = 0.0;
  double normal = 0.0;
  double axis = 0.0;
  const auto accumulate = [&](double m, double x_square, double weight) {
    const CircleMoments moments = circle_moments(m);
    const double s_square = 1.0 - x_square;
    f += weight * moments.c2 * moments.s2;
    normal += weight * moments.c2 * moments.s2 * x_square * x_square;
    axis += weight * 0.5 * s_square * s_square *
            ((moments.c4 - moments.c6) * moments.c2 + moments.c6 * moments.s2);
  };
  const double scale = std::min(ratio, 1.0 / ratio);
  // Places u = scale sinh(t) in 0..1 crowd toward 0, where the integrand peaks.
  const double range = std::asinh(1.0 / scale);
  const auto panels = static_cast<std::size_t>(std::ceil(2.0 * range)) + 1;
  const double width = range / static_cast<double>(panels);
  const QuadratureRule& rule = gauss16();
  for (std::size_t panel = 0; panel < panels; ++panel) {
    for (std::size_t i = 0; i < rule.nodes.size(); ++i) {
      const double t = width * (static_cast<double>(panel) + 0.5 * (1.0 + rule.nodes[i]));
      const double u = std::min(1.0, scale * std::sinh(t));
      const double du = 0.5 * width * rule.weights[i] * scale * std::cosh(t);
      if (ratio >= 1.0) {
        // u: cosine of the plane's normal before deformation.
        const double d = (1.0 - u) * (1.0 + u) + ratio * ratio * u * u;
        accumulate(k * (1.0 - u) * (1.0 + u) / d, ratio * ratio * u * u / d,
                   du * ratio / (d * std::sqrt(d)));
      } else {
        accumulate(k * (1.0 - u) * (1.0 + u), u * u, du);
      }
    }
  }
  const double factor = 4.0 * ratio * ratio / kPi;
  const CosineMoments cosines = cosine_moments(ratio);
  UniaxialStructure result{};
  result.ratio = ratio;
  result.f = factor * f;
  result.n3 = normal / f;
  result.e3 = axis / f;
  result.K3 = 1.0 / (1.0 + ratio);
  result.M3 = 1.0 - cosines.c2;
  result.cos4 = cosines.c4;
  result.sine = ratio * carlson_rd(0.0, ratio * ratio, 1.0) / 3.0;
  return result;
}

double uniaxial_obstruction(double ratio) {
  check_ratio(ratio);
  // Fiber average over g, uniform before deformation; J and Theta bend where cos ~ 1/R.
  const auto product = [&](double g) {
    const PlaneMeans means = plane_means(ratio, deformed_cosine(ratio, g));
    return means.sine * means.inverse_sine;
  };
  const double end = std::min(0.5, 1.0 / ratio);
  const double start = std::min(0.5, ratio);
  const auto lower = [&](double t) {
    const double g = start * std::sinh(t);
    return product(g) * start * std::cosh(t);
  };
  const auto upper = [&](double t) {
    const double h = end * end * std::expm1(t);
    return product(1.0 - h) * end * end * std::exp(t);
  };
  const double lower_range = std::asinh(0.5 / start);
  const double upper_range = std::log1p(0.5 / (end * end));
  return integrate_composite(lower, 0.0, lower_range,
                             static_cast<std::size_t>(std::ceil(1.0 * lower_range)) + 1) +
         integrate_composite(upper, 0.0, upper_range,
                             static_cast<std::size_t>(std::ceil(0.7 * upper_range)) + 1);
}

UniaxialStructure uniaxial_structure(double ratio) {
  if (!(ratio >= StructureTable::kLow && ratio <= StructureTable::kHigh)) {
    return compute_uniaxial_structure(ratio);
  }
  static const StructureTable& table = *new StructureTable;
  return table.evaluate(ratio);
}

double uniaxial_density(double ratio, double cos_theta) {
  check_ratio(ratio);
  const double square = cos_theta * cos_theta;
  const double root = (1.0 - square) + ratio * ratio * square;
  return ratio / (2.0 * kPi * root * std::sqrt(root));
}

double uniaxial_mean_sine(double ratio, double cos_theta) {
  check_ratio(ratio);
  return plane_means(ratio, cos_theta).sine;
}

double uniaxial_mean_inverse_sine(double ratio, double cos_theta) {
  check_ratio(ratio);
  return plane_means(ratio, cos_theta).inverse_sine;
}

}  // namespace feltmb
