#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <vector>

#include "feltmb/fiber/faults.hpp"
#include "feltmb/fiber/orientation.hpp"
#include "feltmb/numeric/constants.hpp"
#include "feltmb/numeric/quadrature.hpp"
#include "symmetric_tensor.hpp"

namespace feltmb {
namespace {

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
  result.n3 = component(result.nnnn_contact, 2, 2, 2, 2);
  result.e3 = component(result.eeee_contact, 2, 2, 2, 2);
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

}  // namespace feltmb
