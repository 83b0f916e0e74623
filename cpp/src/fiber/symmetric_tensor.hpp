/// Symmetric tensors of rank four. Private to the fibers.
#pragma once

#include <Eigen/Core>
#include <array>
#include <cstddef>

#include "feltmb/fiber/orientation.hpp"

namespace feltmb {

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

}  // namespace feltmb
