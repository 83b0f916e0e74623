/// Plane vectors. Angles are counterclockwise positive.
#pragma once

#include <cmath>

namespace feltmb {

struct Vec2 {
  double x = 0.0;
  double y = 0.0;

  bool operator==(const Vec2&) const = default;
  constexpr Vec2& operator+=(Vec2 b) {
    x += b.x;
    y += b.y;
    return *this;
  }
  constexpr Vec2& operator-=(Vec2 b) {
    x -= b.x;
    y -= b.y;
    return *this;
  }
};

constexpr Vec2 operator+(Vec2 a, Vec2 b) { return {a.x + b.x, a.y + b.y}; }
constexpr Vec2 operator-(Vec2 a, Vec2 b) { return {a.x - b.x, a.y - b.y}; }
constexpr Vec2 operator-(Vec2 a) { return {-a.x, -a.y}; }
constexpr Vec2 operator*(double k, Vec2 a) { return {k * a.x, k * a.y}; }
constexpr double dot(Vec2 a, Vec2 b) { return a.x * b.x + a.y * b.y; }

/// z component of a x b.
constexpr double cross(Vec2 a, Vec2 b) { return a.x * b.y - a.y * b.x; }

/// a turned by +90 degrees: the velocity of a material point at a for unit angular speed.
constexpr Vec2 perp(Vec2 a) { return {-a.y, a.x}; }

inline double norm(Vec2 a) { return std::sqrt(dot(a, a)); }

/// A rotation by the angle whose cosine and sine are stored.
struct Rotation {
  double c = 1.0;
  double s = 0.0;

  static Rotation of(double angle) {
    return is_small(angle) ? of_small(angle) : Rotation{std::cos(angle), std::sin(angle)};
  }

  /// Joints rotate by small angles: a Taylor series is exact to the last digit.
  static bool is_small(double angle) { return std::fabs(angle) < 0.79; }
  static Rotation of_small(double angle) {
    const double z = angle * angle;
    const double s =
        -1.0 / 6.0 +
        z * (1.0 / 120.0 +
             z * (-1.0 / 5040.0 + z * (1.0 / 362880.0 + z * (-1.0 / 39916800.0 +
                                                             z * (1.0 / 6227020800.0 +
                                                                  z * (-1.0 / 1307674368000.0))))));
    const double c =
        1.0 / 24.0 + z * (-1.0 / 720.0 +
                          z * (1.0 / 40320.0 +
                               z * (-1.0 / 3628800.0 +
                                    z * (1.0 / 479001600.0 + z * (-1.0 / 87178291200.0 +
                                                                  z * (1.0 / 20922789888000.0))))));
    return {1.0 - z * (0.5 - z * c), angle + angle * (z * s)};
  }
  constexpr Vec2 operator*(Vec2 a) const { return {c * a.x - s * a.y, s * a.x + c * a.y}; }
  constexpr Rotation operator*(Rotation b) const { return {c * b.c - s * b.s, s * b.c + c * b.s}; }
  constexpr Vec2 inverse(Vec2 a) const { return {c * a.x + s * a.y, -s * a.x + c * a.y}; }
};

}  // namespace feltmb
