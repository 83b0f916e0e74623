/// Plane vectors. Angles are counterclockwise positive.
#pragma once

#include <cmath>

namespace feltmb {

struct Vec2 {
  double x = 0.0;
  double y = 0.0;

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

  static Rotation of(double angle) { return {std::cos(angle), std::sin(angle)}; }
  constexpr Vec2 operator*(Vec2 a) const { return {c * a.x - s * a.y, s * a.x + c * a.y}; }
  constexpr Rotation operator*(Rotation b) const { return {c * b.c - s * b.s, s * b.c + c * b.s}; }
  constexpr Vec2 inverse(Vec2 a) const { return {c * a.x + s * a.y, -s * a.x + c * a.y}; }
};

}  // namespace feltmb
