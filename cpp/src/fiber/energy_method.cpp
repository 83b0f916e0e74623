#include "feltmb/fiber/energy_method.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <utility>

#include "feltmb/fiber/faults.hpp"
#include "feltmb/fiber/orientation.hpp"
#include "feltmb/numeric/chebyshev.hpp"
#include "feltmb/numeric/constants.hpp"
#include "feltmb/numeric/quadrature.hpp"
#include "feltmb/numeric/roots.hpp"

namespace feltmb {
namespace {

/// a in (0, pi) with sin(a)/a = x by Newton iteration.
double solve_half_angle(double x) {
  const double y = 1.0 - x;
  double a = std::min(std::sqrt(6.0 * y * (1.0 + 0.3 * y + 0.14 * y * y)), 3.1);
  for (int i = 0; i < 60; ++i) {
    double next = a - (std::sin(a) - x * a) / (std::cos(a) - x);
    if (next >= kPi) next = 0.5 * (a + kPi);
    if (next <= 0.0) next = 0.5 * a;
    if (std::abs(next - a) < 1e-15 * a) return next;
    a = next;
  }
  return a;
}

/// a in [0, pi] with sin(a)/a = x, 0 <= x <= 1. The ratio a^2/(1 - x) is smooth: interpolated.
double half_angle(double x) {
  static const CumulativeIntegral& ratio = *new CumulativeIntegral(
      [](double t) {
        const double y = 1.0 - t;
        if (y < 1e-3) return 6.0 * (1.0 + y * (0.3 + y * (24.0 / 175.0 + y * 13.0 / 175.0)));
        const double a = solve_half_angle(t);
        return a * a / y;
      },
      0.0, 1.0, 12);
  return x >= 1.0 ? 0.0 : std::sqrt((1.0 - x) * ratio.integrand(x));
}

/// d(a)/d(x) = a^2 / (a cos a - sin a), negative; finite times a at a -> 0.
double half_angle_slope(double a) {
  if (a < 1e-2) return -3.0 / (a * (1.0 - a * a / 10.0 + a * a * a * a / 280.0));
  return a * a / (a * std::cos(a) - std::sin(a));
}

struct Sums {
  double bending = 0, straightening = 0, slipping = 0, slip = 0;
  double bending_share = 0, straightening_share = 0, slipping_share = 0;
  double axial = 0, lateral = 0;            // d(energy)/d(stretch)
  double axial_slip = 0, lateral_slip = 0;  // d(slip length)/d(stretch)
};

}  // namespace

void validate(const EnergyParams& p) {
  Faults faults("energy method");
  faults.positive("E", p.E, "Pa");
  if (!(p.v_f0 > 0.0 && p.v_f0 < 1.0)) faults.add("v_f0", p.v_f0, "", "> 0 and < 1");
  faults.within("chord_ratio", p.chord_ratio, 0.05, 1.0, "", "1 is a straight segment");
  faults.within("ratio", p.ratio, 1e-2, 1e4, "");
  if (!(p.length_shape == 0.0 || (p.length_shape > 1.0 && std::isfinite(p.length_shape)))) {
    faults.add("length_shape", p.length_shape, "", "0 (equal lengths) or > 1",
               "the mean of 1/L is infinite for shape <= 1");
  }
  faults.not_negative("slip_stress", p.slip_stress, "Pa");
  faults.raise_if_any();
}

namespace {

/// State and the lateral derivative of energy plus slip work per volume of fiber.
std::pair<EnergyState, double> evaluate_both(const EnergyParams& p, double axial_stretch,
                                             double lateral_stretch) {
  const double la2 = axial_stretch * axial_stretch;
  const double ll2 = lateral_stretch * lateral_stretch;
  const double rest_angle = half_angle(p.chord_ratio);
  const double f = uniaxial_structure(p.ratio).f;

  // Ends of the kinds of segment in c = |cos theta|: s^2 = ll^2 + (la^2 - ll^2) c^2 is monotonic.
  std::array<double, 4> ends{0.0, 1.0, 1.0, 1.0};
  std::size_t count = 1;
  const auto add_end = [&](double stretch) {
    const double difference = la2 - ll2;
    if (difference == 0.0) return;
    const double square = (stretch * stretch - ll2) / difference;
    if (square > 0.0 && square < 1.0) ends[count++] = std::sqrt(square);
  };
  add_end(1.0);
  if (p.chord_ratio < 1.0) add_end(1.0 / p.chord_ratio);
  if (count == 3 && ends[1] > ends[2]) std::swap(ends[1], ends[2]);
  ends[count++] = 1.0;

  Sums sums;
  const auto add = [&](double c, double weight) {
    const double share = weight * 2.0 * kPi * uniaxial_density(p.ratio, c);
    const double s = std::sqrt(ll2 + (la2 - ll2) * c * c);
    const double x = p.chord_ratio * s;
    const double ds_axial = axial_stretch * c * c / s;
    const double ds_lateral = lateral_stretch * (1.0 - c) * (1.0 + c) / s;
    if (x >= 1.0 && s > 1.0) {
      sums.slipping += share * rest_angle * rest_angle;
      sums.slip += share * (x - 1.0);
      sums.slipping_share += share;
      sums.axial_slip += share * p.chord_ratio * ds_axial;
      sums.lateral_slip += share * p.chord_ratio * ds_lateral;
      return;
    }
    const double a = half_angle(x);
    const double change = a - rest_angle;
    if (s <= 1.0) {
      sums.bending += share * change * change;
      sums.bending_share += share;
    } else {
      sums.straightening += share * change * change;
      sums.straightening_share += share;
    }
    // At rest a straight segment still needs its buckling force: the limit of a da/dx is -3.
    const double slope = a > 0.0 ? change * half_angle_slope(a) : -3.0;
    sums.axial += share * 2.0 * slope * p.chord_ratio * ds_axial;
    sums.lateral += share * 2.0 * slope * p.chord_ratio * ds_lateral;
  };
  // The orientation has width 1/R around the plane: grade the panels there.
  const double width = std::min(1.0, 1.0 / p.ratio);
  for (std::size_t i = 0; i + 1 < count; ++i) {
    const double t_low = std::asinh(ends[i] / width);
    const double t_high = std::asinh(ends[i + 1] / width);
    if (!(t_high > t_low)) continue;
    const auto panels = static_cast<std::size_t>(std::ceil(t_high - t_low));
    for (std::size_t panel = 0; panel < panels; ++panel) {
      const double h = (t_high - t_low) / static_cast<double>(panels);
      const double left = t_low + h * static_cast<double>(panel);
      for (std::size_t k = 0; k < gauss16().nodes.size(); ++k) {
        // y^2 (3 - 2 y) takes the square roots of locking and buckling out of both ends.
        const double y = 0.5 * (1.0 + gauss16().nodes[k]);
        const double t = left + h * y * y * (3.0 - 2.0 * y);
        add(std::min(1.0, width * std::sinh(t)),
            0.5 * gauss16().weights[k] * h * 6.0 * y * (1.0 - y) * width * std::cosh(t));
      }
    }
  }
  // 2 E I l_v0 / L^2 per initial volume, L = pi d/(8 f v0); over v0 for a volume of fiber.
  const double inverse_length =
      p.length_shape == 0.0 ? 1.0 : p.length_shape / (p.length_shape - 1.0);
  const double scale = 8.0 * p.E * f * f * p.v_f0 * p.v_f0 / (kPi * kPi) * inverse_length;
  // Slip: force times length (x - 1) L on l_v0/L segments, over v0: 4 slip_stress/pi.
  const double slip_scale = 4.0 * p.slip_stress / kPi;
  EnergyState state{};
  state.strain = 1.0 - axial_stretch;
  state.lateral_stretch = lateral_stretch;
  state.v_f = p.v_f0 / (axial_stretch * ll2);
  state.bending = scale * sums.bending;
  state.straightening = scale * sums.straightening;
  state.slipping = scale * sums.slipping;
  state.slip_work = slip_scale * sums.slip;
  state.bending_share = sums.bending_share;
  state.straightening_share = sums.straightening_share;
  state.slipping_share = sums.slipping_share;
  // Stress per current area: v0 dU/d(stretch) over the area stretch.
  state.pressure = -p.v_f0 * (scale * sums.axial + slip_scale * sums.axial_slip) / ll2;
  return {state, scale * sums.lateral + slip_scale * sums.lateral_slip};
}

}  // namespace

EnergyState evaluate_energy(const EnergyParams& p, double axial_stretch, double lateral_stretch) {
  return evaluate_both(p, axial_stretch, lateral_stretch).first;
}

EnergyState compress_energy(const EnergyParams& p, CompressionScheme scheme, double strain) {
  validate(p);
  if (!(strain >= 0.0 && strain < 1.0)) {
    throw InvalidParameter(
        format("energy method: strain = %.6g, must be >= 0 and < 1 (engineering, compression "
               "positive)",
               strain));
  }
  const double axial = 1.0 - strain;
  if (scheme == CompressionScheme::confined) return evaluate_energy(p, axial, 1.0);
  if (scheme == CompressionScheme::isotropic) {
    // Hydrostatic: a third of the work of the three equal stresses belongs to each axis.
    EnergyState state = evaluate_energy(p, axial, axial);
    const double x = p.chord_ratio * axial;
    const double a = half_angle(x);
    const double rest = half_angle(p.chord_ratio);
    const double f = uniaxial_structure(p.ratio).f;
    const double shape = p.length_shape == 0.0 ? 1.0 : p.length_shape / (p.length_shape - 1.0);
    const double scale = 8.0 * p.E * f * f * p.v_f0 * p.v_f0 / (kPi * kPi) * shape;
    const double slope = a > 0.0 ? (a - rest) * half_angle_slope(a) : -3.0;
    state.pressure = -p.v_f0 * scale * 2.0 * slope * p.chord_ratio / (3.0 * axial * axial);
    return state;
  }
  if (strain == 0.0 && p.chord_ratio < 1.0) return evaluate_energy(p, 1.0, 1.0);
  const auto derivative = [&](double stretch) { return evaluate_both(p, axial, stretch).second; };
  // The lateral force peaks where the flattest segments are drawn straight: look there first, the
  // peak may be narrow. Beyond it the mass gives way until slipping holds it.
  double low = 1.0 - 1e-9;
  double high = 1.0 / p.chord_ratio - 1e-12;
  if (!(derivative(high) > 0.0)) {
    low = high;
    while (derivative(high) < 0.0) {
      high *= 1.02;
      if (high > 4.0) {
        throw ModelError(
            format("energy method: no lateral equilibrium at strain %.6g below lateral stretch 4; "
                   "segments give no resistance sideways (chord_ratio %.6g, slip_stress %.6g Pa); "
                   "use crimp, a slip stress, or the confined scheme",
                   strain, p.chord_ratio, p.slip_stress),
            ErrorCode::kNoEquilibrium);
      }
    }
  }
  const double lateral = find_root(
      [&](double stretch) {
        const double value = derivative(stretch);
        // No slope is given: NaN makes the root finder bisect.
        return std::pair(value, std::numeric_limits<double>::quiet_NaN());
      },
      low, high, 1e-15);
  return evaluate_energy(p, axial, lateral);
}

}  // namespace feltmb
