#include "feltmb/contact/area.hpp"

#include <algorithm>
#include <cmath>

#include "feltmb/core/error.hpp"
#include "feltmb/fiber/faults.hpp"
#include "feltmb/numeric/constants.hpp"
#include "feltmb/numeric/quadrature.hpp"

namespace feltmb {
namespace {

double shared(const ConstantArea& a, double) { return a.size; }

double full_depth(const ConstantArea&) { return 0.0; }

std::vector<double> numbers(const ConstantArea& a) { return {a.size}; }

double shared(const CrossedCylinders& a, double e) {
  const double small = std::min(a.radius_a, a.radius_b);
  const double large = std::max(a.radius_a, a.radius_b);
  static const QuadratureRule& rule = *new QuadratureRule(make_gauss_legendre(64));
  // y = small sin(phi), phi = end sin(psi): the root at the rim becomes smooth.
  const double end = std::acos(std::clamp(1.0 - e / small, 0.0, 1.0));
  return 4.0 * integrate_rule(
                   rule,
                   [&](double psi) {
                     const double phi = end * std::sin(psi);
                     const double sine = std::sin(0.5 * phi);
                     const double gap = std::clamp(e - 2.0 * small * sine * sine, 0.0, large);
                     return std::sqrt(gap * (2.0 * large - gap)) * small * std::cos(phi) * end *
                            std::cos(psi);
                   },
                   0.0, 0.5 * kPi);
}

double full_depth(const CrossedCylinders& a) { return a.radius_a + a.radius_b; }

std::vector<double> numbers(const CrossedCylinders& a) { return {a.radius_a, a.radius_b}; }

double shared(const CircleOnLayer& a, double e) {
  const double depth = std::min(e, a.radius);
  return a.width * std::min(a.length, 2.0 * std::sqrt(depth * (2.0 * a.radius - depth)));
}

double full_depth(const CircleOnLayer& a) {
  const double half = 0.5 * std::min(a.length, 2.0 * a.radius);
  return a.radius - std::sqrt(std::max(0.0, (a.radius - half) * (a.radius + half)));
}

std::vector<double> numbers(const CircleOnLayer& a) { return {a.radius, a.width, a.length}; }

double shared(const SphereOnLayer& a, double e) {
  const double depth = std::min(e, a.radius);
  return kPi * depth * (2.0 * a.radius - depth);
}

double full_depth(const SphereOnLayer& a) { return a.radius; }

std::vector<double> numbers(const SphereOnLayer& a) { return {a.radius}; }

}  // namespace

void validate(const ContactArea& area) {
  struct Check {
    void operator()(const ConstantArea& a) const {
      Faults faults("constant area");
      faults.positive("size", a.size, "m^2");
      faults.raise_if_any();
    }
    void operator()(const CrossedCylinders& a) const {
      Faults faults("crossed cylinders");
      faults.positive("radius_a", a.radius_a, "m");
      faults.positive("radius_b", a.radius_b, "m");
      faults.raise_if_any();
    }
    void operator()(const CircleOnLayer& a) const {
      Faults faults("circle on layer");
      faults.positive("radius", a.radius, "m");
      faults.positive("width", a.width, "m");
      if (!(a.length > 0.0)) faults.add("length", a.length, "m", "> 0");
      faults.raise_if_any();
    }
    void operator()(const SphereOnLayer& a) const {
      Faults faults("sphere on layer");
      faults.positive("radius", a.radius, "m");
      faults.raise_if_any();
    }
  };
  std::visit(Check{}, area);
}

double shared_area(const ContactArea& area, double e) {
  if (!(e > 0.0)) return 0.0;
  return std::visit([e](const auto& a) { return shared(a, e); }, area);
}

FullArea full_area(const ContactArea& area) {
  return std::visit(
      [](const auto& a) {
        const double depth = full_depth(a);
        return FullArea{shared(a, depth), depth};
      },
      area);
}

std::vector<double> numbers_of(const ContactArea& area) {
  return std::visit([](const auto& a) { return numbers(a); }, area);
}

}  // namespace feltmb
