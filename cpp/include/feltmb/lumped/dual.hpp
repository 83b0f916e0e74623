/// Forward-mode differentiation: a value and its derivatives along W directions at once.
#pragma once

#include <array>
#include <cmath>

namespace feltmb::lumped {

/// Value with W directional derivatives. Loops over W are elementwise, so every vector width gives
/// the same bits.
template <int W>
struct Dual {
  double v = 0.0;
  std::array<double, static_cast<std::size_t>(W)> d{};

  Dual() = default;
  Dual(double value) : v(value) {}  // NOLINT: a constant is a dual

  /// f(this) with the slope f'.
  Dual chain(double value, double slope) const {
    Dual r;
    r.v = value;
    for (std::size_t i = 0; i < d.size(); ++i) {
      r.d[i] = slope * d[i];
    }
    return r;
  }
  Dual& operator+=(const Dual& b) {
    v += b.v;
    for (std::size_t i = 0; i < d.size(); ++i) {
      d[i] += b.d[i];
    }
    return *this;
  }
  Dual& operator-=(const Dual& b) {
    v -= b.v;
    for (std::size_t i = 0; i < d.size(); ++i) {
      d[i] -= b.d[i];
    }
    return *this;
  }
  /// this += factor * b
  void add(double factor, const Dual& b) {
    v += factor * b.v;
    for (std::size_t i = 0; i < d.size(); ++i) {
      d[i] += factor * b.d[i];
    }
  }
};

template <int W>
Dual<W> operator+(Dual<W> a, const Dual<W>& b) {
  a += b;
  return a;
}
template <int W>
Dual<W> operator-(Dual<W> a, const Dual<W>& b) {
  a -= b;
  return a;
}
template <int W>
Dual<W> operator*(const Dual<W>& a, const Dual<W>& b) {
  Dual<W> r;
  r.v = a.v * b.v;
  for (std::size_t i = 0; i < r.d.size(); ++i) {
    r.d[i] = a.v * b.d[i] + b.v * a.d[i];
  }
  return r;
}
template <int W>
Dual<W> operator/(const Dual<W>& a, const Dual<W>& b) {
  const double inverse = 1.0 / b.v;
  Dual<W> r;
  r.v = a.v * inverse;
  for (std::size_t i = 0; i < r.d.size(); ++i) {
    r.d[i] = inverse * (a.d[i] - r.v * b.d[i]);
  }
  return r;
}

// The same few functions for plain numbers and for duals.
inline double value(double a) { return a; }
template <int W>
double value(const Dual<W>& a) {
  return a.v;
}
inline void add(double& a, double factor, double b) { a += factor * b; }
template <int W>
void add(Dual<W>& a, double factor, const Dual<W>& b) {
  a.add(factor, b);
}
/// x given as a value and a slope along `a`: f(a).
inline double chain(double /*a*/, double result, double /*slope*/) { return result; }
template <int W>
Dual<W> chain(const Dual<W>& a, double result, double slope) {
  return a.chain(result, slope);
}
template <class S>
S tanh_of(const S& a) {
  const double t = std::tanh(value(a));
  return chain(a, t, 1.0 - t * t);
}
/// 1 / (1 + exp(-a))
template <class S>
S sigmoid_of(const S& a) {
  const double s = 0.5 * (1.0 + std::tanh(0.5 * value(a)));
  return chain(a, s, s * (1.0 - s));
}
template <class S>
S abs_of(const S& a) {
  return value(a) < 0.0 ? chain(a, -value(a), -1.0) : a;
}
/// base^exponent for base > 0
inline double power_of(double base, double exponent) { return std::pow(base, exponent); }
template <int W>
Dual<W> power_of(const Dual<W>& base, const Dual<W>& exponent) {
  const double p = std::pow(base.v, exponent.v);
  const double along_base = exponent.v * p / base.v;
  const double along_exponent = p * std::log(base.v);
  Dual<W> r;
  r.v = p;
  for (std::size_t i = 0; i < r.d.size(); ++i) {
    r.d[i] = along_base * base.d[i] + along_exponent * exponent.d[i];
  }
  return r;
}

}  // namespace feltmb::lumped
