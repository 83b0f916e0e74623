// Contact surfaces against a description of their boundaries: signed distance by search along the
// boundary, energy as the potential of the generalized forces, the rate as a difference quotient.
#include <doctest/doctest.h>

#include <algorithm>
#include <cmath>
#include <functional>
#include <limits>
#include <numbers>
#include <string>
#include <vector>

#include "feltmb/core/index.hpp"
#include "feltmb/numeric/random.hpp"
#include "feltmb/planar/dynamics.hpp"

namespace {

using namespace feltmb;

constexpr double kNose = 4e-3;       // radius of the circle that touches [m]
constexpr double kStiffness = 3e5;   // N/m^1.5
constexpr double kRadius = 0.02;     // of the surfaces [m]
constexpr Vec2 kPoint{0.03, -0.01};  // of the surfaces, on their body [m]

/// Part of a boundary over s in [0, 1]; `out` is the normal out of the material, zero where the
/// boundary is a point that is touched from all sides.
struct Piece {
  std::function<Vec2(double)> place;
  std::function<Vec2(double)> out;
};

struct Case {
  SurfaceDescription surface;
  std::vector<Piece> boundary;  ///< corners first: they have no side
  double thickness = 0.0;       ///< of the material beyond the boundary that is given [m]
};

Vec2 toward(double angle) { return {std::cos(angle), std::sin(angle)}; }

Piece arc(double from, double to, double side) {
  const auto angle = [=](double s) { return from + s * (to - from); };
  return {[=](double s) { return kPoint + kRadius * toward(angle(s)); },
          [=](double s) { return side * toward(angle(s)); }};
}

Piece straight(Vec2 from, Vec2 to, Vec2 out) {
  return {[=](double s) { return from + s * (to - from); }, [=](double) { return out; }};
}

Piece corner(Vec2 at) {
  return {[=](double) { return at; }, [](double) { return Vec2{}; }};
}

std::vector<Case> cases() {
  constexpr double turn = 2.0 * std::numbers::pi;
  constexpr double far = 0.2;
  const auto surface = [](SurfaceKind kind, double radius) {
    SurfaceDescription s;
    s.name = "surface";
    s.body = "plate";
    s.kind = kind;
    s.point = kPoint;
    s.radius = radius;
    return s;
  };
  std::vector<Case> out;
  SurfaceDescription line = surface(SurfaceKind::kLine, 0.0);
  line.normal = toward(1.1);
  const Vec2 along = -perp(line.normal);
  out.push_back({line, {straight(kPoint - far * along, kPoint + far * along, line.normal)}});
  out.push_back({surface(SurfaceKind::kCircle, kRadius), {arc(0.0, turn, 1.0)}});
  out.push_back({surface(SurfaceKind::kConcave, kRadius), {arc(0.0, turn, -1.0)}});
  SurfaceDescription hybrid = surface(SurfaceKind::kHybrid, kRadius);
  hybrid.arc = {0.4, 1.9};
  Case rounded{hybrid, {arc(0.4, 1.9, 1.0)}};
  for (const double side : {-1.0, 1.0}) {
    const Vec2 normal = toward(side < 0.0 ? 0.4 : 1.9);
    const Vec2 end = kPoint + kRadius * normal;
    rounded.boundary.push_back(straight(end, end + side * far * perp(normal), normal));
  }
  out.push_back(rounded);
  for (const double thickness : {0.0, 3e-3}) {
    SurfaceDescription segment = surface(SurfaceKind::kSegment, thickness);
    segment.end = kPoint + 0.03 * toward(-0.3);
    // A line has one face, on the left of the way; a bar is touched from all sides.
    const Vec2 face = thickness > 0.0 ? Vec2{} : perp(toward(-0.3));
    out.push_back({segment,
                   {corner(kPoint), corner(segment.end), straight(kPoint, segment.end, face)},
                   thickness});
  }
  for (const double end : {2.2, 4.9}) {  // less and more than half a turn
    SurfaceDescription hollow = surface(SurfaceKind::kConcaveArc, kRadius);
    hollow.arc = {0.3, end};
    out.push_back({hollow,
                   {corner(kPoint + kRadius * toward(0.3)), corner(kPoint + kRadius * toward(end)),
                    arc(0.3, end, -1.0)}});
  }
  return out;
}

/// Distance of the circle's center p from the surface's material, negative inside, by search.
double signed_distance(const Case& c, Vec2 p) {
  double nearest = std::numeric_limits<double>::infinity();
  double sign = 1.0;
  for (const Piece& piece : c.boundary) {
    const auto distance = [&](double s) { return norm(p - piece.place(s)); };
    constexpr int parts = 200;
    int best = 0;
    for (int i = 1; i <= parts; ++i) {
      if (distance(i / double{parts}) < distance(best / double{parts})) best = i;
    }
    double low = std::max(0, best - 1) / double{parts};
    double high = std::min(parts, best + 1) / double{parts};
    for (int i = 0; i < 80; ++i) {
      const double a = low + (high - low) / 3.0;
      const double b = high - (high - low) / 3.0;
      (distance(a) < distance(b) ? high : low) = distance(a) < distance(b) ? b : a;
    }
    const double s = 0.5 * (low + high);
    if (distance(s) >= nearest - 1e-12) continue;
    nearest = distance(s);
    sign = dot(piece.out(s), p - piece.place(s)) < 0.0 ? -1.0 : 1.0;
  }
  return sign * nearest - c.thickness;
}

/// The surface on a plate that turns and a circle that moves along x and y: q = angle, x, y.
MechanismDescription plate_and_nose(const SurfaceDescription& surface) {
  MechanismDescription d;
  d.name = "plate_and_nose";
  d.gravity = {0.0, 0.0};
  const auto body = [&](const char* name, const char* parent, JointKind joint, Vec2 axis) {
    BodyDescription b;
    b.name = name;
    b.parent = parent;
    b.joint = joint;
    b.axis = axis;
    b.coordinate = std::string(name) + ".q";
    b.mass = 0.1;
    b.inertia = 1e-4;
    d.bodies.push_back(b);
  };
  body("plate", "ground", JointKind::kRevolute, {0.0, 1.0});
  body("slide", "ground", JointKind::kPrismatic, {1.0, 0.0});
  body("nose", "slide", JointKind::kPrismatic, {0.0, 1.0});
  SurfaceDescription nose;
  nose.name = "nose";
  nose.body = "nose";
  nose.radius = kNose;
  d.surfaces = {surface, nose};
  ContactDescription contact;
  contact.number = 1;
  contact.surface_a = "surface";
  contact.surface_b = "nose";
  contact.law = HuntCrossley{kStiffness, 1.5, 0.0};
  d.contacts.push_back(contact);
  return d;
}

/// Place of the circle's center for coordinates of `plate_and_nose`, seen from the plate.
Vec2 on_plate(const std::vector<double>& q) { return Rotation::of(-q[0]) * Vec2{q[1], q[2]}; }

double energy(double compression) {
  return compression > 0.0 ? kStiffness * std::pow(compression, 2.5) / 2.5 : 0.0;
}

}  // namespace

