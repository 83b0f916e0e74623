/// Numerical integration on finite intervals: Gauss-Legendre rules and an adaptive Gauss-Kronrod
/// integrator.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <vector>

namespace feltmb {

/// Nodes and weights of a rule on [-1, 1].
struct QuadratureRule {
  std::vector<double> nodes;    ///< [-], ascending
  std::vector<double> weights;  ///< [-], sum 2
};

/// Gauss-Legendre rule with `n` nodes, 1 <= n <= 4096, exact for polynomials of degree 2n - 1.
/// Nodes by Newton iteration on P_n. Throws InvalidParameter for n outside the range.
QuadratureRule make_gauss_legendre(std::size_t n);

/// The 16-node rule, computed once; the basis of composite rules.
const QuadratureRule& gauss16();

/// Integral of f over [a, b] by one application of `rule`.
template <class Function>
double integrate_rule(const QuadratureRule& rule, Function&& f, double a, double b) {
  const double center = 0.5 * (a + b);
  const double half = 0.5 * (b - a);
  double sum = 0.0;
  for (std::size_t i = 0; i < rule.nodes.size(); ++i) {
    sum += rule.weights[i] * f(center + half * rule.nodes[i]);
  }
  return half * sum;
}

/// Integral over [a, b] with `panels` equal panels of the 16-node rule.
template <class Function>
double integrate_composite(Function&& f, double a, double b, std::size_t panels) {
  double sum = 0.0;
  for (std::size_t i = 0; i < panels; ++i) {
    const double left = a + (b - a) * static_cast<double>(i) / static_cast<double>(panels);
    const double right = a + (b - a) * static_cast<double>(i + 1) / static_cast<double>(panels);
    sum += integrate_rule(gauss16(), f, left, right);
  }
  return sum;
}

namespace detail {
inline constexpr std::array<double, 8> kKronrodNodes = {
    0.991455371120812639206854697526329, 0.949107912342758524526189684047851,
    0.864864423359769072789712788640926, 0.741531185599394439863864773280788,
    0.586087235467691130294144691693013, 0.405845151377397166906606412076961,
    0.207784955007898467600689403773245, 0.000000000000000000000000000000000};
inline constexpr std::array<double, 8> kKronrodWeights = {
    0.022935322010529224963732008058970, 0.063092092629978553290700663189204,
    0.104790010322250183839876322541518, 0.140653259715525918745189590510238,
    0.169004726639267902826583426598550, 0.190350578064785409913256402421014,
    0.204432940075298892414161999234649, 0.209482141084727828012999174891714};
inline constexpr std::array<double, 4> kGaussWeights = {
    0.129484966168869693270611432679082, 0.279705391489276667901467771423780,
    0.381830050505118944950369775488975, 0.417959183673469387755102040816327};
}  // namespace detail

/// Value and error estimate of an adaptive integral.
struct IntegralEstimate {
  double value;  ///< the integral
  double error;  ///< absolute error estimate, usually far too large (it is that of the Gauss rule)
};

/// Adaptive Gauss(7)-Kronrod(15) integral of a finite function over [a, b].
/// Splits the worst interval until error <= max(absolute, relative * |value|) or `max_intervals`.
template <class Function>
IntegralEstimate integrate_adaptive(Function&& f, double a, double b, double relative = 1e-12,
                                    double absolute = 0.0, std::size_t max_intervals = 2000) {
  struct Piece {
    double a, b, value, error;
  };
  const auto apply = [&f](double left, double right) {
    const double center = 0.5 * (left + right);
    const double half = 0.5 * (right - left);
    const double middle = f(center);
    double kronrod = detail::kKronrodWeights[7] * middle;
    double gauss = detail::kGaussWeights[3] * middle;
    for (std::size_t i = 0; i < 7; ++i) {
      const double dx = half * detail::kKronrodNodes[i];
      const double pair = f(center - dx) + f(center + dx);
      kronrod += detail::kKronrodWeights[i] * pair;
      if (i % 2 == 1) gauss += detail::kGaussWeights[i / 2] * pair;
    }
    return Piece{left, right, half * kronrod, std::abs(half * (kronrod - gauss))};
  };
  std::vector<Piece> pieces{apply(a, b)};
  const auto worse = [](const Piece& x, const Piece& y) { return x.error < y.error; };
  double value = pieces[0].value;
  double error = pieces[0].error;
  while (error > std::max(absolute, relative * std::abs(value)) && pieces.size() < max_intervals) {
    std::pop_heap(pieces.begin(), pieces.end(), worse);
    const Piece worst = pieces.back();
    pieces.pop_back();
    const double center = 0.5 * (worst.a + worst.b);
    if (center <= std::min(worst.a, worst.b) || center >= std::max(worst.a, worst.b)) {
      pieces.push_back(worst);
      break;
    }
    for (const Piece& part : {apply(worst.a, center), apply(center, worst.b)}) {
      pieces.push_back(part);
      std::push_heap(pieces.begin(), pieces.end(), worse);
    }
    value = 0.0;
    error = 0.0;
    for (const Piece& piece : pieces) {
      value += piece.value;
      error += piece.error;
    }
  }
  return {value, error};
}

}  // namespace feltmb
