#include "feltmb/fiber/orientation.hpp"

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <limits>
#include <numbers>

#include "feltmb/fiber/faults.hpp"
#include "feltmb/numeric/elliptic.hpp"
#include "feltmb/numeric/floor_within.hpp"
#include "feltmb/numeric/parallel.hpp"
#include "feltmb/numeric/quadrature.hpp"
#include "feltmb/numeric/random.hpp"

namespace feltmb {
namespace {

constexpr double kPi = std::numbers::pi;

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

/// The 15 different components of a symmetric rank four tensor, by exponents (a, b, c), a+b+c=4.
struct SymmetricTensor4 {
  std::array<double, 15> value{};
  static constexpr std::size_t index(int a, int b) {
    // Rows of constant a = 4, 3, ..., 0 hold 1, 2, ..., 5 entries.
    const int row = 4 - a;
    return static_cast<std::size_t>(row * (row + 1) / 2 + (row - b));
  }
  void add(const Eigen::Vector3d& e, double weight) {
    std::size_t position = 0;
    const double x[5] = {1.0, e[0], e[0] * e[0], e[0] * e[0] * e[0], e[0] * e[0] * e[0] * e[0]};
    const double y[5] = {1.0, e[1], e[1] * e[1], e[1] * e[1] * e[1], e[1] * e[1] * e[1] * e[1]};
    const double z[5] = {1.0, e[2], e[2] * e[2], e[2] * e[2] * e[2], e[2] * e[2] * e[2] * e[2]};
    for (int a = 4; a >= 0; --a) {
      for (int b = 4 - a; b >= 0; --b) value[position++] += weight * x[a] * y[b] * z[4 - a - b];
    }
  }
  void scale(double factor) {
    for (double& v : value) v *= factor;
  }
  void add(const SymmetricTensor4& other, double weight) {
    for (std::size_t i = 0; i < value.size(); ++i) value[i] += weight * other.value[i];
  }
  [[nodiscard]] Tensor4 full() const {
    Tensor4 t{};
    for (int i = 0; i < 81; ++i) {
      const int digits[4] = {i / 27, (i / 9) % 3, (i / 3) % 3, i % 3};
      int a = 0;
      int b = 0;
      for (int digit : digits) {
        a += digit == 0;
        b += digit == 1;
      }
      t[static_cast<std::size_t>(i)] = value[index(a, b)];
    }
    return t;
  }
};

/// Two unit vectors orthogonal to n and to each other.
void make_plane_basis(const Eigen::Vector3d& n, Eigen::Vector3d& p, Eigen::Vector3d& q) {
  const Eigen::Vector3d helper =
      std::abs(n[2]) < 0.9 ? Eigen::Vector3d::UnitZ() : Eigen::Vector3d::UnitX();
  p = n.cross(helper).normalized();
  q = n.cross(p);
}

Eigen::Vector3d spherical(double cosine, double azimuth) {
  const double sine = std::sqrt((1.0 - cosine) * (1.0 + cosine));
  return {sine * std::cos(azimuth), sine * std::sin(azimuth), cosine};
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
  static const StructureTable table;
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

OrientationQuadrature::OrientationQuadrature(std::size_t n_polar, std::size_t n_azimuth,
                                             std::size_t n_circle, bool obstruction)
    : n_polar_(n_polar), n_azimuth_(n_azimuth), n_circle_(n_circle), obstruction_(obstruction) {
  Faults faults("orientation quadrature");
  faults.within("n_polar", static_cast<double>(n_polar), 2, 512, "");
  faults.within("n_azimuth", static_cast<double>(n_azimuth), 4, 2048, "");
  faults.within("n_circle", static_cast<double>(n_circle), 4, 4096, "");
  if (n_azimuth % 2 != 0) {
    faults.add("n_azimuth", static_cast<double>(n_azimuth), "", "even");
  }
  faults.raise_if_any();
  const QuadratureRule rule = make_gauss_legendre(n_polar);
  for (std::size_t i = 0; i < n_polar; ++i) {
    polar_nodes_.push_back(0.5 * (1.0 + rule.nodes[i]));
    polar_weights_.push_back(0.5 * rule.weights[i]);
  }
}

std::size_t OrientationQuadrature::size() const {
  const std::size_t sphere = n_polar_ * n_azimuth_;
  return sphere * (1 + n_circle_ + (obstruction_ ? n_azimuth_ / 2 * n_circle_ : 0));
}

Directions OrientationQuadrature::directions() const {
  Directions result(static_cast<Eigen::Index>(size()), 3);
  Eigen::Index row = 0;
  const double step = 2.0 * kPi / static_cast<double>(n_azimuth_);
  const double circle_step = kPi / static_cast<double>(n_circle_);
  const auto add_circle = [&](const Eigen::Vector3d& p, const Eigen::Vector3d& q) {
    for (std::size_t c = 0; c < n_circle_; ++c) {
      const double angle = circle_step * (static_cast<double>(c) + 0.5);
      result.row(row++) = (std::cos(angle) * p + std::sin(angle) * q).transpose();
    }
  };
  for (double node : polar_nodes_) {
    for (std::size_t a = 0; a < n_azimuth_; ++a) {
      result.row(row++) = spherical(node, step * (static_cast<double>(a) + 0.5)).transpose();
    }
  }
  Eigen::Vector3d p;
  Eigen::Vector3d q;
  for (double node : polar_nodes_) {
    for (std::size_t a = 0; a < n_azimuth_; ++a) {
      make_plane_basis(spherical(node, step * (static_cast<double>(a) + 0.5)), p, q);
      add_circle(p, q);
    }
  }
  if (obstruction_) {
    for (double node : polar_nodes_) {
      for (std::size_t a = 0; a < n_azimuth_; ++a) {
        const Eigen::Vector3d e = spherical(node, step * (static_cast<double>(a) + 0.5));
        make_plane_basis(e, p, q);
        for (std::size_t b = 0; b < n_azimuth_ / 2; ++b) {
          const double angle = step * (static_cast<double>(b) + 0.5);
          add_circle(e, std::cos(angle) * p + std::sin(angle) * q);
        }
      }
    }
  }
  return result;
}

double OrientationQuadrature::norm(std::span<const double> density) const {
  if (density.size() != size()) {
    throw InvalidParameter(
        format("orientation density: %zu values, expected %zu (one per row of "
               "directions())",
               density.size(), size()));
  }
  // Half sphere of nodes, the other half is its mirror image.
  double sum = 0.0;
  for (std::size_t i = 0; i < n_polar_; ++i) {
    for (std::size_t a = 0; a < n_azimuth_; ++a) {
      sum += polar_weights_[i] * density[i * n_azimuth_ + a];
    }
  }
  return sum * 4.0 * kPi / static_cast<double>(n_azimuth_);
}

FiberStructure OrientationQuadrature::compute(std::span<const double> density) const {
  const double total = norm(density);
  for (double value : density) {
    if (!(value >= 0.0) || !std::isfinite(value)) {
      throw InvalidParameter(
          format("orientation density: value %.6g 1/sr, must be finite and >= 0", value));
    }
  }
  if (!(total > 0.0)) {
    throw InvalidParameter("orientation density: integral is 0, must be > 0");
  }
  FiberStructure result;
  const double azimuth_step = 2.0 * kPi / static_cast<double>(n_azimuth_);
  const double circle_step = 2.0 * kPi / static_cast<double>(n_circle_);
  SymmetricTensor4 fiber4;
  SymmetricTensor4 normal4;
  SymmetricTensor4 axis4;
  SymmetricTensor4 transverse4;
  for (std::size_t i = 0; i < n_polar_; ++i) {
    for (std::size_t a = 0; a < n_azimuth_; ++a) {
      const double weight =
          2.0 * azimuth_step * polar_weights_[i] * density[i * n_azimuth_ + a] / total;
      const Eigen::Vector3d e =
          spherical(polar_nodes_[i], azimuth_step * (static_cast<double>(a) + 0.5));
      result.K3 += weight * std::abs(e[2]);
      result.ee += weight * e * e.transpose();
      fiber4.add(e, weight);
    }
  }
  result.M3 = 1.0 - result.ee(2, 2);
  const std::size_t offset = n_polar_ * n_azimuth_;
  Eigen::Vector3d p;
  Eigen::Vector3d q;
  double f = 0.0;
  for (std::size_t i = 0; i < n_polar_; ++i) {
    for (std::size_t a = 0; a < n_azimuth_; ++a) {
      const Eigen::Vector3d n =
          spherical(polar_nodes_[i], azimuth_step * (static_cast<double>(a) + 0.5));
      make_plane_basis(n, p, q);
      const double* values = density.data() + offset + (i * n_azimuth_ + a) * n_circle_;
      double m0 = 0.0;
      double mc = 0.0;
      double ms = 0.0;
      for (std::size_t c = 0; c < n_circle_; ++c) {
        const double angle = circle_step * (static_cast<double>(c) + 0.5);
        const double value = circle_step * values[c] / total;
        m0 += value;
        mc += value * std::cos(angle);
        ms += value * std::sin(angle);
      }
      const double weight = 2.0 * azimuth_step * polar_weights_[i] * 0.25;
      const double pairs = weight * (m0 * m0 - mc * mc - ms * ms);
      f += pairs;
      normal4.add(n, pairs);
      for (std::size_t c = 0; c < n_circle_; ++c) {
        const double angle = circle_step * (static_cast<double>(c) + 0.5);
        const double share = weight * circle_step * values[c] / total *
                             (m0 - mc * std::cos(angle) - ms * std::sin(angle));
        const Eigen::Vector3d e = std::cos(0.5 * angle) * p + std::sin(0.5 * angle) * q;
        axis4.add(e, share);
        transverse4.add(n.cross(e), share);
      }
    }
  }
  normal4.scale(1.0 / f);
  axis4.scale(1.0 / f);
  transverse4.scale(1.0 / f);
  result.f = f;
  result.eeee = fiber4.full();
  result.nnnn_contact = normal4.full();
  result.eeee_contact = axis4.full();
  result.tttt_contact = transverse4.full();
  result.n3 = at(result.nnnn_contact, 2, 2, 2, 2);
  result.e3 = at(result.eeee_contact, 2, 2, 2, 2);
  result.obstruction = std::numeric_limits<double>::quiet_NaN();
  if (obstruction_) {
    result.obstruction = 0.0;
    const std::size_t start = offset * (1 + n_circle_);
    const std::size_t planes = n_azimuth_ / 2;
    for (std::size_t node = 0; node < offset; ++node) {
      double sine = 0.0;
      double inverse = 0.0;
      for (std::size_t b = 0; b < planes; ++b) {
        for (std::size_t c = 0; c < n_circle_; ++c) {
          const double angle = 0.5 * circle_step * (static_cast<double>(c) + 0.5);
          const double value = density[start + (node * planes + b) * n_circle_ + c];
          sine += value * std::sin(angle) * std::sin(angle);
          inverse += value;
        }
      }
      // Half circles are counted, and both senses of each plane: twice times the step product.
      const double step = azimuth_step * circle_step / total;
      const double weight =
          2.0 * azimuth_step * polar_weights_[node / n_azimuth_] * density[node] / total;
      result.obstruction += weight * (sine * step) * (inverse * step);
    }
  }
  return result;
}

Eigen::VectorXd affine_density(const Eigen::Matrix3d& deformation,
                               const Eigen::Ref<const Directions>& directions) {
  const double determinant = deformation.determinant();
  if (!(determinant > 0.0) || !std::isfinite(determinant)) {
    throw InvalidParameter(
        format("deformation gradient: det F = %.6g, must be finite and > 0", determinant));
  }
  const Eigen::Matrix3d inverse = deformation.inverse();
  Eigen::VectorXd result(directions.rows());
  for (Eigen::Index i = 0; i < directions.rows(); ++i) {
    const Eigen::Vector3d before = inverse * directions.row(i).transpose();
    const double length = before.norm();
    result[i] = 1.0 / (4.0 * kPi * determinant * length * length * length);
  }
  return result;
}

namespace {

/// Points of a sphere sorted into cubic cells; neighbors within one cell side are in 27 cells.
class SphereCells {
 public:
  SphereCells(const Directions& points, double side)
      : count_(std::max(1, static_cast<int>(2.2 / side))) {
    const auto n = static_cast<std::size_t>(points.rows());
    cell_of_.resize(n);
    start_.assign(static_cast<std::size_t>(count_) * static_cast<std::size_t>(count_) *
                          static_cast<std::size_t>(count_) +
                      1,
                  0);
    for (std::size_t i = 0; i < n; ++i) {
      cell_of_[i] = cell(points.row(static_cast<Eigen::Index>(i)));
      ++start_[cell_of_[i] + 1];
    }
    for (std::size_t c = 1; c < start_.size(); ++c) start_[c] += start_[c - 1];
    members_.resize(n);
    std::vector<std::size_t> next(start_.begin(), start_.end() - 1);
    for (std::size_t i = 0; i < n; ++i) members_[next[cell_of_[i]]++] = i;
  }

  template <class Visit>
  void visit(const Eigen::RowVector3d& point, Visit&& visit_one) const {
    const int x = coordinate(point[0]);
    const int y = coordinate(point[1]);
    const int z = coordinate(point[2]);
    for (int i = std::max(0, x - 1); i <= std::min(count_ - 1, x + 1); ++i) {
      for (int j = std::max(0, y - 1); j <= std::min(count_ - 1, y + 1); ++j) {
        for (int k = std::max(0, z - 1); k <= std::min(count_ - 1, z + 1); ++k) {
          const std::size_t c = index(i, j, k);
          for (std::size_t m = start_[c]; m < start_[c + 1]; ++m) visit_one(members_[m]);
        }
      }
    }
  }

 private:
  [[nodiscard]] int coordinate(double x) const {
    return floor_within((x + 1.1) / 2.2 * count_, 0, count_ - 1);
  }
  [[nodiscard]] std::size_t index(int i, int j, int k) const {
    return static_cast<std::size_t>((i * count_ + j) * count_ + k);
  }
  [[nodiscard]] std::size_t cell(const Eigen::RowVector3d& point) const {
    return index(coordinate(point[0]), coordinate(point[1]), coordinate(point[2]));
  }
  int count_;
  std::vector<std::size_t> cell_of_, start_, members_;
};

void check_directions(const Eigen::Ref<const Directions>& directions, double limit) {
  Faults faults("network");
  const auto n = static_cast<double>(directions.rows());
  if (!(n >= 2.0 && n <= limit)) {
    faults.add("number of fibers", n, "", format("between 2 and %.0f", limit),
               "pair sums take n^2 work");
  }
  for (Eigen::Index i = 0; i < directions.rows(); ++i) {
    const double length = directions.row(i).norm();
    if (!(std::abs(length - 1.0) < 1e-9)) {
      faults.add(format("|direction %ld|", static_cast<long>(i)).c_str(), length, "",
                 "1 (a unit vector)");
      break;
    }
  }
  faults.raise_if_any();
}

}  // namespace

Directions make_random_directions(std::size_t n, std::uint64_t seed, std::size_t spread,
                                  std::size_t threads) {
  Faults faults("network");
  faults.within("n", static_cast<double>(n), 2, 1e6, "fibers");
  faults.within("spread", static_cast<double>(spread), 0, 10000, "steps");
  faults.raise_if_any();
  Random random(seed);
  Directions points(static_cast<Eigen::Index>(n), 3);
  for (Eigen::Index i = 0; i < points.rows();) {
    const Eigen::RowVector3d point(random.uniform(-1.0, 1.0), random.uniform(-1.0, 1.0),
                                   random.uniform(-1.0, 1.0));
    const double length = point.norm();
    // Very short vectors are rejected too: their direction is lost to rounding.
    if (length > 1.0 || length < 1e-6) continue;
    points.row(i++) = point / length;
  }
  const double spacing = std::sqrt(2.0 * kPi / static_cast<double>(n));
  const double reach = std::min(2.5 * spacing, 1.0);
  for (std::size_t step = 0; step < spread; ++step) {
    // Large steps even out the long waves, small ones at the end the nearest neighbors.
    const double reduced = 1.0 - static_cast<double>(step) / static_cast<double>(spread);
    const double amount = spacing * (0.02 + 0.98 * reduced * reduced);
    Directions axes(2 * points.rows(), 3);
    axes << points, -points;
    const SphereCells cells(axes, reach);
    Directions moved(points.rows(), 3);
    parallel_for(n, threads, [&](std::size_t begin, std::size_t end) {
      for (std::size_t i = begin; i < end; ++i) {
        const Eigen::RowVector3d point = points.row(static_cast<Eigen::Index>(i));
        Eigen::RowVector3d push = Eigen::RowVector3d::Zero();
        cells.visit(point, [&](std::size_t j) {
          if (j == i) return;
          const Eigen::RowVector3d away = point - axes.row(static_cast<Eigen::Index>(j));
          const double distance = away.norm();
          if (distance < reach && distance > 0.0) {
            const double gap = 1.0 - distance / reach;
            push += away * (gap * gap / distance);
          }
        });
        push -= point * point.dot(push);
        moved.row(static_cast<Eigen::Index>(i)) = (point + amount * push).normalized();
      }
    });
    points = moved;
  }
  return points;
}

Directions deform_directions(const Eigen::Ref<const Directions>& directions,
                             const Eigen::Matrix3d& deformation) {
  const double determinant = deformation.determinant();
  if (!(determinant > 0.0) || !std::isfinite(determinant)) {
    throw InvalidParameter(
        format("deformation gradient: det F = %.6g, must be finite and > 0", determinant));
  }
  Directions result = directions * deformation.transpose();
  result.rowwise().normalize();
  return result;
}

SampledStructure estimate_structure(const Eigen::Ref<const Directions>& directions,
                                    std::size_t threads) {
  check_directions(directions, 2e5);
  const Eigen::Index n = directions.rows();
  const auto count = static_cast<double>(n);
  // Columns: sums over j of w, w n3^4, w (e3_i^4 + e3_j^4)/2 and of their squares and products.
  Eigen::Matrix<double, Eigen::Dynamic, 8, Eigen::RowMajor> sums(n, 8);
  const Eigen::VectorXd fourth = directions.col(2).array().square().square();
  parallel_for(static_cast<std::size_t>(n), threads, [&](std::size_t begin, std::size_t end) {
    for (auto i = static_cast<Eigen::Index>(begin); i < static_cast<Eigen::Index>(end); ++i) {
      const double x = directions(i, 0);
      const double y = directions(i, 1);
      const double z = directions(i, 2);
      double s[8] = {0, 0, 0, 0, 0, 0, 0, 0};
      for (Eigen::Index j = 0; j < n; ++j) {
        const double a = y * directions(j, 2) - z * directions(j, 1);
        const double b = z * directions(j, 0) - x * directions(j, 2);
        const double c = x * directions(j, 1) - y * directions(j, 0);
        const double square = a * a + b * b + c * c;
        if (j == i || square == 0.0) continue;
        const double w = std::sqrt(square);
        const double wn = c * c * c * c / (square * w);
        const double we = w * 0.5 * (fourth[i] + fourth[j]);
        s[0] += w;
        s[1] += wn;
        s[2] += we;
        s[3] += w * w;
        s[4] += wn * wn;
        s[5] += we * we;
        s[6] += w * wn;
        s[7] += w * we;
      }
      for (int column = 0; column < 8; ++column) sums(i, column) = s[column];
    }
  });
  sums /= count - 1.0;
  const Eigen::Matrix<double, 1, 8> mean = sums.colwise().mean();
  // Variance of a pair average: 4 z1 / n + 2 z2 / n^2, with z1 the variance of the per-fiber mean
  // (which itself is inflated by z2 / n) and z2 that of the kernel.
  const auto error = [&](const Eigen::VectorXd& per_fiber, double kernel_variance) {
    const double spread = (per_fiber.array() - per_fiber.mean()).square().sum() / (count - 1.0);
    const double second = std::max(0.0, kernel_variance);
    const double first = std::max(0.0, spread - second / count);
    return std::sqrt(4.0 * first / count + 2.0 * second / (count * count));
  };
  SampledStructure result{};
  const double f = mean[0];
  const double n3 = mean[1] / f;
  const double e3 = mean[2] / f;
  result.f = {f, error(sums.col(0), mean[3] - f * f)};
  result.n3 = {n3, error((sums.col(1) - n3 * sums.col(0)) / f,
                         (mean[4] - 2.0 * n3 * mean[6] + n3 * n3 * mean[3]) / (f * f))};
  result.e3 = {e3, error((sums.col(2) - e3 * sums.col(0)) / f,
                         (mean[5] - 2.0 * e3 * mean[7] + e3 * e3 * mean[3]) / (f * f))};
  const auto plain = [&](const Eigen::ArrayXd& values) {
    const double average = values.mean();
    return Estimate{average, std::sqrt((values - average).square().sum() / (count - 1.0) / count)};
  };
  result.K3 = plain(directions.col(2).array().abs());
  result.M3 = plain(1.0 - directions.col(2).array().square());
  return result;
}

FiberStructure estimate_tensors(const Eigen::Ref<const Directions>& directions,
                                std::size_t threads) {
  check_directions(directions, 2e5);
  const Eigen::Index n = directions.rows();
  FiberStructure result;
  SymmetricTensor4 fiber4;
  for (Eigen::Index i = 0; i < n; ++i) {
    const Eigen::Vector3d e = directions.row(i).transpose();
    fiber4.add(e, 1.0 / static_cast<double>(n));
    result.ee += e * e.transpose() / static_cast<double>(n);
    result.K3 += std::abs(e[2]) / static_cast<double>(n);
  }
  result.M3 = 1.0 - result.ee(2, 2);
  struct Sums {
    SymmetricTensor4 normal, axis, transverse;
    double weight = 0.0;
  };
  // One partial sum per fiber block of fixed size: the same for every thread count.
  constexpr Eigen::Index kBlock = 64;
  const auto blocks = static_cast<std::size_t>((n + kBlock - 1) / kBlock);
  std::vector<Sums> partial(blocks);
  parallel_for(blocks, threads, [&](std::size_t begin, std::size_t end) {
    for (std::size_t block = begin; block < end; ++block) {
      Sums& sums = partial[block];
      const Eigen::Index first = static_cast<Eigen::Index>(block) * kBlock;
      for (Eigen::Index i = first; i < std::min(n, first + kBlock); ++i) {
        const Eigen::Vector3d e = directions.row(i).transpose();
        for (Eigen::Index j = 0; j < n; ++j) {
          if (j == i) continue;
          const Eigen::Vector3d cross = e.cross(Eigen::Vector3d(directions.row(j)));
          const double w = cross.norm();
          if (w == 0.0) continue;
          const Eigen::Vector3d normal = cross / w;
          sums.weight += w;
          if (j > i) sums.normal.add(normal, 2.0 * w);
          sums.axis.add(e, w);
          sums.transverse.add(normal.cross(e), w);
        }
      }
    }
  });
  Sums total;
  for (const Sums& sums : partial) {
    total.weight += sums.weight;
    total.normal.add(sums.normal, 1.0);
    total.axis.add(sums.axis, 1.0);
    total.transverse.add(sums.transverse, 1.0);
  }
  total.normal.scale(1.0 / total.weight);
  total.axis.scale(1.0 / total.weight);
  total.transverse.scale(1.0 / total.weight);
  result.f = total.weight / (static_cast<double>(n) * static_cast<double>(n - 1));
  result.eeee = fiber4.full();
  result.nnnn_contact = total.normal.full();
  result.eeee_contact = total.axis.full();
  result.tttt_contact = total.transverse.full();
  result.n3 = at(result.nnnn_contact, 2, 2, 2, 2);
  result.e3 = at(result.eeee_contact, 2, 2, 2, 2);
  result.obstruction = std::numeric_limits<double>::quiet_NaN();
  return result;
}

Eigen::Matrix<double, 6, 6> narter_stiffness(const Tensor4& eeee, double stiffness) {
  Faults faults("narter");
  faults.positive("K", stiffness, "Pa");
  faults.raise_if_any();
  constexpr int kPairs[6][2] = {{0, 0}, {1, 1}, {2, 2}, {0, 1}, {0, 2}, {1, 2}};
  Eigen::Matrix<double, 6, 6> result;
  for (int i = 0; i < 6; ++i) {
    for (int j = 0; j < 6; ++j) {
      result(i, j) = stiffness * at(eeee, kPairs[i][0], kPairs[i][1], kPairs[j][0], kPairs[j][1]);
    }
  }
  return result;
}

Eigen::Matrix<double, 6, 6> narter_compliance(const Eigen::Matrix<double, 6, 6>& stiffness) {
  const Eigen::SelfAdjointEigenSolver<Eigen::Matrix<double, 6, 6>> solver(stiffness);
  const double smallest = solver.eigenvalues().minCoeff();
  const double largest = solver.eigenvalues().maxCoeff();
  if (!(smallest > 1e-12 * largest)) {
    throw InvalidParameter(
        format("narter: smallest eigenvalue of the stiffness = %.6g Pa, must be > 0 (planar or "
               "parallel fibers carry no load across; use a spatial orientation)",
               smallest));
  }
  return stiffness.inverse();
}

EngineeringModuli engineering_moduli(const Eigen::Matrix<double, 6, 6>& c) {
  EngineeringModuli result{};
  for (std::size_t i = 0; i < 3; ++i) {
    const auto k = static_cast<Eigen::Index>(i);
    result.young[i] = 1.0 / c(k, k);
    result.shear[i] = 1.0 / c(k + 3, k + 3);
  }
  // nu_ij = -(strain j) / (strain i) under stress along i.
  result.poisson = {-c(1, 0) / c(0, 0), -c(2, 0) / c(0, 0), -c(0, 1) / c(1, 1),
                    -c(2, 1) / c(1, 1), -c(0, 2) / c(2, 2), -c(1, 2) / c(2, 2)};
  return result;
}

}  // namespace feltmb