TEST_CASE("every surface: compression, rate and forces follow from the distance of its boundary") {
  for (const Case& c : cases()) {
    CAPTURE(static_cast<int>(c.surface.kind));
    CAPTURE(c.surface.radius);
    Dynamics dynamics(assemble(plate_and_nose(c.surface)));
    Random random(7);
    int closed = 0;
    for (int i = 0; i < 120; ++i) {
      // Around a place of the boundary, at most half a radius within the material.
      const Piece& piece = c.boundary[as_index(i) % c.boundary.size()];
      const Vec2 local = piece.place(random.uniform(0.05, 0.95)) +
                         (c.thickness + 0.6 * kNose * random.uniform()) *
                             toward(2.0 * std::numbers::pi * random.uniform());
      const double angle = random.uniform(-1.0, 1.0);
      const Vec2 p = Rotation::of(angle) * local;
      const std::vector<double> q{angle, p.x, p.y};
      const std::vector<double> v{random.uniform(), random.uniform(), -random.uniform()};
      const std::vector<double> still(3, 0.0);
      const auto compression = [&](double time) {
        std::vector<double> moved = q;
        for (std::size_t k = 0; k < 3; ++k) moved[k] += time * v[k];
        return kNose - signed_distance(c, on_plate(moved));
      };
      dynamics.locate({q, v, {}, {}, {}}, {}, Detail::kAllContacts);
      const ContactState located = dynamics.contacts()[0];
      closed += located.closed ? 1 : 0;
      CHECK(located.compression == doctest::Approx(compression(0.0)).epsilon(1e-9).scale(kNose));
      constexpr double h = 1e-6;  // s
      const double rate = (compression(h) - compression(-h)) / (2.0 * h);
      const double bend = (compression(h) + compression(-h) - 2.0 * compression(0.0)) / h;
      if (std::fabs(bend) > 1e-3) continue;  // a corner is within these moves
      CHECK(located.rate == doctest::Approx(rate).epsilon(1e-4));
      dynamics.evaluate({q, still, {}, {}, {}}, {}, Detail::kAllContacts);
      double power = 0.0;
      for (int k = 0; k < 3; ++k) power += dynamics.force()[k] * v[as_index(k)];
      const double lost = (energy(compression(h)) - energy(compression(-h))) / (2.0 * h);
      CHECK(power == doctest::Approx(-lost).epsilon(1e-4));
    }
    CHECK(closed > 60);
  }
}
