/// Contact areas: the common area of two surfaces as a function of compression, from their
/// geometry.
#pragma once

#include <limits>
#include <variant>
#include <vector>

namespace feltmb {

/// Flat surfaces: the area is the same at every compression > 0.
struct ConstantArea {
  double size = 0.0;  ///< [m^2], > 0
};

/// Cylinder on cylinder at a right angle, such as a hammer's nose on a string: the projection of
/// the overlap, points (x, y) where the sagittas of both cylinders sum to less than the compression
/// e. 2 pi e sqrt(R_a R_b) for small e; no wider than either cylinder.
struct CrossedCylinders {
  double radius_a = 0.0;  ///< [m], > 0
  double radius_b = 0.0;  ///< [m], > 0
};

/// Cylinder on a flat layer: chord of the circle times the width, 2 sqrt(2 R e - e^2) b. The chord
/// is no longer than `length`, the felt or the diameter.
struct CircleOnLayer {
  double radius = 0.0;                                      ///< R [m], > 0
  double width = 0.0;                                       ///< b, across the plane [m], > 0
  double length = std::numeric_limits<double>::infinity();  ///< of the felt, in the plane [m], > 0
};

/// Sphere on a flat layer: pi (2 R e - e^2), no wider than the sphere.
struct SphereOnLayer {
  double radius = 0.0;  ///< R [m], > 0
};

using ContactArea = std::variant<ConstantArea, CrossedCylinders, CircleOnLayer, SphereOnLayer>;

/// Throws InvalidParameter naming every fault.
void validate(const ContactArea& area);

/// Area [m^2] at compression e [m]; 0 for e <= 0. It never decreases with e.
double shared_area(const ContactArea& area, double e);

/// Largest area [m^2] that shared_area can reach, and the compression [m] at which it does
/// (0 for flat faces): the area has a kink there.
struct FullArea {
  double size;
  double compression;
};
FullArea full_area(const ContactArea& area);

/// Numbers that define an area of its kind, in the order of the fields: a key for caches.
std::vector<double> numbers_of(const ContactArea& area);

}  // namespace feltmb
