/// Gauss-Legendre quadrature of the tests, independent of the library.
#pragma once

#include <array>

/// Integral of f over [a, b] with 8 points in each of `parts` equal intervals.
template <class Function>
double quadrature(Function&& f, double a, double b, int parts) {
  constexpr std::array<double, 4> node{0.1834346424956498, 0.5255324099163290, 0.7966664774136267,
                                       0.9602898564975363};
  constexpr std::array<double, 4> weight{0.3626837833783620, 0.3137066458778873, 0.2223810344533745,
                                         0.1012285362903763};
  const double half = 0.5 * (b - a) / parts;
  double sum = 0.0;
  for (int i = 0; i < parts; ++i) {
    const double middle = a + (2.0 * i + 1.0) * half;
    for (std::size_t j = 0; j < node.size(); ++j) {
      sum += weight[j] * (f(middle - half * node[j]) + f(middle + half * node[j]));
    }
  }
  return half * sum;
}
